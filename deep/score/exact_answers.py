"""Where ``deep`` meets the exact answer: the one module that knows both.

Brake and the double integrator have a closed form, in their own modules; here it is
also confronted with the tabular twins of ``dead_ends``. The point and the Dubins car are
each enclosed by two models of ``dead_ends``. The two Navigation tasks have no dead-ends.
Nothing here enters data, training, model selection or thresholds, except the number H.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dead_ends.envs.brake import BrakeLattice, brake
from dead_ends.envs.double_integrator import double_integrator
from dead_ends.envs.dubins import dubins
from dead_ends.envs.point import PointModel, point_among_discs
from dead_ends.labels.classification import classify
from dead_ends.labels.implicit import SURVIVES, classify_implicit
from deep.tasks import Brake, DoubleIntegrator, Dubins, Navigation, PointAmongDiscs, Task
from deep.tasks.shapes import inside_any
from deep.tasks.task import Bools, Floats

__all__ = [
    "ExactAnswer",
    "ExactTask",
    "enclosed_point",
    "exact_answer",
    "oracle_allows",
    "oracle_blocks",
    "tabular_brake_dead",
    "tabular_double_integrator",
]

ClosedFormTask: TypeAlias = Brake | DoubleIntegrator
ExactTask: TypeAlias = ClosedFormTask | Navigation


@dataclass(frozen=True)
class ExactAnswer:
    """What is certain about a task's states.

    Attributes:
        task: the task.
        horizon: H; for enclosed tasks that of the outer model.
        dead, safe: states (n, d) -> bool (n,), certainly dead, certainly safe. Where the
            answer is in closed form, each state that is no violation is one of them.
        boundary_distance: states -> float (n,), along the first coordinate; None for
            enclosed tasks and where no state is dead.
    """

    task: Task
    horizon: int
    dead: Callable[[Floats], Bools]
    safe: Callable[[Floats], Bools]
    boundary_distance: Callable[[Floats], Floats] | None


def exact_answer(task: Task) -> ExactAnswer:
    """The answer in closed form, or enclosed.

    Raises:
        ValueError: if the task has neither.
    """
    match task:
        case Brake() | DoubleIntegrator():
            return _closed_form(task)
        case Dubins():
            return _enclosed_dubins(task)
        case PointAmongDiscs():
            return enclosed_point(task, POINT_RESOLUTION)
        case Navigation():
            return _without_dead_ends(task)
        case _:
            raise ValueError(
                f"{task.name}: there is no exact answer; brake, double-integrator, point, "
                "dubins, navigation1 and navigation2 have one"
            )


def _without_dead_ends(task: Navigation) -> ExactAnswer:
    """Every state outside the obstacles is safe: H = 0."""

    def dead(state: Floats) -> Bools:
        return np.zeros(len(state), dtype=np.bool_)

    def safe(state: Floats) -> Bools:
        return ~inside_any(task.obstacles, state)

    return ExactAnswer(task, 0, dead, safe, None)


def _closed_form(task: ClosedFormTask) -> ExactAnswer:
    def safe(state: Floats) -> Bools:
        return np.asarray(task.survival_time(state) == -1)

    return ExactAnswer(task, task.horizon, task.dead, safe, task.boundary_distance)


DUBINS_RESOLUTION = 10
"""Position cells in the length of a step."""


def _enclosed_dubins(task: Dubins) -> ExactAnswer:
    """Inner and outer safe sets on a grid; between them nothing is certain.

    Raises:
        ValueError: if the side of the square is no whole number of steps.
    """
    length = 2 * task.half_width
    if length != round(length):
        raise ValueError(f"dubins: the square's side {length:g} is no whole number of steps")
    pair = dubins(round(length), DUBINS_RESOLUTION, task.headings, task.turn, task.pillar_radius)
    inner, outer = classify(pair.inner), classify(pair.outer)

    def cell(state: Floats) -> NDArray[np.int64]:
        corner = state[:, :2] + task.half_width
        return pair.grid.cell_of(np.column_stack([corner, state[:, 2] % (2 * np.pi)]))

    def safe(state: Floats) -> Bools:
        return inner.safe[cell(state)]

    def dead(state: Floats) -> Bools:
        violation = inside_any(task.obstacles, state[:, :2])
        return ~outer.safe[cell(state)] & ~violation

    assert outer.horizon is not None  # finite and deterministic
    return ExactAnswer(task, outer.horizon, dead, safe, None)


POINT_RESOLUTION = 3
"""Cells in the change of velocity of a step: 220 million states, less than a minute."""


def enclosed_point(task: PointAmongDiscs, resolution: int) -> ExactAnswer:
    """Inner and outer safe sets on a lattice; between them nothing is certain.

    H is that of the outer model's states. A point all of whose actions lead to such dead states
    may survive a step longer.
    """
    pair = point_among_discs(
        [(disc.x, disc.y, disc.radius) for disc in task.discs],
        task.half_width,
        task.max_speed,
        resolution,
        acceleration=task.acceleration,
        time_step=task.dt,
    )
    goes_on_inside, _ = _lasting(pair.inner)
    goes_on_outside, horizon = _lasting(pair.outer)

    def safe(state: Floats) -> Bools:
        return goes_on_inside(state) & ~inside_any(task.obstacles, state[:, :2])

    def dead(state: Floats) -> Bools:
        return ~goes_on_outside(state) & ~inside_any(task.obstacles, state[:, :2])

    return ExactAnswer(task, horizon, dead, safe, None)


def _lasting(model: PointModel) -> tuple[Callable[[Floats], Bools], int]:
    """Whether an action leads on to states that need not fail; H in steps of the point."""
    labelling = classify_implicit(model.successor, model.fail, model.num_states, model.num_actions)
    lasting = labelling.survival_time[model.between] == SURVIVES

    def goes_on(state: Floats) -> Bools:
        return ~np.isnan(model.next_velocity(state, lasting)[:, 0])

    return goes_on, labelling.horizon // 2


def oracle_blocks(answer: ExactAnswer, state: Floats, action: NDArray[np.floating]) -> Bools:
    """bool (n,): whether the action certainly leads to a dead state or a violation.

    All but Navigation are deterministic: no generator is consulted.
    """
    if isinstance(answer.task, Navigation):
        return answer.task.enters(state, action)
    step = answer.task.step(state, action, np.random.default_rng(0))
    return step.violation | answer.dead(step.next_state)


def oracle_allows(answer: ExactAnswer, state: Floats, action: NDArray[np.floating]) -> Bools:
    """bool (n,): whether the action certainly leads to a safe state."""
    if isinstance(answer.task, Navigation):
        return answer.task.misses(state, action)
    step = answer.task.step(state, action, np.random.default_rng(0))
    return ~step.violation & answer.safe(step.next_state)


def tabular_brake_dead(task: Brake) -> tuple[Floats, Bools]:
    """The brake on integer distances and speeds, and its dead set by retrograde analysis.

    The tabular car may stand at the obstacle, the continuous one may not touch it: a
    tabular distance d stands for d + 1.

    Raises:
        ValueError: if the task's numbers are not integers.
    """
    numbers = (task.max_distance, task.max_speed, task.acceleration)
    if any(number != round(number) for number in numbers):
        raise ValueError(f"brake: {numbers} are not integers, so there is no tabular twin")
    lattice = BrakeLattice(
        max_distance=round(task.max_distance) - 1,
        max_speed=round(task.max_speed),
        max_braking=round(task.acceleration),
        max_acceleration=round(task.acceleration),
        obstacle_depth=round(task.max_speed) + 1,
    )
    labelling = classify(brake(lattice))
    distances = np.arange(-lattice.obstacle_depth, lattice.max_distance + 1) + 1.0
    speeds = np.arange(lattice.max_speed + 1.0)
    states = np.stack(np.meshgrid(distances, speeds, indexing="ij"), axis=-1).reshape(-1, 2)
    return states, labelling.dead


def tabular_double_integrator(
    task: DoubleIntegrator, resolution: int
) -> tuple[Floats, Floats, Bools, Bools]:
    """Cells that enclose the safe set: least corners, widths, certainly safe, perhaps safe.

    Raises:
        ValueError: if the gap between the walls is no whole number of A dt^2.
    """
    unit = task.acceleration * task.dt**2
    length = 2 / unit
    if abs(length - round(length)) > 1e-9:
        raise ValueError(f"double integrator: the gap is {length:g} units of A dt^2, not a whole")
    # One unit of speed more than the task's: there, speeds are a violation, here a limit.
    speeds = int(np.ceil(task.max_speed / (task.acceleration * task.dt))) + 1
    pair = double_integrator(
        round(length),
        speeds,
        resolution,
        acceleration=task.acceleration,
        time_step=task.dt,
    )
    cells = slice(0, pair.grid.num_cells)
    corners = pair.grid.corners() - (1.0, 0.0)
    inner, outer = classify(pair.inner).safe[cells], classify(pair.outer).safe[cells]
    return corners, np.array(pair.grid.width), inner, outer
