"""Bellman's operator on the states whose value is not known from the graph.

    x(s) = opt_a q(s, a),      q(s, a) = r + sum_s' P(s' | s, a) w(s'),

where w(s') = gamma x(s') for unknown states and a constant for the others, and opt is min or
max. With r = 0, w(fail) = 1 and opt = min, x is V_c*, the discounted cost on entering fail, and
q the critic in the base convention; with one action it is the value of a policy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.values.fixed_point.rounding import Csr, Float, RoundedKernel, grow, shrink

__all__ = ["Optimum", "unknown_rows"]


@dataclass(frozen=True, eq=False)
class Optimum:
    """x -> opt_a q(., a), a monotone operator (:mod:`dead_ends.values.fixed_point.enclosure`).

    Attributes:
        kernel: the rows (n * A, S) of the n unknown states.
        available: bool (n, A), at least one True a row.
        unknown: int (n,), the unknown states.
        weights: float (S,), w of the known states (0 on the unknown ones).
        gamma: the discount.
        reward: r.
        maximise: whether opt is max.
    """

    kernel: RoundedKernel
    available: NDArray[np.bool_]
    unknown: NDArray[np.int64]
    weights: Float
    gamma: float
    reward: float = 0.0
    maximise: bool = False

    def value(self, x: Float) -> Float:
        """F(x), to nearest."""
        return self._best(self.reward + self.kernel.sums(self._successors(x)))

    def lower(self, x: Float) -> Float:
        """F(x), rounded downward."""
        sums = self.kernel.lower(self._successors(x))
        return self._best(shrink(self.reward + sums, 1) if self.reward else sums)

    def upper(self, x: Float) -> Float:
        """F(x), rounded upward."""
        sums = self.kernel.upper(self._successors(x))
        return self._best(grow(self.reward + sums, 1) if self.reward else sums)

    def linear(self, x: Float) -> tuple[Csr, Float]:
        """The rows of the best actions at x, on the unknown states, and the rest."""
        q = self._table(self.reward + self.kernel.sums(self._successors(x)))
        rows = self._pick(q.argmax(axis=1) if self.maximise else q.argmin(axis=1))
        chosen = self.kernel.rows(rows)
        return self._on_unknown(chosen.matrix), self.reward + chosen.sums(self.weights)

    def _successors(self, x: Float) -> Float:
        weights = self.weights.copy()
        weights[self.unknown] = self.gamma * x
        return weights

    def _table(self, q: Float) -> Float:
        worst = -np.inf if self.maximise else np.inf
        return np.where(self.available, q.reshape(self.available.shape), worst)

    def _best(self, q: Float) -> Float:
        table = self._table(q)
        best: Float = table.max(axis=1) if self.maximise else table.min(axis=1)
        return best

    def _pick(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        rows: NDArray[np.int64] = np.arange(len(actions)) * self.available.shape[1] + actions
        return rows

    def _on_unknown(self, matrix: Csr) -> Csr:
        return sparse.csr_array(self.gamma * matrix[:, self.unknown])


def unknown_rows(unknown: NDArray[np.int64], num_actions: int) -> NDArray[np.int64]:
    """int (n * A,): the rows s * A + a of these states."""
    rows: NDArray[np.int64] = (unknown[:, None] * num_actions + np.arange(num_actions)).ravel()
    return rows
