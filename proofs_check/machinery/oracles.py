"""Brute force over policies, in exact arithmetic; imports nothing of the project but the model.

Everything here follows the definitions of the paper word by word and knows no shortcut: "for
all policies" is a loop over all deterministic stationary policies (for the quantities below
they attain the extrema over all policies), the value of a policy is the solution of its linear
system in Fractions. It is meant for models of a handful of states.

States and actions are plain integers, tables are lists; ``None`` stands for infinity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP

Distribution = dict[int, Fraction]
"""Successor -> probability, positive entries only."""

Kernel = list[list[Distribution]]
"""One distribution a state and action; empty where the action is not available."""

FAIL, DEAD, SAFE, AT_RISK = range(4)


def kernel_of(model: SafeMDP) -> Kernel:
    """The exact transition probabilities as nested lists."""
    matrix = model.transitions()
    probabilities = model.exact_probabilities()
    rows = [
        {
            int(matrix.indices[i]): probabilities[i]
            for i in range(int(matrix.indptr[row]), int(matrix.indptr[row + 1]))
        }
        for row in range(model.num_states * model.num_actions)
    ]
    width = model.num_actions
    return [rows[s * width : (s + 1) * width] for s in range(model.num_states)]


def available_actions(model: SafeMDP, state: int) -> list[int]:
    """The actions of a state; of a fail state, the placeholder 0."""
    return [int(a) for a in np.flatnonzero(model.available[state])] or [0]


def policies(model: SafeMDP) -> Iterator[tuple[int, ...]]:
    """All deterministic stationary policies (fail states carry the placeholder 0)."""
    return product(*(available_actions(model, s) for s in range(model.num_states)))


def chain(model: SafeMDP, policy: Sequence[int] | NDArray[Any]) -> list[Distribution]:
    """The Markov chain of a policy: int (S,), or probabilities (S, A) as Fractions."""
    kernel = kernel_of(model)
    rows: list[Distribution] = []
    for state, choice in enumerate(policy):
        row: Distribution = {}
        if not model.fail[state]:
            weights = (
                {int(choice): Fraction(1)} if np.ndim(choice) == 0 else dict(enumerate(choice))
            )
            for action, weight in weights.items():
                for successor, p in kernel[state][action].items():
                    row[successor] = row.get(successor, Fraction(0)) + Fraction(weight) * p
        rows.append({successor: p for successor, p in row.items() if p})
    return rows


def solve(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """The solution of a regular linear system, by Gauss-Jordan elimination."""
    size = len(matrix)
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for column in range(size):
        pivot = next(r for r in range(column, size) if rows[r][column])
        rows[column], rows[pivot] = rows[pivot], rows[column]
        head = rows[column][column]
        rows[column] = [entry / head for entry in rows[column]]
        for r in range(size):
            factor = rows[r][column]
            if r != column and factor:
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[column], strict=True)]
    return [row[size] for row in rows]


def reaches(rows: Sequence[Distribution], goal: set[int]) -> set[int]:
    """The states from which the chain reaches ``goal`` with positive probability."""
    found = set(goal)
    while True:
        more = {s for s, row in enumerate(rows) if s not in found and found & row.keys()}
        if not more:
            return found
        found |= more


def _first_passage(
    rows: Sequence[Distribution], fail: set[int], gamma: Fraction, at_entry: Fraction
) -> list[Fraction]:
    """x(s) = sum p(t|s) (at_entry if t fails, else gamma x(t)), the least solution; 0 on fail."""
    unknown = sorted(reaches(rows, fail) - fail)
    index = {state: i for i, state in enumerate(unknown)}
    matrix = [[Fraction(int(i == j)) for j in range(len(unknown))] for i in range(len(unknown))]
    right = [Fraction(0)] * len(unknown)
    for state, i in index.items():
        for successor, p in rows[state].items():
            if successor in fail:
                right[i] += at_entry * p
            elif successor in index:
                matrix[i][index[successor]] -= gamma * p
    values = [Fraction(0)] * len(rows)
    for state, value in zip(unknown, solve(matrix, right), strict=True):
        values[state] = value
    return values


def fail_states(model: SafeMDP) -> set[int]:
    """S_fail as a set."""
    return {int(s) for s in np.flatnonzero(model.fail)}


def entry_cost(
    model: SafeMDP, policy: Sequence[int] | NDArray[Any], gamma: Fraction
) -> list[Fraction]:
    """V_c^pi(s) = E sum gamma^t I(s_{t+1} in fail), the paper's definition; 0 on fail states."""
    return _first_passage(chain(model, policy), fail_states(model), gamma, Fraction(1))


def discounted_time(
    model: SafeMDP, policy: Sequence[int] | NDArray[Any], gamma: Fraction
) -> list[Fraction]:
    """E gamma^(time to fail), 1 on fail states."""
    fail = fail_states(model)
    values = _first_passage(chain(model, policy), fail, gamma, gamma)
    return [Fraction(1) if s in fail else value for s, value in enumerate(values)]


def failure_probability(model: SafeMDP, policy: Sequence[int] | NDArray[Any]) -> list[Fraction]:
    """P(ever fail | s, pi), 1 on fail states."""
    return discounted_time(model, policy, Fraction(1))


def pointwise_minimum(tables: Iterator[list[Fraction]]) -> list[Fraction]:
    """The least value of each state over all tables."""
    return [min(column) for column in zip(*tables, strict=True)]


def optimal_entry_cost(model: SafeMDP, gamma: Fraction) -> list[Fraction]:
    """V_c*(s) = min over policies of V_c^pi(s)."""
    return pointwise_minimum(entry_cost(model, policy, gamma) for policy in policies(model))


def optimal_discounted_time(model: SafeMDP, gamma: Fraction) -> list[Fraction]:
    """min over policies of E gamma^(time to fail)."""
    return pointwise_minimum(discounted_time(model, policy, gamma) for policy in policies(model))


def least_failure_probability(model: SafeMDP) -> list[Fraction]:
    """P_min(ever fail | s)."""
    return pointwise_minimum(failure_probability(model, policy) for policy in policies(model))


def loss_target(model: SafeMDP, V: Sequence[Fraction], gamma: Fraction) -> list[list[Any]]:
    """Q(s,a) = E [c + (1 - c) gamma V(s')]; infinite where the action is not available."""
    return expectation(
        model, [Fraction(1) if f else gamma * v for f, v in zip(model.fail, V, strict=True)]
    )


def expectation(model: SafeMDP, V: Sequence[Fraction]) -> list[list[Any]]:
    """E V(s') for each state and action; infinite where the action is not available."""
    return [
        [sum((p * V[t] for t, p in row.items()), Fraction(0)) if row else np.inf for row in rows]
        for rows in kernel_of(model)
    ]


def labels(model: SafeMDP) -> list[int]:
    """Definition 2: what P_min(ever fail) says about each state."""
    return [
        FAIL if fail else DEAD if p == 1 else SAFE if p == 0 else AT_RISK
        for fail, p in zip(model.fail, least_failure_probability(model), strict=True)
    ]


def survival_times(model: SafeMDP) -> list[int | None]:
    """The most steps to failure over all paths, fail states 0; None if some path never fails.

    The paths are those of a deterministic model in which the agent picks the outcomes too;
    a longest or an infinite one is found by following all of its policies.
    """
    kernel = kernel_of(model)
    outcomes = [sorted({t for row in rows for t in row}) for rows in kernel]
    longest: list[int | None] = [0] * len(kernel)
    for choice in product(*(options or [state] for state, options in enumerate(outcomes))):
        for state, best in enumerate(longest):
            steps = steps_to_fail(choice, fail_states(model), state)
            longest[state] = None if best is None or steps is None else max(best, steps)
    return longest


def steps_to_fail(successor: Sequence[int], fail: set[int], state: int) -> int | None:
    """Steps until a path enters ``fail``; None if it revisits a state first."""
    seen: set[int] = set()
    while state not in fail:
        if state in seen:
            return None
        seen.add(state)
        state = successor[state]
    return len(seen)


def greatest_expected_time(model: SafeMDP) -> list[Fraction | None]:
    """E_max[time to fail] on the states with P_min = 1 (fail states 0), None elsewhere."""
    fail = fail_states(model)
    doomed = [s for s, p in enumerate(least_failure_probability(model)) if p == 1]
    inside = [s for s in doomed if s not in fail]
    best: list[Fraction | None] = [
        Fraction(0) if s in doomed else None for s in range(model.num_states)
    ]
    for policy in policies(model):
        rows = chain(model, policy)
        matrix = [[Fraction(int(s == t)) - rows[s].get(t, 0) for t in inside] for s in inside]
        for state, time in zip(inside, solve(matrix, [Fraction(1)] * len(inside)), strict=True):
            best[state] = max(best[state] or Fraction(0), time)
    return best


def horizons(model: SafeMDP) -> tuple[int, int | None]:
    """H and H_b of a deterministic model (H_b: None if no safe state has an unsafe successor)."""
    time = survival_times(model)
    kernel = kernel_of(model)
    entered = [
        time[t]
        for state, rows in enumerate(kernel)
        if time[state] is None
        for row in rows
        for t in row
    ]
    unsafe = [steps for steps in entered if steps is not None]
    finite = [steps for steps in time if steps is not None]
    return max(finite, default=0), max(unsafe, default=None)


def stays_inside(model: SafeMDP, executed: Sequence[Sequence[int]], region: set[int]) -> bool:
    """Whether a closed loop that may execute any of ``executed[s]`` never leaves ``region``.

    Follows every path from every state of the region.
    """
    kernel = kernel_of(model)
    reached, frontier = set(region), set(region)
    while frontier:
        frontier = {
            t for s in frontier if not model.fail[s] for a in executed[s] for t in kernel[s][a]
        } - reached
        reached |= frontier
    return reached == region


def survival_probability(
    model: SafeMDP, executed: Sequence[Sequence[int]], steps: int
) -> list[Fraction]:
    """The least P(no failure within ``steps``) if any of ``executed[s]`` may be executed.

    The choice may depend on the past; against a fixed number of steps the worst choice
    depends on the state and the steps left alone.
    """
    kernel = kernel_of(model)
    alive = [Fraction(int(not failed)) for failed in model.fail]
    for _ in range(steps):
        alive = [
            Fraction(0)
            if model.fail[s]
            else min(
                sum((p * alive[t] for t, p in kernel[s][a].items()), Fraction(0))
                for a in executed[s]
            )
            for s in range(model.num_states)
        ]
    return alive


def is_expectile(
    values: Sequence[Fraction], weights: Sequence[Fraction], tau: Fraction, m: Fraction
) -> bool:
    """Whether m minimises sum w L_tau(x - m): its derivative in m is zero."""
    pull = sum(
        (
            w * (tau if x > m else 1 - tau) * (x - m)
            for x, w in zip(values, weights, strict=True)
            if w
        ),
        Fraction(0),
    )
    return pull == 0
