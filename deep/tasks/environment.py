"""Tasks as Gymnasium environments: one copy, or many that reset themselves."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from deep.tasks.render import draw
from deep.tasks.task import Bools, Floats, Observations, Task

__all__ = ["TaskEnv", "TaskVectorEnv"]

Image = NDArray[np.uint8]


def _observation_space(task: Task) -> spaces.Space[NDArray[Any]]:
    low, high = task.observation_low, task.observation_high
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _action_space(task: Task) -> spaces.Space[NDArray[Any]]:
    return spaces.Box(-1.0, 1.0, (task.action_dim,), np.float32)


class TaskEnv(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """One copy of a task.

    An episode is terminated at its first violation (or its success) and truncated at the
    task's time limit; at both at once it is terminated only. ``info`` holds ``cost``: 1 at
    a violation, else 0, and ``state``: the unscaled state.
    """

    def __init__(self, task: Task, render_mode: str | None = None) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 10}
        self.task = task
        self.render_mode = render_mode
        self.observation_space = _observation_space(task)
        self.action_space = _action_space(task)
        self._state: Floats | None = None
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode; ``options={"state": ...}`` sets its first state."""
        super().reset(seed=seed)
        if options is not None and "state" in options:
            self._state = np.array(options["state"], dtype=np.float64).reshape(1, -1)
        else:
            self._state = self.task.reset(self.np_random, 1)
        self._steps = 0
        return self.task.observe(self._state)[0], self._info(violation=False)

    def step(
        self, action: NDArray[np.floating]
    ) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """One step; call :meth:`reset` first."""
        if self._state is None:
            raise ValueError(f"{self.task.name}: call reset() before step()")
        step = self.task.step(self._state, np.asarray(action)[None], self.np_random)
        self._state = step.next_state
        self._steps += 1
        terminated = bool(step.violation[0] | step.success[0])
        truncated = self._steps >= self.task.time_limit and not terminated
        observation = self.task.observe(self._state)[0]
        info = self._info(violation=bool(step.violation[0]))
        return observation, float(step.reward[0]), terminated, truncated, info

    def render(self) -> Image | None:
        """uint8 (height, width, 3), or None without ``render_mode="rgb_array"``."""
        if self.render_mode is None or self._state is None:
            return None
        return draw(self.task, self._state)

    def _info(self, *, violation: bool) -> dict[str, Any]:
        assert self._state is not None
        return {"cost": float(violation), "state": self._state[0].copy()}


class TaskVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """n copies of a task that begin anew in the step that ends their episode.

    Observations of finished copies are those of their next episode; the last observation
    of the finished one is kept in ``info["final_obs"]`` (float32, zero elsewhere), with
    the mask ``info["_final_obs"]``. ``info["cost"]`` is the violation, 0 or 1, a copy.
    """

    def __init__(self, task: Task, num_envs: int) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.task = task
        self.num_envs = num_envs
        self.single_observation_space = _observation_space(task)
        self.single_action_space = _action_space(task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._states: Floats | None = None
        self._steps = np.zeros(num_envs, dtype=np.int64)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  (Gymnasium's signature)
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin n episodes; one seed for all copies."""
        if isinstance(seed, list):
            raise ValueError("the copies share one generator: give one seed, not a list")
        super().reset(seed=seed)
        self._states = self.task.reset(self.np_random, self.num_envs)
        self._steps[:] = 0
        return self.task.observe(self._states), {}

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """One step of every copy; finished ones begin their next episode."""
        if self._states is None:
            raise ValueError(f"{self.task.name}: call reset() before step()")
        step = self.task.step(self._states, actions, self.np_random)
        self._states = step.next_state
        self._steps += 1
        terminated = step.violation | step.success
        truncated = (self._steps >= self.task.time_limit) & ~terminated
        info: dict[str, Any] = {"cost": step.violation.astype(np.float64)}
        done = terminated | truncated
        observations = self.task.observe(self._states)
        if done.any():
            final = np.zeros_like(observations)
            final[done] = observations[done]
            info |= {"final_obs": final, "_final_obs": done}
            self._states[done] = self.task.reset(self.np_random, int(done.sum()))
            self._steps[done] = 0
            observations[done] = self.task.observe(self._states[done])
        return observations, step.reward, terminated, truncated, info

    def snapshot(self) -> dict[str, Any]:
        """All that later steps hang on, as JSON: states, ages of episodes, the generator."""
        if self._states is None:
            raise ValueError(f"{self.task.name}: call reset() before snapshot()")
        return {
            "states": self._states.tolist(),
            "steps": self._steps.tolist(),
            "generator": self.np_random.bit_generator.state,
        }

    def restore(self, snapshot: dict[str, Any]) -> Observations:
        """Go on from a snapshot of as many copies; the observations there."""
        self._states = np.array(snapshot["states"], dtype=np.float64)
        self._steps = np.array(snapshot["steps"], dtype=np.int64)
        self.np_random.bit_generator.state = snapshot["generator"]
        return self.task.observe(self._states)
