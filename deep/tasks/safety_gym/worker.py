"""The process that runs the real Safety-Gymnasium, in a Python environment of its own.

Safety-Gymnasium needs versions of Gymnasium and MuJoCo that the rest of this package cannot
use. So this file is run as a script by ``real.py``, with the Python of the environment that
``scripts/install_safety_gymnasium.sh`` makes; it imports nothing of ``deep``. Requests and
answers are pickles on standard input and output.

Two repairs make Safety-Gymnasium 1.0.0 usable: array defaults of its dataclasses become
factories (Python 3.11 refuses them otherwise), and the decoration of the sky is left out of
the model (decoding its images takes over a second at every reset; the physics are the same).
"""

from __future__ import annotations

import dataclasses
import os
import pickle
import sys
from importlib import import_module
from types import SimpleNamespace
from typing import Any, BinaryIO

import numpy as np

IDENTIFIERS = {
    "static-env": "SafetyPointStatic0-v0",
    "dynamic-env": "SafetyPointDynamic0-v0",
    "point-goal1": "SafetyPointGoal1-v0",
    "car-goal1": "SafetyCarGoal1-v0",
    "doggo-goal1": "SafetyDoggoGoal1-v0",
    "point-alone": "SafetyPointGoal0-v0",
    "car-alone": "SafetyCarGoal0-v0",
}


def mend_dataclasses() -> None:
    """Let array defaults of dataclass fields be copied for each instance."""
    original = dataclasses._get_field  # type: ignore[attr-defined]  # the one hook there is

    def get_field(cls: Any, name: str, *rest: Any) -> Any:
        default = getattr(cls, name, dataclasses.MISSING)
        if isinstance(default, np.ndarray):
            setattr(cls, name, dataclasses.field(default_factory=default.copy))
        return original(cls, name, *rest)

    dataclasses._get_field = get_field  # type: ignore[attr-defined]


def remove_sky(world: Any) -> None:
    """Drop the sky's texture whenever the module ``world`` writes a model's XML."""
    xmltodict = world.xmltodict

    def unparse(tree: Any) -> str:
        assets = tree["mujoco"]["asset"]
        assets["texture"] = [t for t in assets["texture"] if t.get("@type") != "skybox"]
        return str(xmltodict.unparse(tree))

    world.xmltodict = SimpleNamespace(parse=xmltodict.parse, unparse=unparse)


def add_tasks() -> None:
    """StaticEnv and DynamicEnv: the goal task with other hazards."""
    tasks: Any = import_module("safety_gymnasium.tasks")
    geoms: Any = import_module("safety_gymnasium.assets.geoms")

    class StaticLevel0(tasks.GoalLevel0):  # type: ignore[misc]  # no types there
        def __init__(self, config: Any) -> None:
            super().__init__(config=config)
            self.placements_conf.extents = [-1.5, -1.5, 1.5, 1.5]
            self.goal.locations = [(1.1, 1.1)]
            self._add_geoms(geoms.Hazards(num=1, size=0.7, keepout=0.705, locations=[(0.0, 0.0)]))

    class DynamicLevel0(tasks.GoalLevel0):  # type: ignore[misc]  # no types there
        def __init__(self, config: Any) -> None:
            super().__init__(config=config)
            self.placements_conf.extents = [-1.5, -1.5, 1.5, 1.5]
            self._add_geoms(geoms.Hazards(num=3, size=0.3, keepout=0.305))

    tasks.StaticLevel0, tasks.DynamicLevel0 = StaticLevel0, DynamicLevel0


def prepare() -> None:
    """Import Safety-Gymnasium with the repairs."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    mend_dataclasses()
    import_module("safety_gymnasium")
    remove_sky(import_module("safety_gymnasium.world"))
    add_tasks()


def _positions(task: Any) -> list[Any]:
    vases = task.vases.pos if hasattr(task, "vases") else []
    return [task.goal.pos, *task.hazards.pos, *vases]


class Copies:
    """n environments of one task, each stepped in turn."""

    def __init__(self, name: str, count: int, render: bool) -> None:
        builder = import_module("safety_gymnasium.builder").Builder
        identifier = IDENTIFIERS[name]
        robot = next(r for r in ("Point", "Car", "Doggo") if identifier.startswith(f"Safety{r}"))
        mode = {"render_mode": "rgb_array", "camera_name": "fixedfar"} if render else {}
        self.copies = [
            builder(identifier, config={"agent_name": robot}, **mode) for _ in range(count)
        ]

    def spaces(self) -> dict[str, Any]:
        """Dimensions of observations and actions."""
        copy = self.copies[0]
        return {
            "observation_low": copy.observation_space.low,
            "observation_high": copy.observation_space.high,
            "action_dim": copy.action_space.shape[0],
        }

    def reset(self, index: int, seed: int) -> Any:
        """Begin an episode in one copy; the observation."""
        return self.copies[index].reset(seed=seed)[0]

    def step(self, actions: Any) -> dict[str, Any]:
        """One step of every copy; an episode ends at the first cost."""
        rows = [self._row(copy, action) for copy, action in zip(self.copies, actions, strict=True)]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _row(self, copy: Any, action: Any) -> dict[str, Any]:
        observation, reward, cost, terminated, truncated, _ = copy.step(action)
        return {
            "observation": observation,
            "reward": reward,
            "violation": cost > 0,
            "success": terminated and not cost > 0,
            "timeout": truncated,
        }

    def poses(self) -> Any:
        """float (n, 3): x, y and heading of each robot."""
        agents = [copy.task.agent for copy in self.copies]
        return np.array([(*a.pos[:2], np.arctan2(a.mat[1, 0], a.mat[0, 0])) for a in agents])

    def objects(self) -> Any:
        """float (n, objects, 2): goal, hazards and vases of each copy."""
        return np.array([[pos[:2] for pos in _positions(copy.task)] for copy in self.copies])

    def lift(self, height: float) -> None:
        """Raise every robot that can fall, at the beginning of its episode."""
        for copy in self.copies:
            data = copy.task.data
            if copy.task.agent.body_info.nq > 3:
                data.qpos[2] += height

    def lay_hazard(self, index: int) -> None:
        """Lay a hazard under one robot until its episode ends, which its next step does."""
        task = self.copies[index].task
        task.model.body("hazard0").pos[:2] = task.agent.pos[:2]

    def render(self, index: int) -> Any:
        """The picture of one copy."""
        return self.copies[index].render()


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer (method, arguments) by (True, result) or (False, message), until the input ends."""
    prepare()
    copies: Copies | None = None
    while True:
        try:
            method, arguments = pickle.load(requests)
        except EOFError:
            return
        try:
            if method == "make":
                copies = Copies(*arguments)
                answer: tuple[bool, Any] = (True, copies.spaces())
            else:
                answer = (True, getattr(copies, method)(*arguments))
        except Exception as error:  # whatever goes wrong there is reported here
            answer = (False, f"{type(error).__name__}: {error}")
        pickle.dump(answer, answers)
        answers.flush()


if __name__ == "__main__":
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print is no answer
    serve(sys.stdin.buffer, answers)
