"""The paper's metrics, over a fixed number of whole episodes.

    ACR  average cumulative reward of an episode
    AVR  share of episodes that end in a violation
    ARR  share of steps in which behavior correction replaced the action

Every copy of the environment runs a number of episodes that was fixed beforehand, each to
its end. To take the first N that finish would favour short episodes, which are the ones
that failed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deep.filter.safety_filter import SafetyFilter, Watch
from deep.tasks.gym import NO_RULES, Rules
from deep.tasks.vectorised import environment_seed, make_vector_env

__all__ = ["Act", "Episodes", "run_episodes"]

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Raw observations (n, o) -> actions (n, a) in the environment's own units."""
EVALUATION_STREAM = 6


@dataclass(frozen=True, eq=False)
class Episodes:
    """E whole episodes.

    Attributes:
        returns: float64 (E,), undiscounted.
        lengths: int64 (E,), in steps.
        violated: bool (E,).
        interventions: int64 (E,), steps with a replaced action.
    """

    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    violated: NDArray[np.bool_]
    interventions: NDArray[np.int64]

    @property
    def acr(self) -> float:
        """Average cumulative reward."""
        return float(self.returns.mean())

    @property
    def avr(self) -> float:
        """Average violation rate."""
        return float(self.violated.mean())

    @property
    def arr(self) -> float:
        """Average recovery rate: replaced steps over steps."""
        return float(self.interventions.sum() / self.lengths.sum())

    @property
    def length(self) -> float:
        """Mean length in steps."""
        return float(self.lengths.mean())


def run_episodes(
    task: str,
    act: Act,
    safety: SafetyFilter | None,
    episodes: int,
    seed: int,
    copies: int | None = None,
    rules: Rules = NO_RULES,
) -> Episodes:
    """Run ``episodes`` whole episodes, behind a filter if there is one.

    Args:
        task: as for :class:`deep.tasks.vectorised.Fleet`.
        act: the task policy.
        safety: behavior correction; None leaves it out.
        episodes: how many; copy i of n runs the i-th, the (i + n)-th and so on.
        seed: of the environments.
        copies: at once; one an episode by default.
        rules: as for the task.

    Raises:
        ValueError: if ``episodes`` or ``copies`` is not positive.
    """
    if episodes < 1 or (copies is not None and copies < 1):
        raise ValueError("episodes and copies must be at least 1")
    n = min(copies or episodes, episodes)
    env = make_vector_env(task, n, rules)
    quota = np.full(n, episodes // n) + (np.arange(n) < episodes % n)
    begun = np.zeros(n, dtype=np.int64)  # episodes that this copy has ended
    returns, lengths = np.zeros(episodes), np.zeros(episodes, dtype=np.int64)
    violated = np.zeros(episodes, dtype=np.bool_)
    interventions = np.zeros(episodes, dtype=np.int64)
    watch = Watch()
    try:
        observation, _ = env.reset(seed=environment_seed(seed, EVALUATION_STREAM))
        while (running := begun < quota).any():
            action = act(observation)
            intervened = np.zeros(n, dtype=np.bool_)
            if safety is not None:
                correction = safety.correct(observation, action)
                watch.add(safety, observation, correction)
                action, intervened = correction.executed, correction.intervened
            observation, reward, terminal, timeout, info = env.step(action)
            copy = np.flatnonzero(running)
            episode = begun[copy] * n + copy
            returns[episode] += reward[copy]
            lengths[episode] += 1
            violated[episode] |= info["cost"][copy] > 0
            interventions[episode] += intervened[copy]
            begun += terminal | timeout
    finally:
        env.close()
    return Episodes(returns, lengths, violated, interventions)
