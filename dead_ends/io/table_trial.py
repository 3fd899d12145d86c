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

from dead_ends.io.errors import optional_module
from dead_ends.io.transitions import Transitions
from dead_ends.io.trial import (
    copy_of,
    copy_with_wrappers,
    global_generators_kept,
    is_discrete,
    take_step,
    use_randomness,
)

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
        env: with its wrappers; not changed. Without ``step``, or with observations that are no
            numbers of states, there is nothing to compare.
        transitions: its table, with ``done`` and ``reward``.

    Raises:
        ValueError: naming a step, or a first state, that the table excludes.
    """
    core = env.unwrapped
    step = getattr(type(core), "step", None)
    none = optional_module("gymnasium", "an environment", "gym").Env.step
    if step in (None, none) or not is_discrete(core.observation_space):
        return
    outcomes = _outcomes(transitions)
    for state, index, seen in _steps(copy_of(core), outcomes, transitions):
        if not any(_equal(seen, outcome) for outcome in outcomes[state][index]):
            successor, ends, reward = seen
            raise ValueError(
                f"state {state}, action {index + transitions.first_action}: a step leads to state "
                f"{successor} with reward {reward:g}{', where the episode ends,' if ends else ''} "
                "and the table P gives that probability 0"
            )
    wrapped = copy_with_wrappers(env)
    if wrapped is None:
        return
    for state, index, seen in _steps(wrapped, outcomes, transitions):
        if not any(seen[:2] == outcome[:2] for outcome in outcomes[state][index]):
            raise ValueError(
                f"state {state}, action {index + transitions.first_action}: with its wrapper "
                f"{type(wrapped).__name__} the environment moves otherwise than its table P; the "
                "model is of env.unwrapped, and so must be what is corrected"
            )


def _steps(
    env: Any, outcomes: Outcomes, transitions: Transitions
) -> Iterator[tuple[int, int, Outcome]]:
    """State, index of the action and what came of it, taking the action least often tried.

    A wrapper's reset may bring another table; then there is no more to compare.
    """
    rng = np.random.default_rng(0)
    tried = {state: dict.fromkeys(actions, 0) for state, actions in outcomes.items()}
    left, core = STEPS, env.unwrapped
    with global_generators_kept():
        use_randomness(core, rng)
        while left > 0:
            left -= 1
            observation, _ = env.reset(seed=int(rng.integers(2**31)))
            if env.unwrapped is not core:
                return
            state = _number(observation)
            _check_start(state, transitions)
            for _ in range(EPISODE_STEPS):
                if state not in tried:
                    break
                counts = tried[state]
                least = [index for index in counts if counts[index] == min(counts.values())]
                index = least[int(rng.integers(len(least)))]
                counts[index] += 1
                left -= 1
                action = index + transitions.first_action
                successor, reward, terminated, truncated = take_step(env, action)
                yield state, index, (_number(successor), terminated, reward)
                state = _number(successor)
                if terminated or truncated:
                    break


def _number(observation: Any) -> int:
    try:
        return int(np.asarray(observation).item())
    except (TypeError, ValueError):
        raise ValueError(
            f"the observation {observation!r} is no number of a state, as its space says"
        ) from None


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
