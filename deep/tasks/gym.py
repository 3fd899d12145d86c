"""Any Gymnasium environment with continuous actions, behind the interface of the tasks.

Actions are in the environment's own units, here and in the files made from it; what lies outside
its bounds is moved to the nearest one. What a violation is says
``info["cost"]``, which every step must report: 1 at one, else 0, or a number of which a rule
says what it means (see :mod:`deep.tasks.violation`). As everywhere here a violation ends the
episode, whether or not the environment itself would go on. An environment that knows no cost,
or no time limit, is refused before its first episode, unless :class:`Rules` say what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from deep.tasks.task import Bools, Floats, Observations
from deep.tasks.violation import check_rule, violations

__all__ = ["NO_RULES", "GymVectorEnv", "Rules", "rules_from_json"]

SEEDS = 2**31

Env = gymnasium.Env[NDArray[Any], NDArray[Any]]
Space = spaces.Space[NDArray[Any]]


@dataclass(frozen=True)
class Rules:
    """What an environment leaves open: what a violation is, and when an episode is over.

    Attributes:
        violation: which cost is one, as in "cost > 0.5"; None: costs are 0 or 1.
        termination_is_violation: whatever ends an episode but its time limit is a violation, for
            environments that report no cost.
        time_limit: steps after which an episode is cut off; None: the environment's own.

    Raises:
        ValueError: for a rule that is none, or a limit that is not positive.
    """

    violation: str | None = None
    termination_is_violation: bool = False
    time_limit: int | None = None

    def __post_init__(self) -> None:
        check_rule(self.violation)
        if self.time_limit is not None and self.time_limit < 1:
            raise ValueError(f"time_limit must be at least 1, not {self.time_limit}")


NO_RULES = Rules()
"""The environment leaves nothing open."""


def rules_from_json(run: Mapping[str, Any]) -> Rules:
    """The rules in a run's configuration, where they are written if there are some.

    Raises:
        TypeError: if they are none.
    """
    return Rules(**run["rules"]) if "rules" in run else NO_RULES


class GymVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """n copies that begin anew in the step that ends their episode, as ``TaskVectorEnv``.

    An episode is terminated where the environment ends it or reports a violation
    (``info["cost"]``, here 1 at one, else 0), and truncated at the time limit; at both at once
    it is terminated only. Every copy has a generator of its own.

    Args:
        name: of the environment, as ``gymnasium.make`` takes it.
        num_envs: n.
        rules: what the environment leaves open.

    Raises:
        ValueError: if there is no copy, the environment cannot be made, its observations are
            not vectors of real numbers, or its actions not such vectors within finite bounds;
            if it has no time limit, reports no cost, or returns other tuples than Gymnasium's;
            later, at a step, if an observation, a reward or a cost is no finite number.
    """

    def __init__(self, name: str, num_envs: int, rules: Rules = NO_RULES) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.name = name
        self.num_envs = num_envs
        self.rules = rules
        _try(name, rules)
        self._copies = [_make(name, rules) for _ in range(num_envs)]
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
        return self._finite("observations", first).astype(np.float32), {}

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """One step of every copy; finished ones begin their next episode."""
        if not self._began:
            raise ValueError(f"{self.name}: call reset() before step()")
        bounded = self._bounded(actions)
        rows = [copy.step(action) for copy, action in zip(self._copies, bounded, strict=True)]
        steps, rewards, ends, cuts, infos = zip(*rows, strict=True)
        observations = self._finite("observations", steps).astype(np.float32)
        gained = self._finite("rewards", rewards).astype(np.float64)
        violation = _violated(self.name, infos, ends, self.rules)
        terminated = np.array(ends, dtype=np.bool_) | violation
        truncated = np.array(cuts, dtype=np.bool_) & ~terminated
        info: dict[str, Any] = {"cost": violation.astype(np.float64)}
        done = terminated | truncated
        if done.any():
            final = np.zeros_like(observations)
            final[done] = observations[done]
            info |= {"final_obs": final, "_final_obs": done}
            for index in np.flatnonzero(done):
                first, _ = self._copies[index].reset()
                observations[index] = self._finite("observations", first)
        return observations, gained, terminated, truncated, info

    def _finite(self, what: str, values: Any) -> NDArray[Any]:
        found = np.asarray(values)
        if not np.isfinite(found).all():
            raise ValueError(f"{self.name}: one of its {what} is not finite: {found.tolist()}")
        return found

    def _bounded(self, actions: NDArray[np.floating]) -> NDArray[Any]:
        """In the type of the environment's actions, whose ends rounding must not pass."""
        space = self._actions
        return np.asarray(np.asarray(actions, dtype=space.dtype).clip(space.low, space.high))

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002  (Gymnasium's signature)
        """Close the copies."""
        for copy in self._copies:
            copy.close()


def _make(name: str, rules: Rules) -> Env:
    try:
        made: Env = gymnasium.make(name, max_episode_steps=rules.time_limit)
    except (gymnasium.error.Error, ImportError, TypeError) as error:
        raise ValueError(f"there is no Gymnasium environment {name!r}: {error}") from error
    if not _is_limited(made):
        made.close()
        raise ValueError(
            f"{name}: it is registered without a time limit (max_episode_steps), so that an "
            "episode may never end; give --time-limit STEPS (time_limit=STEPS)"
        )
    return made


def _is_limited(env: gymnasium.Env[Any, Any]) -> bool:
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            return True
        env = env.env
    return False


def _try(name: str, rules: Rules) -> None:
    """One reset and one step of a copy that is thrown away: the tuples, the spaces, the cost.

    Raises:
        ValueError: about the first thing that is not as it must be.
    """
    env = _make(name, rules)
    try:
        _observation_space(name, env)
        _action_space(name, env)
        _check_tuples(name, env.unwrapped)
        env.action_space.seed(0)
        env.reset(seed=0)
        _, _, terminated, _, info = env.step(env.action_space.sample())
        _violated(name, [info], [terminated], rules)
    finally:
        env.close()


def _check_tuples(name: str, env: gymnasium.Env[Any, Any]) -> None:
    """The environment below all wrappers, which would fall over other tuples without a word."""
    try:
        began: Any = env.reset(seed=0)
    except TypeError as error:
        raise ValueError(f"{name}: reset(seed=0) cannot be called ({error})") from error
    if not (isinstance(began, tuple) and len(began) == 2 and isinstance(began[1], dict)):
        raise ValueError(
            f"{name}: reset() returns {_shown(began)}, where Gymnasium wants the two (observation, "
            "info); only the observation is that of Gym before 0.26"
        )
    stepped: Any = env.step(env.action_space.sample())
    if not (isinstance(stepped, tuple) and len(stepped) == 5 and isinstance(stepped[4], dict)):
        raise ValueError(
            f"{name}: step() returns {_shown(stepped)}, where Gymnasium wants the five "
            "(observation, reward, terminated, truncated, info); four are those of Gym before 0.26"
        )


def _shown(returned: Any) -> str:
    if isinstance(returned, tuple):
        return f"a tuple of {len(returned)} ({', '.join(type(x).__name__ for x in returned)})"
    return f"no tuple but a {type(returned).__name__}"


def _violated(
    name: str, infos: Sequence[dict[str, Any]], ends: Sequence[bool], rules: Rules
) -> Bools:
    """Which copies' steps were violations."""
    terminated = np.array(ends, dtype=np.bool_) & rules.termination_is_violation
    silent = [info.get("cost") is None for info in infos]
    if all(silent) and rules.termination_is_violation and rules.violation is None:
        return terminated
    if any(silent):
        raise ValueError(
            f"{name}: its steps report no info['cost'], so that no violation could be counted; "
            "it must report one at every step (0 where nothing happens), or give "
            "--termination-is-violation (termination_is_violation=True) if whatever ends its "
            "episodes before the time limit is a violation"
        )
    costs = np.asarray([info["cost"] for info in infos])
    if costs.dtype.kind not in "biuf":
        raise ValueError(f"{name}: info['cost'] is {infos[0]['cost']!r}, not a number")
    return violations(costs, rules.violation, lambda _: f"{name}: info['cost']") | terminated


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
