"""Pictures: results in, :class:`matplotlib.figure.Figure` out. Nothing is solved or saved here.

A model is drawn cell by cell through its :class:`dead_ends.Geometry`. The colours are
distinguishable with every common colour blindness and in grey (Okabe and Ito's palette); each
subset is named in the picture besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from dead_ends.model import Geometry, SafeMDP
from dead_ends.results import INFINITE, Label, Labelling

__all__ = ["Blocked", "Boundary", "Run", "animate_runs", "plot_boundaries", "plot_map"]

COLORS = {
    Label.FAIL: "#404040",
    Label.DEAD: "#E69F00",
    Label.SAFE: "#CDE6F5",
    Label.AT_RISK: "#F4EDA0",
}
NAMES = {
    Label.FAIL: "failed",
    Label.DEAD: "dead-end: fails whatever it does",
    Label.SAFE: "safe: some policy never fails",
    Label.AT_RISK: "at risk: may fail, need not",
}
WALL = "#8C8C8C"
LINES = ("#000000", "#D55E00", "#0072B2", "#882255", "#117733")
STYLES: tuple[Any, ...] = (
    "-",
    (0, (5, 2)),
    (0, (1, 1.2)),
    (0, (6, 2, 1, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)
MAX_NUMBERED_CELLS = 400


@dataclass(frozen=True, eq=False)
class Boundary:
    """The states that a safety critic calls unsafe: bool (S,), and the line's name."""

    name: str
    unsafe: NDArray[np.bool_]


@dataclass(frozen=True)
class Blocked:
    """The share of safe actions, in 0..1, that a critic blocks at each threshold."""

    name: str
    share: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Run:
    """One episode: states (T+1,), and whether the recovery policy acted, bool (T,)."""

    name: str
    states: NDArray[np.int_]
    corrected: NDArray[np.bool_]


def plot_map(
    model: SafeMDP,
    labelling: Labelling,
    *,
    title: str = "",
    actions: NDArray[np.bool_] | None = None,
    actions_name: str = "safe action",
) -> Figure:
    """The labels on the model's cells, with starts, goals, survival times and safe actions.

    Args:
        model: a model with a geometry.
        labelling: its labels.
        title: above the picture.
        actions: bool (S, A), drawn as arrows if the geometry names directions; none in
            terminal states.
        actions_name: what the arrows are, for the legend.

    Raises:
        ValueError: if the model has no geometry, or two states share a cell.
    """
    geometry = _geometry(model)
    columns, rows = _extent_cells(geometry)
    width = min(11.0, max(5.0, 0.62 * columns + 1.2))
    height = max(2.6, width * rows / columns + 1.5)
    figure = Figure(figsize=(width, min(height, 9.0)), layout="constrained")
    axes = figure.add_subplot()
    draw_labels(axes, geometry, labelling.labels)
    drawn = np.flatnonzero(_drawn(geometry))
    if len(drawn) <= MAX_NUMBERED_CELLS:
        _draw_survival_times(axes, geometry, labelling)
        ends = _draw_ends(axes, geometry, model)
        if actions is not None and geometry.arrows is not None:
            _draw_arrows(axes, geometry, actions & ~model.terminal[:, None], labelling)
    handles = _map_legend(geometry, labelling, drawn)
    if len(drawn) <= MAX_NUMBERED_CELLS:
        handles += ends
        if labelling.dead[drawn].any():
            handles.append(_symbol("$3$", _T_LEGEND))
        if actions is not None and geometry.arrows is not None:
            handles.append(_symbol(r"$\rightarrow$", actions_name))
    columns = min(len(handles), max(1, int(figure.get_figwidth() // 3.3)))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)
    axes.set_title(title, loc="left")
    return figure


_T_LEGEND = "steps to failure, at most (∞: no bound)"


def _symbol(marker: str, name: str) -> Line2D:
    return Line2D([], [], linestyle="", marker=marker, color="black", markersize=9, label=name)


def _map_legend(geometry: Geometry, labelling: Labelling, drawn: NDArray[np.int_]) -> list[Any]:
    """A patch for each kind of cell in the picture."""
    kinds = [
        (COLORS[label], NAMES[label]) for label in Label if np.any(labelling.labels[drawn] == label)
    ]
    if geometry.walls:
        kinds.append((WALL, "wall"))
    return [Patch(facecolor=color, edgecolor="#999999", label=name) for color, name in kinds]


def plot_boundaries(
    model: SafeMDP,
    labelling: Labelling,
    boundaries: Sequence[Boundary],
    *,
    blocked: Sequence[Blocked] = (),
    thresholds: Sequence[str] = (),
    title: str = "",
) -> Figure:
    """The three subsets, and the boundaries that safety critics draw (the paper's Figure 1).

    Args:
        model: a model with a geometry.
        labelling: its labels.
        boundaries: what each critic calls unsafe; the first one is drawn as a thick line.
        blocked: the share of safe actions that each critic blocks, for a second panel.
        thresholds: the names of the thresholds in ``blocked``.
        title: above the picture.

    Raises:
        ValueError: if the model has no geometry, or two states share a cell.
    """
    geometry = _geometry(model)
    if blocked:
        figure = Figure(figsize=(12.5, 5.4), layout="constrained")
        axes, side = figure.subplots(1, 2, width_ratios=(1.75, 1))
        _draw_blocked(side, blocked, thresholds)
    else:
        figure = Figure(figsize=(8.0, 5.4), layout="constrained")
        axes = figure.add_subplot()
    draw_labels(axes, geometry, labelling.labels)
    handles: list[Any] = []
    for index, boundary in enumerate(boundaries):
        line = _outline(geometry, boundary.unsafe)
        style: Any = STYLES[index % len(STYLES)]
        color, thickness = LINES[index % len(LINES)], 3.2 if index == 0 else 2.2
        axes.add_collection(
            LineCollection(line, colors=color, linestyles=[style], linewidths=thickness)
        )
        handles.append(
            Line2D([], [], color=color, linestyle=style, linewidth=thickness, label=boundary.name)
        )
    for label in (Label.FAIL, Label.DEAD, Label.SAFE):
        _name_region(axes, geometry, labelling.labels, label)
    axes.legend(
        title="boundary drawn by the safety critic of the",
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.12),
        ncols=2,
        frameon=False,
    )
    axes.set_title(title, loc="left")
    return figure


def draw_labels(axes: Axes, geometry: Geometry, labels: NDArray[np.uint8]) -> None:
    """The label of each cell as its colour; walls grey; axes with units."""
    columns, rows = _extent_cells(geometry)
    raster = np.full((rows, columns), -1)
    drawn = _drawn(geometry)
    column, row = geometry.cell[drawn].T
    _refuse_shared_cells(geometry, drawn)
    raster[row, column] = labels[drawn]
    for wall_column, wall_row in geometry.walls:
        raster[wall_row, wall_column] = len(Label)
    (x0, y0), (dx, dy) = geometry.origin, geometry.step
    axes.imshow(
        np.ma.masked_less(raster, 0),
        cmap=ListedColormap([*(COLORS[label] for label in Label), WALL]),
        vmin=-0.5,
        vmax=len(Label) + 0.5,
        origin="lower",
        extent=(x0 - dx / 2, x0 + (columns - 0.5) * dx, y0 - dy / 2, y0 + (rows - 0.5) * dy),
        aspect="equal" if geometry.y_down else "auto",
        interpolation="nearest",
    )
    if geometry.y_down:
        axes.invert_yaxis()
    if geometry.step == (1.0, 1.0):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    if columns * rows <= MAX_NUMBERED_CELLS:
        _draw_grid(axes, geometry, columns, rows)
    axes.set_xlabel(geometry.x_label)
    axes.set_ylabel(geometry.y_label)


def animate_runs(
    model: SafeMDP, labelling: Labelling, runs: Sequence[Run], *, title: str = ""
) -> list[Image.Image]:
    """Episodes side by side on the labelled map, a frame a step; the last frame is the end.

    An action of the recovery policy is marked where it was taken. Save the frames with
    ``frames[0].save(path, save_all=True, append_images=frames[1:], ...)``.

    Raises:
        ValueError: if the model has no geometry, or two states share a cell.
    """
    figure, artists = _animation_figure(model, labelling, runs, title)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    # Only what moves is drawn anew for each frame: the rest takes most of the time.
    background = canvas.copy_from_bbox(figure.bbox)
    frames = []
    for step in range(max(len(run.states) for run in runs)):
        canvas.restore_region(background)
        for run, moving in zip(runs, artists, strict=True):
            _draw_step(_geometry(model), labelling, run, moving, step)
        image = Image.frombytes("RGBA", canvas.get_width_height(), bytes(canvas.buffer_rgba()))
        frames.append(image.convert("RGB"))
    return frames


@dataclass(frozen=True, eq=False)
class _Moving:
    """What changes from frame to frame in one panel."""

    axes: Axes
    path: Line2D
    recovered: Line2D
    agent: Line2D


def _animation_figure(
    model: SafeMDP, labelling: Labelling, runs: Sequence[Run], title: str
) -> tuple[Figure, list[_Moving]]:
    geometry = _geometry(model)
    columns, rows = _extent_cells(geometry)
    height = max(3.4, 5.2 * rows / columns + 1.2) if geometry.y_down else 4.6
    figure = Figure(figsize=(5.2 * len(runs), height), dpi=80, layout="constrained")
    figure.suptitle(title)
    artists = []
    for axes in np.atleast_1d(figure.subplots(1, len(runs))):
        draw_labels(axes, geometry, labelling.labels)
        axes.set_title(" ", fontsize=11).set_animated(True)
        artists.append(
            _Moving(
                axes,
                axes.plot([], [], color="#333333", linewidth=1.6, animated=True)[0],
                axes.plot([], [], "s", markersize=7, color=LINES[2], animated=True)[0],
                axes.plot([], [], "o", markersize=11, color="black", mec="white", animated=True)[0],
            )
        )
    present = [label for label in Label if labelling.count(label)]
    handles: list[Any] = [
        Patch(facecolor=COLORS[label], label=label.name.lower().replace("_", " "))
        for label in present
    ]
    handles += [
        Line2D([], [], linestyle="", marker="o", markersize=9, color="black", label="agent"),
        Line2D([], [], linestyle="", marker="s", color=LINES[2], label="recovery policy acted"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure, artists


def _draw_step(
    geometry: Geometry, labelling: Labelling, run: Run, moving: _Moving, step: int
) -> None:
    step = min(step, len(run.states) - 1)
    points = _coordinates(geometry, run.states[: step + 1])
    moving.path.set_data(*points.T)
    moving.agent.set_data(*points[-1:].T)
    moving.recovered.set_data(*points[:-1][run.corrected[:step]].T)
    moving.axes.title.set_text(f"{run.name}: {_status(labelling, run, step)}")
    for artist in (moving.path, moving.recovered, moving.agent, moving.axes.title):
        moving.axes.draw_artist(artist)


def _status(labelling: Labelling, run: Run, step: int) -> str:
    label = Label(labelling.labels[run.states[step]])
    if label == Label.FAIL:
        return f"failed at step {step}"
    if step == len(run.states) - 1 and label >= Label.SAFE:
        return "never failed"
    if step < len(run.corrected) and run.corrected[step]:
        return "recovery policy acts"
    if label == Label.DEAD:
        time = labelling.survival_time[run.states[step]]
        return "dead-end" if time == INFINITE else f"dead-end, fails within {time} steps"
    return "task policy acts"


def _geometry(model: SafeMDP) -> Geometry:
    if model.geometry is None:
        raise ValueError("the model has no geometry, so its states have no place in a picture")
    return model.geometry


def _drawn(geometry: Geometry) -> NDArray[np.bool_]:
    """bool (S,): the states that have a place in the picture."""
    return np.asarray((geometry.cell >= 0).all(axis=1))


def _extent_cells(geometry: Geometry) -> tuple[int, int]:
    cells = np.concatenate((geometry.cell, np.array(geometry.walls, dtype=np.int32).reshape(-1, 2)))
    columns, rows = (int(size) + 1 for size in cells.max(axis=0))
    return columns, rows


def _refuse_shared_cells(geometry: Geometry, drawn: NDArray[np.bool_]) -> None:
    order = np.lexsort(geometry.cell[drawn].T)
    ordered = geometry.cell[drawn][order]
    shared = np.flatnonzero((ordered[1:] == ordered[:-1]).all(axis=1))
    if len(shared):
        states = np.flatnonzero(drawn)[order[shared[0] : shared[0] + 2]]
        raise ValueError(f"geometry: states {states.min()} and {states.max()} share a cell")


def _coordinates(geometry: Geometry, states: NDArray[np.int_]) -> NDArray[np.float64]:
    cells = geometry.cell[states].astype(np.float64)
    return np.asarray(cells * geometry.step + geometry.origin)


def _draw_grid(axes: Axes, geometry: Geometry, columns: int, rows: int) -> None:
    (x0, y0), (dx, dy) = geometry.origin, geometry.step
    axes.set_xticks(x0 + dx * (np.arange(columns + 1) - 0.5), minor=True)
    axes.set_yticks(y0 + dy * (np.arange(rows + 1) - 0.5), minor=True)
    axes.grid(which="minor", color="white", linewidth=1.0)
    axes.tick_params(which="minor", length=0)


def _draw_ends(axes: Axes, geometry: Geometry, model: SafeMDP) -> list[Line2D]:
    """An S in the corner of the cells where one starts, a G in the goals; for the legend."""
    corner = np.array(geometry.step) * (-0.36, -0.34 if geometry.y_down else 0.34)
    starts = np.zeros_like(model.fail) if model.initial is None else model.initial > 0
    handles = []
    for letter, name, states, shift in (
        ("S", "start", starts, corner),
        ("G", "goal: the episode ends", model.terminal, np.zeros(2)),
    ):
        cells = np.flatnonzero(states & _drawn(geometry))
        for x, y in _coordinates(geometry, cells) + shift:
            axes.text(x, y, letter, ha="center", va="center", fontsize=9, weight="bold")
        if len(cells):
            handles.append(_symbol(f"$\\mathbf{{{letter}}}$", name))
    return handles


def _draw_survival_times(axes: Axes, geometry: Geometry, labelling: Labelling) -> None:
    drawn = _drawn(geometry)
    for state in np.flatnonzero(labelling.dead & drawn):
        x, y = _coordinates(geometry, np.array([state]))[0]
        time = labelling.survival_time[state]
        text = "∞" if time == INFINITE else str(time)
        axes.text(x, y, text, ha="center", va="center", fontsize=10, color="black")


def _draw_arrows(
    axes: Axes, geometry: Geometry, actions: NDArray[np.bool_], labelling: Labelling
) -> None:
    assert geometry.arrows is not None
    drawn = _drawn(geometry) & labelling.paper_safe
    for action, direction in enumerate(geometry.arrows):
        states = np.flatnonzero(actions[:, action] & drawn)
        centre = _coordinates(geometry, states)
        if not any(direction):
            axes.plot(*centre.T, linestyle="", marker=".", markersize=3.5, color="black")
            continue
        length = 0.3 * np.asarray(geometry.step) * np.asarray(direction)
        length[1] *= -1 if geometry.y_down else 1
        start = centre + 0.35 * length
        axes.quiver(
            *start.T,
            *np.broadcast_to(length, start.shape).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            units="xy",
            width=0.035 * min(geometry.step),
            headwidth=4,
            headlength=4,
            headaxislength=3.5,
        )


def _outline(geometry: Geometry, inside: NDArray[np.bool_]) -> list[Any]:
    """The edges between drawn cells inside and outside a set, as segments."""
    columns, rows = _extent_cells(geometry)
    raster = np.full((rows, columns), -1)
    drawn = _drawn(geometry)
    column, row = geometry.cell[drawn].T
    raster[row, column] = inside[drawn]
    (x0, y0), (dx, dy) = geometry.origin, geometry.step
    segments = []
    for r, c in np.argwhere(_differs(raster[:, 1:], raster[:, :-1])):
        x = x0 + (c + 0.5) * dx
        segments.append([(x, y0 + (r - 0.5) * dy), (x, y0 + (r + 0.5) * dy)])
    for r, c in np.argwhere(_differs(raster[1:], raster[:-1])):
        y = y0 + (r + 0.5) * dy
        segments.append([(x0 + (c - 0.5) * dx, y), (x0 + (c + 0.5) * dx, y)])
    return _join(segments)


def _differs(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((one != other) & (one >= 0) & (other >= 0))


def _join(segments: list[Any]) -> list[Any]:
    """Chains of segments that touch, so that a dashed line stays dashed round a corner."""
    ends: dict[tuple[float, float], list[int]] = {}
    for index, segment in enumerate(segments):
        for x, y in segment:
            ends.setdefault((round(x, 9), round(y, 9)), []).append(index)
    unused = set(range(len(segments)))
    chains = []
    # Chains are begun at loose ends; what is left then are closed loops.
    starts = [i for touching in ends.values() if len(touching) != 2 for i in touching]
    for first in [*starts, *range(len(segments))]:
        if first not in unused:
            continue
        unused.discard(first)
        chain = [(round(x, 9), round(y, 9)) for x, y in segments[first]]
        if len(ends[chain[-1]]) != 2:
            chain.reverse()
        while True:
            following = [i for i in ends[chain[-1]] if i in unused]
            if not following:
                break
            unused.discard(following[0])
            one, two = [(round(x, 9), round(y, 9)) for x, y in segments[following[0]]]
            chain.append(two if one == chain[-1] else one)
        chains.append(chain)
    return chains


def _name_region(axes: Axes, geometry: Geometry, labels: NDArray[np.uint8], label: Label) -> None:
    """A subset's name at the drawn cell of the subset that lies deepest inside it."""
    from scipy.ndimage import distance_transform_edt

    columns, rows = _extent_cells(geometry)
    raster = np.zeros((rows + 2, columns + 2), dtype=bool)
    drawn = _drawn(geometry) & (labels == label)
    if not drawn.any():
        return
    column, row = geometry.cell[drawn].T
    raster[row + 1, column + 1] = True
    # A name is wider than high: depth counts less across.
    depth = distance_transform_edt(raster, sampling=(1.0, rows / columns * 0.4))
    deepest = np.argwhere(depth >= 0.95 * depth.max())
    middle = deepest[np.argmin(np.abs(deepest - deepest.mean(axis=0)).sum(axis=1))]
    y, x = (middle - 1) * geometry.step[::-1] + geometry.origin[::-1]
    narrow = np.ptp(column) < 0.1 * columns
    color = "white" if label == Label.FAIL else "black"
    name = {Label.FAIL: "fail", Label.DEAD: "dead", Label.SAFE: "safe"}[label]
    axes.text(
        x,
        y,
        rf"$\mathcal{{S}}_{{\mathrm{{{name}}}}}$",
        color=color,
        fontsize=20,
        ha="center",
        va="center",
        rotation=90 if narrow else 0,
    )


def _draw_blocked(axes: Axes, blocked: Sequence[Blocked], thresholds: Sequence[str]) -> None:
    """A row a critic, a marker a threshold: the share of safe actions that it blocks."""
    markers = ("o", "s", "D", "^")
    colors = ("#000000", "#0072B2", "#D55E00", "#117733")
    height = np.arange(len(blocked))[::-1]
    axes.hlines(height, 0, 100, color="#DDDDDD", linewidth=1)
    offsets = np.linspace(0.18, -0.18, len(thresholds))
    for index, threshold in enumerate(thresholds):
        shares = [100 * row.share[index] for row in blocked]
        axes.plot(
            shares,
            height + offsets[index],
            linestyle="",
            marker=markers[index],
            markersize=8,
            color=colors[index],
            label=threshold,
            clip_on=False,
        )
    axes.set_yticks(height, [row.name for row in blocked])
    axes.set_xlim(-3, 103)
    axes.set_ylim(-0.6, len(blocked) - 0.4)
    axes.set_xlabel("safe actions blocked (%)")
    axes.legend(
        title="threshold",
        loc="upper center",
        bbox_to_anchor=(0.5, -0.14),
        ncols=len(thresholds),
        frameon=False,
    )
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.set_title("What each critic takes away", loc="left")
