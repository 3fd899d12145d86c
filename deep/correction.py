"""Behavior correction: the paper's Equation (behavior_correction) around an environment.

    a_t = a_task if Q_c(s_t, a_task) < epsilon, else the mean of pi_rec(s_t)

The environment executes a_t while the agent keeps and learns from a_task, so that the
correction is a part of the world it sees.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from deep.safety_filter import SafetyFilter

__all__ = ["BehaviorCorrection", "BehaviorCorrectionVector"]


class BehaviorCorrection(gymnasium.Wrapper[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]):
    """A Gymnasium environment that executes corrected actions.

    Whoever calls :meth:`step` keeps its own action. ``info`` gains ``intervened`` (bool),
    ``executed_action`` (float32 (a,)) and ``critic`` (Q_c of the agent's action).

    Attributes:
        safety: the filter.
        steps, interventions: since construction.
    """

    def __init__(
        self, env: gymnasium.Env[NDArray[Any], NDArray[Any]], safety: SafetyFilter
    ) -> None:
        super().__init__(env)
        _check_spaces(env.observation_space, env.action_space, safety)
        self.safety = safety
        self.steps = 0
        self.interventions = 0
        self._observation: NDArray[Any] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode."""
        self._observation, info = self.env.reset(seed=seed, options=options)
        return self._observation, info

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], Any, bool, bool, dict[str, Any]]:
        """Correct, then execute."""
        if self._observation is None:
            raise ValueError("BehaviorCorrection: call reset() before step()")
        correction = self.safety.correct(self._observation[None], np.asarray(action)[None])
        executed = correction.executed[0]
        self._observation, reward, terminated, truncated, info = self.env.step(executed)
        intervened = bool(correction.intervened[0])
        self.steps += 1
        self.interventions += intervened
        info = info | {
            "intervened": intervened,
            "executed_action": executed,
            "critic": float(correction.critic[0]),
        }
        return self._observation, reward, terminated, truncated, info


class BehaviorCorrectionVector(VectorWrapper[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """The same around a vector environment; ``info`` holds one entry a copy.

    In the step in which a copy that resets itself later (``AutoresetMode.NEXT_STEP``)
    begins anew, its action is ignored by the environment; what is reported for it then
    belongs to the episode that has ended.

    Attributes:
        safety: the filter.
        steps, interventions: since construction, over all copies.
    """

    def __init__(
        self, env: VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]], safety: SafetyFilter
    ) -> None:
        super().__init__(env)
        _check_spaces(env.single_observation_space, env.single_action_space, safety)
        self.safety = safety
        self.steps = 0
        self.interventions = 0
        self._observations: NDArray[Any] | None = None

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode in every copy."""
        observations, info = super().reset(seed=seed, options=options)
        self._observations = np.array(observations)  # the environment may reuse its buffer
        return observations, info

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Correct, then execute."""
        if self._observations is None:
            raise ValueError("BehaviorCorrectionVector: call reset() before step()")
        correction = self.safety.correct(self._observations, np.asarray(actions))
        observations, rewards, terminated, truncated, info = self.env.step(correction.executed)
        self._observations = np.array(observations)
        self.steps += len(correction.intervened)
        self.interventions += int(correction.intervened.sum())
        info = info | {
            "intervened": correction.intervened,
            "executed_action": correction.executed,
            "critic": correction.critic,
        }
        return observations, rewards, terminated, truncated, info


def _check_spaces(observation: Any, action: Any, safety: SafetyFilter) -> None:
    shapes = (getattr(observation, "shape", None), getattr(action, "shape", None))
    wanted = ((safety.observation_dim,), (safety.action_dim,))
    if shapes != wanted:
        raise ValueError(
            f"the environment's observations and actions have shapes {shapes[0]} and {shapes[1]}, "
            f"the filter was trained on {wanted[0]} and {wanted[1]}"
        )
