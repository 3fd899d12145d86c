"""Behavior correction: the paper's Equation (behavior_correction) around an environment.

    a_t = a_task if Q_c(s_t, a_task) < epsilon, else the mean of pi_rec(s_t)

The environment executes a_t while the agent keeps and learns from a_task, so that the
correction is a part of the world it sees. Actions are in the environment's own units, as
those of the log were that the filter was trained on; an environment with other action
bounds is refused. What is executed is finite and within the bounds, whatever the agent
proposes or the environment shows (the rules: :mod:`deep.filter.safety_filter`).

``info`` gains, after a step and (blank: nothing was executed) after a reset:

    intervened          bool, whether the recovery policy acted
    executed_action     (a,), in the type of the action space; zeros after a reset
    critic              Q_c of the agent's action; 0 after a reset
    out_of_range        bool, whether it was decided far outside of the training data
    not_finite          bool, whether the observation or the action held a NaN or an infinity
    out_of_range_steps  how many such steps since construction
    not_finite_steps    likewise
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from deep.filter.safety_filter import SafetyFilter, Watch
from deep.tasks.bounds import action_bounds

__all__ = ["BehaviorCorrection", "BehaviorCorrectionVector"]


class BehaviorCorrection(
    gymnasium.Wrapper[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]],
    RecordConstructorArgs,
):
    """A Gymnasium environment that executes corrected actions.

    Whoever calls :meth:`step` keeps its own action. ``info`` gains what the head of this
    module lists; the environment's own entries stay as they are. ``gymnasium.make(env.spec)``
    makes the same wrapper again, which is why a filter may be given as text.

    Args:
        env: the environment; continuous actions within finite bounds.
        safety: the filter, or its :meth:`~deep.filter.safety_filter.SafetyFilter.to_text`.

    Attributes:
        safety: the filter, with exactly the environment's action bounds.
        watch: counts since construction.

    Raises:
        ValueError: if the environment does not fit the filter.

    >>> safety = pretrain(log, horizon=3, updates=3, quiet=True).filters[0]
    >>> protected = BehaviorCorrection(env, safety)
    >>> observation, info = protected.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = protected.step(np.array([1.0]))
    >>> sorted(info)
    ['critic', 'executed_action', 'intervened', 'not_finite', 'not_finite_steps', ...]
    """

    def __init__(
        self, env: gymnasium.Env[NDArray[Any], NDArray[Any]], safety: SafetyFilter | str
    ) -> None:
        given = SafetyFilter.from_text(safety) if isinstance(safety, str) else safety
        text = safety if isinstance(safety, str) else safety.to_text()
        RecordConstructorArgs.__init__(self, safety=text)
        super().__init__(env)
        self.safety = _fitted(given, env.observation_space, env.action_space)
        self.watch = Watch()
        self._observation: NDArray[Any] | None = None

    @property
    def steps(self) -> int:
        """Since construction."""
        return self.watch.steps

    @property
    def interventions(self) -> int:
        """Steps in which the recovery policy acted, since construction."""
        return self.watch.interventions

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._observation = np.array(observation)  # the agent may change its own in place
        blank = np.zeros(self.env.action_space.shape or (), self.env.action_space.dtype)
        return observation, info | self._report(False, blank, 0.0, False, False)

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], Any, bool, bool, dict[str, Any]]:
        """Correct, then execute."""
        if self._observation is None:
            raise ValueError("BehaviorCorrection: call reset() before step()")
        seen = self._observation[None]
        done = self.safety.correct(seen, np.asarray(action)[None])
        self.watch.add(self.safety, seen, done)
        executed = _executed(done.executed, self.env.action_space)[0]
        observation, reward, terminated, truncated, info = self.env.step(executed)
        self._observation = np.array(observation)
        info = info | self._report(
            bool(done.intervened[0]),
            executed,
            float(done.critic[0]),
            bool(done.out_of_range[0]),
            bool(done.not_finite[0]),
        )
        return observation, reward, terminated, truncated, info

    def _report(
        self,
        intervened: bool,
        executed: NDArray[Any],
        critic: float,
        out_of_range: bool,
        not_finite: bool,
    ) -> dict[str, Any]:
        return {
            "intervened": intervened,
            "executed_action": executed,
            "critic": critic,
            "out_of_range": out_of_range,
            "not_finite": not_finite,
            "out_of_range_steps": self.watch.out_of_range,
            "not_finite_steps": self.watch.not_finite,
        }


class BehaviorCorrectionVector(VectorWrapper[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """The same around a vector environment; ``info`` holds one entry a copy.

    The two counts are over all copies, and the same number for each.

    In the step in which a copy that resets itself later (``AutoresetMode.NEXT_STEP``)
    begins anew, its action is ignored by the environment; what is reported for it then
    belongs to the episode that has ended.

    Attributes:
        safety: the filter, with exactly the environment's action bounds.
        watch: counts since construction, over all copies.

    Raises:
        ValueError: if the environment does not fit the filter.

    >>> safety = pretrain(log, horizon=3, updates=3, quiet=True).filters[0]
    >>> envs = gymnasium.vector.SyncVectorEnv([lambda: env])
    >>> protected = BehaviorCorrectionVector(envs, safety)
    >>> observations, infos = protected.reset(seed=0)
    >>> protected.step(np.array([[1.0]]))[-1]["intervened"].shape
    (1,)
    """

    def __init__(
        self, env: VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]], safety: SafetyFilter
    ) -> None:
        super().__init__(env)
        self.safety = _fitted(safety, env.single_observation_space, env.single_action_space)
        self.watch = Watch()
        self._text = safety.to_text()
        self._observations: NDArray[Any] | None = None

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]  # as in Gymnasium's VectorWrapper
        """With it ``gymnasium.make_vec`` makes copies that each have a BehaviorCorrection.

        None where another wrapper lies in between: no specification says where.
        """
        spec = self.env.spec
        if spec is None or isinstance(self.env, VectorWrapper) or spec.kwargs.get("wrappers"):
            return None
        spec = deepcopy(spec)
        spec.additional_wrappers += (BehaviorCorrection.wrapper_spec(safety=self._text),)
        return spec

    @property
    def steps(self) -> int:
        """Since construction, over all copies."""
        return self.watch.steps

    @property
    def interventions(self) -> int:
        """Steps in which the recovery policy acted, since construction, over all copies."""
        return self.watch.interventions

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode in every copy."""
        observations, info = super().reset(seed=seed, options=options)
        self._observations = np.array(observations)  # the environment may reuse its buffer
        n, space = self.num_envs, self.single_action_space
        blank = np.zeros((n, *(space.shape or ())), space.dtype)
        none = np.zeros(n, dtype=np.bool_)
        return observations, info | self._report(
            none, blank, np.zeros(n, dtype=np.float32), none.copy(), none.copy()
        )

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Correct, then execute."""
        if self._observations is None:
            raise ValueError("BehaviorCorrectionVector: call reset() before step()")
        seen = self._observations
        done = self.safety.correct(seen, np.asarray(actions))
        self.watch.add(self.safety, seen, done)
        executed = _executed(done.executed, self.single_action_space)
        observations, rewards, terminated, truncated, info = self.env.step(executed)
        self._observations = np.array(observations)
        info = info | self._report(
            done.intervened, executed, done.critic, done.out_of_range, done.not_finite
        )
        return observations, rewards, terminated, truncated, info

    def _report(
        self,
        intervened: NDArray[Any],
        executed: NDArray[Any],
        critic: NDArray[Any],
        out_of_range: NDArray[Any],
        not_finite: NDArray[Any],
    ) -> dict[str, Any]:
        return {
            "intervened": intervened,
            "executed_action": executed,
            "critic": critic,
            "out_of_range": out_of_range,
            "not_finite": not_finite,
            "out_of_range_steps": np.full(self.num_envs, self.watch.out_of_range),
            "not_finite_steps": np.full(self.num_envs, self.watch.not_finite),
        }


def _executed(actions: NDArray[Any], space: Any) -> NDArray[Any]:
    """Actions in the type of their space, and within it: there may be no float32 in between."""
    return np.asarray(np.clip(actions.astype(space.dtype), space.low, space.high))


def _fitted(safety: SafetyFilter, observations: Any, actions: Any) -> SafetyFilter:
    """The filter for an environment with these spaces."""
    bounds = action_bounds(actions)
    shapes = (getattr(observations, "shape", None), actions.shape)
    wanted = ((safety.observation_dim,), (safety.action_dim,))
    if shapes != wanted:
        raise ValueError(
            f"the environment's observations and actions have shapes {shapes[0]} and {shapes[1]}, "
            f"the filter was trained on {wanted[0]} and {wanted[1]}"
        )
    return safety.for_actions(bounds, "the environment")
