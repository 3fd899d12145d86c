"""The environments of a run: N copies for each of K seeds, each seed with its own generator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from deep.tasks import TaskVectorEnv, make_task
from deep.tasks.bounds import Bounds, action_bounds
from deep.tasks.gym import NO_RULES, GymVectorEnv, Rules
from deep.tasks.safety_gym.real import RealVectorEnv
from deep.tasks.task import Sizes

__all__ = [
    "Arrived",
    "Fleet",
    "check_fit",
    "check_rules",
    "environment_seed",
    "evaluation_copies",
    "make_vector_env",
    "task_sizes",
    "task_spaces",
]

REAL = "real:"
"""Before the name of a task: the one of Safety-Gymnasium itself."""
GYM = "gym:"
"""Before the name of any Gymnasium environment with continuous actions."""
ENVIRONMENT_STREAM = 5
FOREIGN_COPIES = 4

Env = VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]


def make_vector_env(
    task: str, copies: int, rules: Rules = NO_RULES
) -> TaskVectorEnv | RealVectorEnv | GymVectorEnv:
    """``copies`` of a task.

    Args:
        task: a task's name; "real:" before it means Safety-Gymnasium's own, "gym:" any
            Gymnasium environment of that id.
        copies: at least one.
        rules: what an environment of "gym:" leaves open.

    Raises:
        ValueError: if there is no such task, it does not fit, or Safety-Gymnasium is not
            installed; if there are rules for another task than one of "gym:".
    """
    check_rules(task, rules)
    if task.startswith(REAL):
        return RealVectorEnv(task.removeprefix(REAL), copies)
    if task.startswith(GYM):
        return GymVectorEnv(task.removeprefix(GYM), copies, rules)
    return TaskVectorEnv(make_task(task), copies)


def check_rules(task: str, rules: Rules) -> None:
    """Refuse rules for a task that leaves nothing open.

    Raises:
        ValueError: if there are rules for another task than one of "gym:".
    """
    if rules != NO_RULES and not task.startswith(GYM):
        raise ValueError(
            f"{task} knows its violations and its time limit: violation, termination_is_violation "
            f"and time_limit are for environments of {GYM!r}"
        )


def evaluation_copies(task: str) -> int | None:
    """Copies at once in an evaluation: few simulators of others; None: one an episode."""
    return FOREIGN_COPIES if task.startswith((REAL, GYM)) else None


def task_sizes(task: str, rules: Rules = NO_RULES) -> Sizes:
    """Dimensions of a task's observations and actions."""
    return task_spaces(task, rules)[0]


def task_spaces(task: str, rules: Rules = NO_RULES) -> tuple[Sizes, Bounds]:
    """The same, and the bounds of its actions in the environment's own units."""
    fleet = Fleet(task, (0,), 1, rules)
    try:
        return Sizes(fleet.observation_dim, fleet.action_dim), fleet.action_bounds
    finally:
        fleet.close()


def check_fit(what: str, found: Sizes, task: str, sizes: Sizes) -> None:
    """Refuse what was made for observations and actions of other dimensions than the task's.

    Args:
        what: the beginning of the message, up to its verb or colon.
        found: what it was made for.
        task: the task's name.
        sizes: the task's.

    Raises:
        ValueError: naming both.
    """
    if found != sizes:
        raise ValueError(
            f"{what} observations in R^{found.observation} and actions in R^{found.action}, "
            f"{task} has R^{sizes.observation} and R^{sizes.action}"
        )


def environment_seed(seed: int, *stream: int) -> int:
    """A number for an environment's generator, from a run's seed and a stream's numbers."""
    return int(np.random.SeedSequence((seed, *stream)).generate_state(1)[0])


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
        task: as for :func:`make_vector_env`.
        seeds: the K seeds.
        copies: N.
        rules: as for :func:`make_vector_env`.

    Raises:
        ValueError: if there is no seed, or as for :func:`make_vector_env`.
    """

    def __init__(
        self, task: str, seeds: Sequence[int], copies: int, rules: Rules = NO_RULES
    ) -> None:
        if not seeds:
            raise ValueError("seeds: give at least one")
        self.seeds = tuple(seeds)
        self.envs = [make_vector_env(task, copies, rules) for _ in seeds]

    @property
    def observation_dim(self) -> int:
        """Coordinates of an observation."""
        return int(np.prod(self.envs[0].single_observation_space.shape or ()))

    @property
    def action_dim(self) -> int:
        """Coordinates of an action."""
        return int(np.prod(self.envs[0].single_action_space.shape or ()))

    @property
    def action_bounds(self) -> Bounds:
        """The bounds of an action, in the environment's own units."""
        return action_bounds(self.envs[0].single_action_space)

    def reset(self, step: int = 0) -> NDArray[np.float32]:
        """First observations (K, N, o), other ones at each ``step`` that a run goes on from."""
        return np.stack(
            [
                env.reset(seed=environment_seed(seed, ENVIRONMENT_STREAM, step))[0]
                for env, seed in zip(self.envs, self.seeds, strict=True)
            ]
        )

    def step(self, executed: NDArray[np.float32]) -> Arrived:
        """One step of every copy, with actions (K, N, a)."""
        return Arrived(
            *map(np.stack, zip(*map(_step, self.envs, executed), strict=True)),
        )

    def snapshot(self) -> list[Any] | None:
        """All that the copies will do hangs on, as JSON; None for "real:" and "gym:"."""
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
        """Close the environments, and end simulators' processes."""
        for env in self.envs:
            env.close()


def _step(env: Env, executed: NDArray[np.float32]) -> tuple[NDArray[Any], ...]:
    observation, reward, terminal, timeout, info = env.step(executed)
    last = observation
    if "final_obs" in info:
        last = np.where(info["_final_obs"][:, None], info["final_obs"], observation)
    return observation, last, reward, info["cost"], terminal, timeout
