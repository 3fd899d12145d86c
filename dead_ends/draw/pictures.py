"""Pictures: results in, :class:`matplotlib.figure.Figure` out. Nothing is solved or saved here.

A model is drawn cell by cell through its :class:`dead_ends.model.safe_mdp.Geometry`, in the colors
of :mod:`dead_ends.draw.palette`; each subset is named in the picture besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dead_ends.draw.geometry import (
    COLORS,
    MAX_NUMBERED_CELLS,
    coordinates,
    draw_labels,
    drawn_states,
    extent_cells,
    geometry_of,
    outline,
)
from dead_ends.draw.palette import LINES, WALL
from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.safe_mdp import Geometry, SafeMDP, require_type

__all__ = ["Blocked", "Boundary", "plot_boundaries", "plot_map"]

NAMES = {
    Label.FAIL: "failed",
    Label.DEAD: "dead-end: fails whatever it does",
    Label.SAFE: "safe: some policy never fails",
    Label.AT_RISK: "at risk: may fail, need not",
}
STYLES: tuple[Any, ...] = (
    "-",
    (0, (5, 2)),
    (0, (1, 1.2)),
    (0, (6, 2, 1, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)


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
    require_type(model, SafeMDP, "plot_map")
    require_type(labelling, Labelling, "plot_map")
    geometry = geometry_of(model)
    columns, rows = extent_cells(geometry)
    width = min(11.0, max(5.0, 0.62 * columns + 1.2))
    height = max(2.6, width * rows / columns + 1.5)
    figure = Figure(figsize=(width, min(height, 9.0)), layout="constrained")
    axes = figure.add_subplot()
    draw_labels(axes, geometry, labelling.labels)
    drawn = np.flatnonzero(drawn_states(geometry))
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
    return [Patch(facecolor=color, edgecolor="grey", label=name) for color, name in kinds]


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
    require_type(model, SafeMDP, "plot_boundaries")
    require_type(labelling, Labelling, "plot_boundaries")
    geometry = geometry_of(model)
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
        line = outline(geometry, boundary.unsafe)
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


def _draw_ends(axes: Axes, geometry: Geometry, model: SafeMDP) -> list[Line2D]:
    """An S in the corner of the cells where one starts, a G in the goals; for the legend."""
    corner = np.array(geometry.step) * (-0.36, -0.34 if geometry.y_down else 0.34)
    starts = np.zeros_like(model.fail) if model.initial is None else model.initial > 0
    handles = []
    for letter, name, states, shift in (
        ("S", "start", starts, corner),
        ("G", "goal: the episode ends", model.terminal, np.zeros(2)),
    ):
        cells = np.flatnonzero(states & drawn_states(geometry))
        for x, y in coordinates(geometry, cells) + shift:
            axes.text(x, y, letter, ha="center", va="center", fontsize=9, weight="bold")
        if len(cells):
            handles.append(_symbol(f"$\\mathbf{{{letter}}}$", name))
    return handles


def _draw_survival_times(axes: Axes, geometry: Geometry, labelling: Labelling) -> None:
    drawn = drawn_states(geometry)
    for state in np.flatnonzero(labelling.dead & drawn):
        x, y = coordinates(geometry, np.array([state]))[0]
        time = labelling.survival_time[state]
        text = "∞" if time == INFINITE else str(time)
        axes.text(x, y, text, ha="center", va="center", fontsize=10, color="black")


def _draw_arrows(
    axes: Axes, geometry: Geometry, actions: NDArray[np.bool_], labelling: Labelling
) -> None:
    assert geometry.arrows is not None
    drawn = drawn_states(geometry) & labelling.paper_safe
    for action, direction in enumerate(geometry.arrows):
        states = np.flatnonzero(actions[:, action] & drawn)
        centre = coordinates(geometry, states)
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


def _name_region(axes: Axes, geometry: Geometry, labels: NDArray[np.uint8], label: Label) -> None:
    """A subset's name at the drawn cell of the subset that lies deepest inside it."""
    from scipy.ndimage import distance_transform_edt

    columns, rows = extent_cells(geometry)
    raster = np.zeros((rows + 2, columns + 2), dtype=bool)
    drawn = drawn_states(geometry) & (labels == label)
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
    fills = ("black", "grey", "white", "lightgrey")
    height = np.arange(len(blocked))[::-1]
    axes.hlines(height, 0, 100, color="lightgrey", linewidth=1)
    offsets = np.linspace(0.18, -0.18, len(thresholds))
    for index, threshold in enumerate(thresholds):
        shares = [100 * row.share[index] for row in blocked]
        axes.plot(
            shares,
            height + offsets[index],
            linestyle="",
            marker=markers[index],
            markersize=8,
            color=fills[index],
            markeredgecolor="black",
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
