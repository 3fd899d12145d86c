"""The environments of a run: N copies for each of K seeds, each seed with its own generator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from deep.tasks import TaskVectorEnv, make_task
from deep.tasks.safety_gym.real import RealVectorEnv

__all__ = ["REAL", "Arrived", "Fleet", "make_vector_env"]

REAL = "real:"
"""Before the name of a task: the one of Safety-Gymnasium itself."""
ENVIRONMENT_STREAM = 5

Env = VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]


def make_vector_env(task: str, copies: int) -> TaskVectorEnv | RealVectorEnv:
    """``copies`` of a task, or of Safety-Gymnasium's own with "real:" before its name.

    Raises:
        ValueError: if there is no such task, or Safety-Gymnasium is not installed.
    """
    if task.startswith(REAL):
        return RealVectorEnv(task.removeprefix(REAL), copies)
    return TaskVectorEnv(make_task(task), copies)


def environment_seed(seed: int, stream: int) -> int:
    """A number for an environment's generator, from a run's seed and a stream's number."""
    return int(np.random.SeedSequence((seed, stream)).generate_state(1)[0])


class Arrived(NamedTuple):
    """What one step of the K x N copies gave.

    Attributes:
        observation: (K, N, o), where each copy goes on: a new episode's first, if one ended.
        last: (K, N, o), where the step led: an ended episode's last observation.
        reward, cost, terminal, timeout: (K, N).
    """

    observation: NDArray[np.float32]
    last: NDArray[np.float32]
    reward: NDArray[np.float64]
    cost: NDArray[np.float64]
    terminal: NDArray[np.bool_]
    timeout: NDArray[np.bool_]


class Fleet:
    """N copies of a task for each of K seeds.

    Args:
        task: a task's name, with "real:" before it for Safety-Gymnasium's own.
        seeds: the K seeds.
        copies: N.
    """

    def __init__(self, task: str, seeds: Sequence[int], copies: int) -> None:
        self.seeds = tuple(seeds)
        self.envs = [make_vector_env(task, copies) for _ in seeds]

    @property
    def observation_dim(self) -> int:
        """Coordinates of an observation."""
        return int(np.prod(self.envs[0].single_observation_space.shape or ()))

    @property
    def action_dim(self) -> int:
        """Coordinates of an action."""
        return int(np.prod(self.envs[0].single_action_space.shape or ()))

    def reset(self) -> NDArray[np.float32]:
        """First observations (K, N, o)."""
        return np.stack(
            [
                env.reset(seed=environment_seed(seed, ENVIRONMENT_STREAM))[0]
                for env, seed in zip(self.envs, self.seeds, strict=True)
            ]
        )

    def step(self, executed: NDArray[np.float32]) -> Arrived:
        """One step of every copy, with actions (K, N, a)."""
        return Arrived(
            *map(np.stack, zip(*map(_step, self.envs, executed), strict=True)),
        )

    def snapshot(self) -> list[Any] | None:
        """All that the copies will do hangs on, as JSON; None for Safety-Gymnasium's own."""
        kept = [env.snapshot() for env in self.envs if isinstance(env, TaskVectorEnv)]
        return kept or None

    def restore(self, snapshot: list[Any]) -> NDArray[np.float32]:
        """Go on from a snapshot; the observations (K, N, o)."""
        return np.stack(
            [
                env.restore(kept)
                for env, kept in zip(self.envs, snapshot, strict=True)
                if isinstance(env, TaskVectorEnv)
            ]
        )

    def close(self) -> None:
        """End the simulators' processes."""
        for env in self.envs:
            env.close()


def _step(env: Env, executed: NDArray[np.float32]) -> tuple[NDArray[Any], ...]:
    observation, reward, terminal, timeout, info = env.step(executed)
    last = observation
    if "final_obs" in info:
        last = np.where(info["_final_obs"][:, None], info["final_obs"], observation)
    return observation, last, reward, info["cost"], terminal, timeout
