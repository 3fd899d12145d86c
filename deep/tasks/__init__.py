"""Small continuous tasks, batch-vectorised; importing this registers ``deep/Brake-v0`` etc."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium

from deep.tasks.brake import Brake
from deep.tasks.double_integrator import DoubleIntegrator
from deep.tasks.dubins import Dubins
from deep.tasks.environment import TaskEnv, TaskVectorEnv
from deep.tasks.navigation import Navigation, navigation1, navigation2
from deep.tasks.point import PointAmongDiscs
from deep.tasks.safety_gym.tasks import CarGoal1, DynamicEnv, PointGoal1, StaticEnv
from deep.tasks.task import Step, Task

__all__ = [
    "TASK_NAMES",
    "Brake",
    "CarGoal1",
    "DoubleIntegrator",
    "Dubins",
    "DynamicEnv",
    "Navigation",
    "PointAmongDiscs",
    "PointGoal1",
    "StaticEnv",
    "Step",
    "Task",
    "TaskEnv",
    "TaskVectorEnv",
    "make_task",
    "navigation1",
    "navigation2",
]


def double_integrator_fine() -> DoubleIntegrator:
    """The double integrator at half the time step: twice the horizon, 10 steps."""
    return DoubleIntegrator(dt=0.1)


_BUILDERS: dict[str, Callable[[], Task]] = {
    "brake": Brake,
    "double-integrator": DoubleIntegrator,
    "double-integrator-fine": double_integrator_fine,
    "point": PointAmongDiscs,
    "dubins": Dubins,
    "navigation1": navigation1,
    "navigation2": navigation2,
    "static-env": StaticEnv,
    "dynamic-env": DynamicEnv,
    "point-goal1": PointGoal1,
    "car-goal1": CarGoal1,
}
TASK_NAMES = tuple(_BUILDERS)

ENVIRONMENT_IDS = {
    "deep/Brake-v0": "brake",
    "deep/DoubleIntegrator-v0": "double-integrator",
    "deep/Point-v0": "point",
    "deep/Dubins-v0": "dubins",
    "deep/Navigation1-v0": "navigation1",
    "deep/Navigation2-v0": "navigation2",
    "deep/StaticEnv-v0": "static-env",
    "deep/DynamicEnv-v0": "dynamic-env",
    "deep/PointGoal1-v0": "point-goal1",
    "deep/CarGoal1-v0": "car-goal1",
}


def make_task(name: str) -> Task:
    """The task of this name with its default parameters.

    Raises:
        ValueError: if there is no task of this name.
    """
    if name not in _BUILDERS:
        raise ValueError(f"there is no task {name!r}; there are {', '.join(TASK_NAMES)}")
    return _BUILDERS[name]()


def make_environment(task: str, render_mode: str | None = None) -> TaskEnv:
    """The Gymnasium environment of a task, by the task's name."""
    return TaskEnv(make_task(task), render_mode)


for _id, _name in ENVIRONMENT_IDS.items():
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point="deep.tasks:make_environment", kwargs={"task": _name})
