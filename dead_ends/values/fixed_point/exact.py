"""Exact values: policy iteration in Fractions.

The equations are those of :mod:`dead_ends.values.fixed_point.operators`,
x(s) = sum_a m(a) q(s, a), where the weights m are those that the operator chooses at the current
q: the best action, a policy's row, or the expectile's weights. States whose value is known from
the graph (fail; P_min = 0; at gamma = 1 also P_min = 1) are not unknowns. On the others every
policy leaves the unknowns with probability 1, so that the linear systems are regular also at
gamma = 1, where naive policy iteration stalls: {stay, fail} with the policy "fail" has
Q(stay) = Q(fail) = 1.

Each linear system is solved by sparse elimination, one strongly connected component after
the other, successors first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from graphlib import TopologicalSorter
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["Choose", "ExactProblem", "exact_rows"]

Row = list[tuple[int, Fraction]]
"""P(. | s, a): successors and their probabilities."""
Choose = Callable[[int, Mapping[int, Any]], Mapping[int, Fraction]]
"""(state, its q, Fractions or floats) -> the weights m(a), which sum to 1."""
Equations = dict[int, tuple[Fraction, dict[int, Fraction]]]
"""For each unknown s: x(s) = constant + sum of coefficient * x(s')."""
ZERO = Fraction(0)
SWEEPS = 50


def exact_rows(model: SafeMDP) -> list[dict[int, Row]]:
    """For each state the available actions' rows; a float is read as its shortest decimal.

    Raises:
        ValueError: naming the state and action whose row does not sum to exactly 1.
    """
    kernel = model.transitions()
    probabilities = model.exact_probabilities()
    rows: list[dict[int, Row]] = [{} for _ in range(model.num_states)]
    for state, action in np.argwhere(model.available):
        row = state * model.num_actions + action
        start, stop = int(kernel.indptr[row]), int(kernel.indptr[row + 1])
        successors = (int(successor) for successor in kernel.indices[start:stop])
        rows[state][int(action)] = list(zip(successors, probabilities[start:stop], strict=True))
    return rows


class ExactProblem:
    """The equations of the unknown states, and their solution by policy iteration."""

    def __init__(
        self,
        rows: list[dict[int, Row]],
        known: Mapping[int, Fraction],
        gamma: Fraction,
        choose: Choose,
        reward: Fraction = ZERO,
    ) -> None:
        """
        Args:
            rows: P, from :func:`exact_rows`.
            known: w(s') of the states that are not unknowns.
            gamma: the discount of the unknowns.
            choose: the operator.
            reward: r, added to each q.
        """
        self.rows, self.known, self.gamma = rows, known, gamma
        self.choose, self.reward = choose, reward
        self.unknown = [state for state in range(len(rows)) if state not in known]

    def solve(self) -> tuple[dict[int, Fraction], int]:
        """x of the unknown states, and the number of policies evaluated.

        The first policy is chosen in floats, so that it is often the last.
        """
        values = self._approximation()
        equations = self._equations(values)
        rounds = 0
        while True:
            improved = _solve_linear(equations)
            rounds += 1
            following = self._equations(improved)
            if improved == values or following == equations:
                return improved, rounds
            values, equations = improved, following

    def _approximation(self) -> dict[int, Fraction]:
        """Some sweeps of value iteration in floats."""
        weights = {state: float(w) for state, w in self.known.items()}
        weights |= dict.fromkeys(self.unknown, 0.0)
        rows = [
            (s, {a: [(t, float(p)) for t, p in row] for a, row in self.rows[s].items()})
            for s in self.unknown
        ]
        gamma, reward = float(self.gamma), float(self.reward)
        for _ in range(SWEEPS):
            for state, actions in rows:
                q = {a: reward + sum(p * weights[t] for t, p in row) for a, row in actions.items()}
                x = sum(float(m) * q[a] for a, m in self.choose(state, q).items())
                weights[state] = gamma * x
        return {state: Fraction(weights[state]) / self.gamma for state in self.unknown}

    def q(self, state: int, values: Mapping[int, Fraction]) -> dict[int, Fraction]:
        """q(s, a) of the available actions."""
        return {
            action: self.reward + sum((p * self._weight(t, values) for t, p in row), ZERO)
            for action, row in self.rows[state].items()
        }

    def _weight(self, state: int, values: Mapping[int, Fraction]) -> Fraction:
        known = self.known.get(state)
        return self.gamma * values[state] if known is None else known

    def _equations(self, values: Mapping[int, Fraction]) -> Equations:
        """x(s) = sum_a m(a) q(s, a) with the weights chosen at these values."""
        equations: Equations = {}
        for state in self.unknown:
            weights = self.choose(state, self.q(state, values))
            constant, coefficients = self.reward, dict[int, Fraction]()
            for action, weight in weights.items():
                for successor, p in self.rows[state][action]:
                    known = self.known.get(successor)
                    if known is not None:
                        constant += weight * p * known
                    else:
                        old = coefficients.get(successor, ZERO)
                        coefficients[successor] = old + weight * p * self.gamma
            equations[state] = (constant, coefficients)
        return equations


def _solve_linear(equations: Equations) -> dict[int, Fraction]:
    solved: dict[int, Fraction] = {}
    for component in _components(equations):
        _eliminate(component, equations, solved)
    return solved


def _components(equations: Equations) -> list[list[int]]:
    """The strongly connected components, successors first."""
    position = {state: i for i, state in enumerate(equations)}
    edges = [(position[s], position[t]) for s, (_, c) in equations.items() for t in c]
    sources, targets = np.array(edges, dtype=np.int64).reshape(-1, 2).T
    shape = (len(equations), len(equations))
    graph = sparse.csr_array((np.ones(len(edges)), (sources, targets)), shape=shape)
    count, labels = csgraph.connected_components(graph, connection="strong")
    order: TopologicalSorter[int] = TopologicalSorter({label: set() for label in range(count)})
    for source, target in zip(labels[sources], labels[targets], strict=True):
        if source != target:
            order.add(int(source), int(target))
    members: list[list[int]] = [[] for _ in range(count)]
    for state, label in zip(equations, labels, strict=True):
        members[label].append(state)
    return [members[label] for label in order.static_order()]


def _eliminate(component: list[int], equations: Equations, solved: dict[int, Fraction]) -> None:
    """Gaussian elimination inside one component; x outside it is already in ``solved``.

    The next state is the one that fills least: fewest terms times fewest appearances.
    """
    inside = set(component)
    constants: dict[int, Fraction] = {}
    rows: dict[int, dict[int, Fraction]] = {}
    appearances: dict[int, set[int]] = {state: set() for state in component}
    for state in component:
        constant, coefficients = equations[state]
        outside = (c * solved[t] for t, c in coefficients.items() if t not in inside)
        constants[state] = constant + sum(outside, ZERO)
        rows[state] = {t: c for t, c in coefficients.items() if t in inside}
        for t in rows[state]:
            appearances[t].add(state)
    order = []
    while inside:
        state = min(inside, key=lambda s: (len(rows[s]) * len(appearances[s]), s))
        inside.remove(state)
        order.append(state)
        _substitute(state, constants, rows, appearances)
    for state in reversed(order):
        later = (c * solved[t] for t, c in rows[state].items())
        solved[state] = constants[state] + sum(later, ZERO)


def _substitute(
    state: int,
    constants: dict[int, Fraction],
    rows: dict[int, dict[int, Fraction]],
    appearances: dict[int, set[int]],
) -> None:
    """Solve the state's equation for it and put the result into the others."""
    row = rows[state]
    scale = 1 / (1 - row.pop(state, ZERO))
    constants[state] *= scale
    for t in row:
        row[t] *= scale
        appearances[t].discard(state)
    for other in appearances[state] - {state}:
        factor = rows[other].pop(state)
        constants[other] += factor * constants[state]
        for t, c in row.items():
            rows[other][t] = rows[other].get(t, ZERO) + factor * c
            appearances[t].add(other)
