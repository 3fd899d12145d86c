"""Scores and filters -> figures; nothing here trains or saves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from dead_ends.draw.palette import BLOCKED, DEAD, FAIL, LET_THROUGH, LINES, SAFE, UNKNOWN
from deep.filter.safety_filter import SafetyFilter
from deep.score.boundary import LearnedFilter, action_grid
from deep.score.exact_answers import ExactAnswer
from deep.tasks.shapes import inside_any
from deep.tasks.task import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["boundary_axes", "boundary_figure", "learned_value", "sweep_figure"]

CELLS = 160
ACTIONS = {1: 17, 2: 5}
"""Of the grid in each action coordinate, by how many there are."""
LEARNED = LINES[2]


@dataclass(frozen=True)
class SweepScore:
    """Both errors of one seed at one value of one parameter.

    Attributes:
        parameter: its name.
        value: its value; for epsilon a share of gamma_safe^H.
        seed: the seed.
        dead_called_safe, safe_called_dead: shares in [0, 1].
    """

    parameter: str
    value: float
    seed: int
    dead_called_safe: float
    safe_called_dead: float


def _box_grid(answer: ExactAnswer) -> tuple[Floats, Floats, Floats]:
    """Axes of a grid over the first two coordinates, and its points."""
    low, high = answer.task.region
    x, y = (np.linspace(a, b, CELLS) for a, b in zip(low[:2], high[:2], strict=True))
    points = np.tile(answer.task.drawn_state, (CELLS**2, 1))
    points[:, :2] = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return x, y, points


def learned_value(answer: ExactAnswer, safety: SafetyFilter, points: Floats) -> Floats:
    """float (n,): min over a dense grid of actions of Q_c."""
    scored = LearnedFilter(answer.task, safety)
    least = np.full(len(points), np.inf)
    for action in action_grid(answer.task.action_dim, ACTIONS[answer.task.action_dim]):
        repeated = np.broadcast_to(action, (len(points), len(action)))
        least = np.minimum(least, scored.critic(points, repeated))
    return least


def boundary_axes(
    axes: Axes, answer: ExactAnswer, filters: Sequence[SafetyFilter], title: str
) -> None:
    """The exact dead set, and each filter's boundary min_a Q_c = epsilon as a line."""
    x, y, points = _box_grid(answer)
    violation = inside_any(answer.task.obstacles, answer.task.position(points))
    label = np.select([violation, answer.dead(points), answer.safe(points)], [3, 2, 0], default=1)
    axes.pcolormesh(
        x,
        y,
        label.reshape(CELLS, CELLS),
        cmap=ListedColormap([SAFE, UNKNOWN, DEAD, FAIL]),
        vmin=-0.5,
        vmax=3.5,
        shading="nearest",
        rasterized=True,
    )
    for safety in filters:
        value = learned_value(answer, safety, points).reshape(CELLS, CELLS)
        if value.min() < safety.threshold < value.max():
            axes.contour(
                x, y, value, levels=[safety.threshold], colors=LEARNED, linewidths=0.8, alpha=0.8
            )
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(answer.task.state_names[0])
    axes.set_ylabel(answer.task.state_names[1])


def boundary_figure(answer: ExactAnswer, filters: Mapping[str, Sequence[SafetyFilter]]) -> Figure:
    """One panel a method: the learned boundaries of all seeds over the exact sets."""
    columns = min(len(filters), 3)
    rows = -(-len(filters) // columns)
    figure = Figure(figsize=(max(3.6 * columns, 5.5), 3.0 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (method, trained) in zip(grid.flat, filters.items(), strict=False):
        epsilon, gamma = trained[0].threshold, trained[0].gamma_safe
        boundary_axes(axes, answer, trained, f"{method}: γ = {gamma:.3g}, ε = {epsilon:.3g}")
        axes.label_outer()
    for axes in grid.flat[len(filters) :]:
        axes.set_axis_off()
    figure.suptitle(
        f"{answer.task.name}{_fixed_coordinates(answer)}: dead-ends (orange) and learned "
        "boundaries (blue, one a seed)",
        fontsize=10,
    )
    return figure


def _fixed_coordinates(answer: ExactAnswer) -> str:
    """What is fixed in the pictures of a task with more than two coordinates."""
    task = answer.task
    pairs = list(zip(task.state_names, task.drawn_state, strict=True))[2:]
    return "".join(f", {name} = {value:g}" for name, value in pairs)


def sweep_figure(task: str, scores: Sequence[SweepScore]) -> Figure:
    """One panel a parameter: both errors in percent, the mean and all seeds."""
    parameters = list(dict.fromkeys(score.parameter for score in scores))
    figure = Figure(figsize=(3.2 * len(parameters), 3.0), layout="constrained")
    panels = figure.subplots(1, len(parameters), squeeze=False, sharey=True)[0]
    for axes, parameter in zip(panels, parameters, strict=True):
        rows = [score for score in scores if score.parameter == parameter]
        values = sorted({row.value for row in rows})
        for name, color in (("dead_called_safe", LET_THROUGH), ("safe_called_dead", BLOCKED)):
            mean = [
                100 * float(np.mean([getattr(r, name) for r in rows if r.value == value]))
                for value in values
            ]
            axes.plot(values, mean, color=color, marker="o", label=name.replace("_", " "))
            dots = [100 * getattr(row, name) for row in rows]
            axes.scatter([row.value for row in rows], dots, color=color, s=6, alpha=0.5)
        axes.set_xlabel(parameter)
        if parameter in ("last expectile", "epsilon / gamma_safe^H"):
            axes.set_xscale("log")
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("percent of the states")
    panels[0].legend(fontsize=8)
    figure.suptitle(f"{task}: DEA-RRL (annealed), one parameter varied at a time", fontsize=10)
    return figure
