"""The result of the solvers: a safety critic within bounds. Every array is read-only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.conventions import CriticConvention, ValueConvention

__all__ = ["Values"]


@dataclass(frozen=True, eq=False)
class Values:
    """A safety critic: V_c and Q_c of a policy, or of the best one.

    ``V, Q = values`` unpacks the two tables.

    Attributes:
        V: (S,), float64, or Fractions (dtype object) if ``exact``.
        Q: (S, A), the same; +inf for actions that are not available and on fail rows.
        V_lower, V_upper, Q_lower, Q_upper: bounds that enclose the true value of every
            model whose numbers round to those given; equal to V and Q if ``exact``.
        exact: whether V and Q are Fractions, without any rounding.
        iterations: sweeps or policy improvements made.
        model: the model that was solved.
        gamma_safe: the discount of the cost.
        value, critic: the paper's convention in which V and Q are given.
    """

    V: NDArray[Any]
    Q: NDArray[Any]
    V_lower: NDArray[Any]
    V_upper: NDArray[Any]
    Q_lower: NDArray[Any]
    Q_upper: NDArray[Any]
    exact: bool
    iterations: int
    model: SafeMDP
    gamma_safe: float | Fraction
    value: ValueConvention
    critic: CriticConvention

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return iter((self.V, self.Q))
