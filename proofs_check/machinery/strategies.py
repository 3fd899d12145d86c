"""Small models, policies, discounts and thresholds for property-based checks.

Everything is built constructively: no draw is ever thrown away, and every draw is a small
integer, so that a failing example shrinks to few states and early actions. Models come in
kinds, because a uniformly drawn table rarely has a long corridor or a near tie:

    any           each successor is any state,
    dead-end rich ranks: most states can only descend towards fail,
    corridor      one way down that is as long as the model is large,
    terminal      goals and unavailable actions.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP

Draw = st.DrawFn
DETERMINISTIC_KINDS = ("any", "dead-end rich", "corridor", "terminal")
STOCHASTIC_KINDS = ("any", "dead-end rich", "almost tie", "determined")
PROBABILITY_PARTS = 6
TINY = Fraction(1, 10**9)
"""How far "just below" and "just above" a critical value are, relative to it."""


@st.composite
def deterministic_models(draw: Draw, max_states: int = 7, max_actions: int = 3) -> SafeMDP:
    """A deterministic model with at least one fail state, the last."""
    n = draw(st.integers(2, max_states), label="states")
    m = draw(st.integers(1, max_actions), label="actions")
    kind = draw(st.sampled_from(DETERMINISTIC_KINDS), label="kind")
    fail = np.arange(n) == n - 1
    if kind == "any":
        return SafeMDP.deterministic(_any_table(draw, n, m), fail)
    if kind == "dead-end rich":
        return SafeMDP.deterministic(_ranked_table(draw, n, m), fail)
    if kind == "corridor":
        return SafeMDP.deterministic(_corridor_table(draw, n, m), fail)
    fails = draw(st.integers(1, max(1, n - 2)), label="fail states")
    goals = draw(st.integers(0, n - 1 - fails), label="goals")
    table = _any_table(draw, n, m)
    for state in range(n):  # action 0 stays available
        for action in range(1, m):
            if draw(st.booleans()):
                table[state, action] = -1
    position = np.arange(n)
    return SafeMDP.deterministic(table, position >= n - fails, terminal=position < goals)


def _any_table(draw: Draw, n: int, m: int) -> NDArray[np.int64]:
    rows = draw(
        st.lists(st.lists(st.integers(0, n - 1), min_size=m, max_size=m), min_size=n, max_size=n)
    )
    return np.array(rows)


def _ranked_table(draw: Draw, n: int, m: int) -> NDArray[np.int64]:
    """State s is lost if s >= first: its actions lead to higher numbers only, at last to fail."""
    first = draw(st.integers(0, n - 1), label="first lost state")
    rows = []
    for state in range(n):
        lowest = min(state + 1, n - 1) if state >= first else 0
        row = [draw(st.integers(lowest, n - 1)) for _ in range(m)]
        if state < first:
            row[draw(st.integers(0, m - 1))] = draw(st.integers(0, first - 1))
        rows.append(row)
    return np.array(rows)


def _corridor_table(draw: Draw, n: int, m: int) -> NDArray[np.int64]:
    """0 may stay; every other state steps down by one, or by more with its other actions."""
    rows = [[draw(st.integers(0, min(2, n - 1))) for _ in range(m)]]
    rows[0][-1] = 0
    for state in range(1, n):
        step = min(state + 1, n - 1)
        rows.append([step, *(draw(st.integers(step, n - 1)) for _ in range(m - 1))])
    return np.array(rows)


@st.composite
def stochastic_models(draw: Draw, max_states: int = 4, max_actions: int = 2) -> SafeMDP:
    """A stochastic model with rational probabilities; the last state is fail."""
    n = draw(st.integers(2, max_states), label="states")
    m = draw(st.integers(1, max_actions), label="actions")
    kind = draw(st.sampled_from(STOCHASTIC_KINDS), label="kind")
    P = np.full((n, m, n), Fraction(0), dtype=object)
    first = draw(st.integers(0, n - 1)) if kind == "dead-end rich" else n
    for state in range(n - 1):
        for action in range(m):
            lowest = state if state >= first else 0
            P[state, action] = _distribution(draw, n, lowest, point=kind == "determined")
        if state >= first:  # something leaks downwards whatever is done
            for action in range(m):
                P[state, action] = _mix(P[state, action], state + 1)
        if kind == "almost tie" and m > 1:
            P[state, -1] = _shift(P[state, 0], draw(st.integers(0, n - 1)))
    return SafeMDP.stochastic(P, np.arange(n) == n - 1)


def _distribution(draw: Draw, n: int, lowest: int, point: bool) -> NDArray[np.object_]:
    """Equal parts of probability, each given to a state at or above ``lowest``."""
    parts = 1 if point else draw(st.integers(1, PROBABILITY_PARTS))
    row = np.full(n, Fraction(0), dtype=object)
    for _ in range(parts):
        row[draw(st.integers(lowest, n - 1))] += Fraction(1, parts)
    return row


def _mix(row: NDArray[np.object_], successor: int) -> NDArray[np.object_]:
    mixed: NDArray[np.object_] = row / 2
    mixed[successor] += Fraction(1, 2)
    return mixed


def _shift(row: NDArray[np.object_], successor: int) -> NDArray[np.object_]:
    """The same distribution but for a billionth, which moves to one state."""
    shifted: NDArray[np.object_] = row * (1 - TINY)
    shifted[successor] += TINY
    return shifted


@st.composite
def deterministic_policies(draw: Draw, model: SafeMDP) -> NDArray[np.int64]:
    """int (S,): an available action in every state, 0 in fail states."""
    return np.array([_action(draw, model, state) for state in range(model.num_states)])


def _action(draw: Draw, model: SafeMDP, state: int) -> int:
    options = np.flatnonzero(model.available[state])
    return int(draw(st.sampled_from(options.tolist()))) if len(options) else 0


@st.composite
def stochastic_policies(draw: Draw, model: SafeMDP) -> NDArray[np.object_]:
    """Fractions (S, A): quarters of probability on available actions; action 0 in fail states."""
    policy = np.full((model.num_states, model.num_actions), Fraction(0), dtype=object)
    for state in range(model.num_states):
        parts = draw(st.sampled_from([1, 2, 4]))
        for _ in range(parts):
            policy[state, _action(draw, model, state)] += Fraction(1, parts)
    return policy


def policies(model: SafeMDP) -> st.SearchStrategy[NDArray[Any]]:
    """A policy of either form."""
    return deterministic_policies(model) | stochastic_policies(model)


def discounts() -> st.SearchStrategy[Fraction]:
    """gamma in (0, 1): one half, far from it, and the values in use."""
    return st.sampled_from(
        [Fraction(1, 2), Fraction(9, 10), Fraction(99, 100), Fraction(1, 10), Fraction(2, 3)]
    )


def around(critical: Fraction) -> st.SearchStrategy[Fraction]:
    """A positive critical value, just below it and just above it."""
    return st.sampled_from([critical, critical * (1 - TINY), critical * (1 + TINY)])
