"""A transition table against the environment's own steps.

A table is a claim about what ``step`` does. Here some thousand steps of a copy are made, with
fixed seeds, and an observed (successor, terminated, reward) to which the table gives probability
0 is an error. Frequencies are not compared, and what is rare may escape.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np

from dead_ends.io.transitions import Transitions
from dead_ends.io.trial import copy_of, global_generators_kept, is_discrete, use_randomness

__all__ = ["check_steps"]

STEPS, EPISODE_STEPS = 5000, 100
"""How many steps are compared, and after how many an episode is left."""

Outcome = tuple[int, bool, float]
"""Successor, whether the episode ends, reward."""

Outcomes = dict[int, dict[int, list[Outcome]]]
"""What the table allows: state, index of the action, outcomes."""


def check_steps(env: Any, transitions: Transitions) -> None:
    """Compare steps of a copy of the environment with its table.

    Args:
        env: unwrapped; not changed. Without ``step``, or with observations that are no numbers
            of states, there is nothing to compare.
        transitions: its table, with ``done`` and ``reward``.

    Raises:
        ValueError: naming a step, or a first state, that the table excludes.
    """
    if not hasattr(env, "step") or not is_discrete(env.observation_space):
        return
    outcomes = _outcomes(transitions)
    for state, index, seen in _steps(env, outcomes, transitions):
        if not any(_equal(seen, outcome) for outcome in outcomes[state][index]):
            successor, ends, reward = seen
            raise ValueError(
                f"state {state}, action {index + transitions.first_action}: a step leads to state "
                f"{successor} with reward {reward:g}{', where the episode ends,' if ends else ''} "
                "and the table P gives that probability 0"
            )


def _steps(
    env: Any, outcomes: Outcomes, transitions: Transitions
) -> Iterator[tuple[int, int, Outcome]]:
    """State, index of the action and what came of it, taking the action least often tried."""
    rng = np.random.default_rng(0)
    tried = {state: dict.fromkeys(actions, 0) for state, actions in outcomes.items()}
    left = STEPS
    with global_generators_kept():
        env = copy_of(env)
        use_randomness(env, rng)
        while left > 0:
            left -= 1
            state = int(env.reset(seed=int(rng.integers(2**31)))[0])
            _check_start(state, transitions)
            for _ in range(EPISODE_STEPS):
                if state not in tried:
                    break
                counts = tried[state]
                least = [index for index in counts if counts[index] == min(counts.values())]
                index = least[int(rng.integers(len(least)))]
                counts[index] += 1
                left -= 1
                successor, reward, terminated, truncated, _ = env.step(
                    index + transitions.first_action
                )
                yield state, index, (int(successor), bool(terminated), float(reward))
                state = int(successor)
                if terminated or truncated:
                    break


def _check_start(state: int, transitions: Transitions) -> None:
    initial = transitions.initial
    if initial is not None and not (0 <= state < len(initial) and initial[state] > 0):
        raise ValueError(f"an episode starts in state {state}, which has probability 0 of it")


def _outcomes(transitions: Transitions) -> Outcomes:
    """What the table allows in each state."""
    outcomes: Outcomes = defaultdict(lambda: defaultdict(list))
    columns = (
        transitions.source, transitions.action, transitions.probability,
        transitions.target, transitions.done, transitions.reward,
    )  # fmt: skip
    rows = zip(*(np.asarray(column).tolist() for column in columns), strict=True)
    for state, index, probability, *outcome in rows:
        if probability > 0:
            outcomes[state][index].append(tuple(outcome))
    return outcomes


def _equal(one: Outcome, other: Outcome) -> bool:
    """Rewards are compared as floats that were computed in two ways."""
    return one[:2] == other[:2] and math.isclose(one[2], other[2], rel_tol=1e-6, abs_tol=1e-9)
