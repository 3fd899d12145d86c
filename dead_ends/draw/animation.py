"""Episodes as moving pictures: the labelled map, and agents that move on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL import Image

from dead_ends.draw.geometry import (
    COLORS,
    coordinates,
    draw_labels,
    extent_cells,
    geometry_of,
)
from dead_ends.draw.palette import AGENT, RECOVERY
from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.safe_mdp import Geometry, SafeMDP, require_type

__all__ = ["Episode", "animate_episodes"]


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode: states (T+1,), and whether the recovery policy acted, bool (T,)."""

    name: str
    states: NDArray[np.int_]
    corrected: NDArray[np.bool_]


def animate_episodes(
    model: SafeMDP, labelling: Labelling, episodes: Sequence[Episode], *, title: str = ""
) -> list[Image.Image]:
    """Episodes side by side on the labelled map, a frame a step; the last frame is the end.

    An action of the recovery policy is marked where it was taken. Save the frames with
    ``frames[0].save(path, save_all=True, append_images=frames[1:], ...)``.

    Raises:
        ValueError: if the model has no geometry, or two states share a cell.
    """
    require_type(model, SafeMDP, "animate_episodes")
    require_type(labelling, Labelling, "animate_episodes")
    figure, artists = _animation_figure(model, labelling, episodes, title)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    # Only what moves is drawn anew for each frame: the rest takes most of the time.
    background = canvas.copy_from_bbox(figure.bbox)
    frames = []
    for step in range(max(len(episode.states) for episode in episodes)):
        canvas.restore_region(background)
        for episode, moving in zip(episodes, artists, strict=True):
            _draw_step(geometry_of(model), labelling, episode, moving, step)
        image = Image.frombytes("RGBA", canvas.get_width_height(), bytes(canvas.buffer_rgba()))
        frames.append(image.convert("RGB"))
    return frames


_DOT = {"linestyle": "", "markeredgecolor": "white", "color": AGENT}
MARKS: tuple[dict[str, Any], ...] = (
    {"color": AGENT, "linewidth": 1.6},
    _DOT | {"marker": "s", "markersize": 7, "color": RECOVERY, "markeredgecolor": AGENT},
    _DOT | {"marker": "o", "markersize": 11},
)
"""The agent's path, the steps in which the recovery policy acted, and the agent."""


@dataclass(frozen=True, eq=False)
class _Moving:
    """What changes from frame to frame in one panel."""

    axes: Axes
    path: Line2D
    recovered: Line2D
    agent: Line2D


def _animation_figure(
    model: SafeMDP, labelling: Labelling, episodes: Sequence[Episode], title: str
) -> tuple[Figure, list[_Moving]]:
    geometry = geometry_of(model)
    columns, rows = extent_cells(geometry)
    height = max(3.4, 5.2 * rows / columns + 1.2) if geometry.y_down else 4.6
    figure = Figure(figsize=(5.2 * len(episodes), height), dpi=80, layout="constrained")
    figure.suptitle(title)
    artists = []
    for axes in np.atleast_1d(figure.subplots(1, len(episodes))):
        draw_labels(axes, geometry, labelling.labels)
        axes.set_title(" ", fontsize=11).set_animated(True)
        path, recovered, agent = (axes.plot([], [], **mark, animated=True)[0] for mark in MARKS)
        artists.append(_Moving(axes, path, recovered, agent))
    present = [label for label in Label if labelling.count(label)]
    handles: list[Any] = [
        Patch(facecolor=COLORS[label], label=label.name.lower().replace("_", " "))
        for label in present
    ]
    handles += [
        Line2D([], [], **mark, label=name)
        for mark, name in zip(MARKS[1:], ("recovery policy acted", "agent"), strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure, artists


def _draw_step(
    geometry: Geometry, labelling: Labelling, episode: Episode, moving: _Moving, step: int
) -> None:
    step = min(step, len(episode.states) - 1)
    points = coordinates(geometry, episode.states[: step + 1])
    moving.path.set_data(*points.T)
    moving.agent.set_data(*points[-1:].T)
    moving.recovered.set_data(*points[:-1][episode.corrected[:step]].T)
    moving.axes.title.set_text(f"{episode.name}: {_status(labelling, episode, step)}")
    for artist in (moving.path, moving.recovered, moving.agent, moving.axes.title):
        moving.axes.draw_artist(artist)


def _status(labelling: Labelling, episode: Episode, step: int) -> str:
    label = Label(labelling.labels[episode.states[step]])
    if label == Label.FAIL:
        return f"failed at step {step}"
    if step == len(episode.states) - 1 and label >= Label.SAFE:
        return "never failed"
    if step < len(episode.corrected) and episode.corrected[step]:
        return "recovery policy acts"
    if label == Label.DEAD:
        time = labelling.survival_time[episode.states[step]]
        return "dead-end" if time == INFINITE else f"dead-end, fails within {time} steps"
    return "task policy acts"
