"""Any Gymnasium environment with continuous actions, behind the interface of the tasks.

Actions in [-1, 1] are stretched to the environment's own range. ``info["cost"]``, where the
environment reports one, is what counts as a violation: as everywhere here the first positive
cost ends the episode, whether or not the environment itself would go on.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from deep.tasks.task import Bools, Floats, Observations

__all__ = ["GymVectorEnv"]

SEEDS = 2**31

Env = gymnasium.Env[NDArray[Any], NDArray[Any]]
Space = spaces.Space[NDArray[Any]]


class GymVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """n copies that begin anew in the step that ends their episode, as ``TaskVectorEnv``.

    An episode is terminated where the environment ends it or reports a positive
    ``info["cost"]`` (here 1, else 0), and truncated at Gymnasium's time limit; at both at
    once it is terminated only. Every copy has a generator of its own.

    Args:
        name: of the environment, as ``gymnasium.make`` takes it.
        num_envs: n.

    Raises:
        ValueError: if there is no copy, the environment cannot be made, its observations are
            not vectors of real numbers, or its actions not such vectors within finite bounds.
    """

    def __init__(self, name: str, num_envs: int) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.name = name
        self.num_envs = num_envs
        self._copies = [_make(name) for _ in range(num_envs)]
        self.single_observation_space = _observation_space(name, self._copies[0])
        self.single_action_space = self._actions = _action_space(name, self._copies[0])
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._began = False

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  (Gymnasium's signature)
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin n episodes; one seed, from which each copy gets its own."""
        if isinstance(seed, list):
            raise ValueError("the copies' seeds are drawn: give one seed, not a list")
        super().reset(seed=seed)
        self._began = True
        seeds = self.np_random.integers(SEEDS, size=self.num_envs).tolist()
        first = [copy.reset(seed=own)[0] for copy, own in zip(self._copies, seeds, strict=True)]
        return np.array(first, dtype=np.float32), {}

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """One step of every copy; finished ones begin their next episode."""
        if not self._began:
            raise ValueError(f"{self.name}: call reset() before step()")
        bounded = self._bounded(actions)
        rows = [copy.step(action) for copy, action in zip(self._copies, bounded, strict=True)]
        steps, rewards, ends, cuts, infos = zip(*rows, strict=True)
        observations = np.array(steps, dtype=np.float32)
        violation = np.array([info.get("cost", 0) > 0 for info in infos], dtype=np.bool_)
        terminated = np.array(ends, dtype=np.bool_) | violation
        truncated = np.array(cuts, dtype=np.bool_) & ~terminated
        info: dict[str, Any] = {"cost": violation.astype(np.float64)}
        done = terminated | truncated
        if done.any():
            final = np.zeros_like(observations)
            final[done] = observations[done]
            info |= {"final_obs": final, "_final_obs": done}
            for index in np.flatnonzero(done):
                observations[index] = self._copies[index].reset()[0]
        return observations, np.array(rewards, dtype=np.float64), terminated, truncated, info

    def _bounded(self, actions: NDArray[np.floating]) -> NDArray[Any]:
        """In the type of the environment's actions, whose ends rounding must not pass."""
        space = self._actions
        return np.asarray(np.asarray(actions, dtype=space.dtype).clip(space.low, space.high))

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002  (Gymnasium's signature)
        """Close the copies."""
        for copy in self._copies:
            copy.close()


def _make(name: str) -> Env:
    try:
        made: Env = gymnasium.make(name)
    except (gymnasium.error.Error, ImportError) as error:
        raise ValueError(f"there is no Gymnasium environment {name!r}: {error}") from error
    return made


def _observation_space(name: str, env: Env) -> Space:
    space = env.observation_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"{name}: observations must be vectors of numbers (Box), not {space}")
    return spaces.Box(space.low.astype(np.float32), space.high.astype(np.float32), dtype=np.float32)


def _action_space(name: str, env: Env) -> spaces.Box:
    space = env.action_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1 or not space.is_bounded():
        raise ValueError(f"{name}: actions must be vectors within finite bounds (Box), not {space}")
    return space
