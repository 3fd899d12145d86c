"""Where ``deep`` meets the exact answer: the one module that knows both.

Brake and the double integrator have a closed form, in their own modules; here it is
also confronted with the tabular twins of ``dead_ends``. Nothing here enters data,
training, model selection or thresholds, except the number H.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dead_ends.envs.brake import BrakeLattice, brake
from dead_ends.envs.double_integrator import double_integrator
from dead_ends.labels import classify
from deep.tasks import Brake, DoubleIntegrator, Task
from deep.tasks.task import Bools, Floats

__all__ = [
    "ExactAnswer",
    "ExactTask",
    "exact_answer",
    "oracle_blocks",
    "tabular_brake_dead",
    "tabular_double_integrator",
]

ExactTask: TypeAlias = Brake | DoubleIntegrator


@dataclass(frozen=True)
class ExactAnswer:
    """The true labels of a task's states.

    Attributes:
        task: the task.
        horizon: H.
        dead: states (n, d) -> bool (n,), S_dead.
        boundary_distance: states -> float (n,), along the first coordinate.
    """

    task: ExactTask
    horizon: int
    dead: Callable[[Floats], Bools]
    boundary_distance: Callable[[Floats], Floats]

    def safe(self, state: Floats) -> Bools:
        """bool (n,): neither a violation nor dead (T is infinite)."""
        return np.asarray(self.task.survival_time(state) == -1)


def exact_answer(task: Task) -> ExactAnswer:
    """The answer in closed form.

    Raises:
        ValueError: if the task has none.
    """
    if not isinstance(task, Brake | DoubleIntegrator):
        raise ValueError(
            f"{task.name}: there is no exact answer; brake and double-integrator have one"
        )
    return ExactAnswer(task, task.horizon, task.dead, task.boundary_distance)


def oracle_blocks(answer: ExactAnswer, state: Floats, action: NDArray[np.floating]) -> Bools:
    """bool (n,): whether the action leaves the safe set; the limit of every filter.

    The tasks with an exact answer are deterministic: no generator is consulted.
    """
    step = answer.task.step(state, action, np.random.default_rng(0))
    return step.violation | answer.dead(step.next_state)


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
