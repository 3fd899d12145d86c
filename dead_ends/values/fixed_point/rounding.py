"""Sums of products of non-negative numbers, rounded outward.

Let u = 2**-53. If x is computed from non-negative floats by m operations (+, *), counted
along the longest chain, then the true result lies within x (1 +- m u / (1 - m u)). A float
that stands for any real number that rounds to it counts as one more operation. So

    x (1 - m u) <= truth <= x (1 + (m + 2) u),

as long as m < 2**25; the last term also covers the rounding of 1 + (m + 2) u. Underflow adds
at most m times the smallest normal number (which holds even where the processor flushes
subnormal numbers to zero).

Probabilities, discounts and values are never negative, so this is all the interval
arithmetic that the solvers need, and it costs one multiplication a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

__all__ = ["TINY", "Csr", "Float", "RoundedKernel", "grow", "pattern", "product", "shrink"]

Float = NDArray[np.float64]
Csr: TypeAlias = "sparse.csr_array[np.float64]"

UNIT = 2.0**-53
TINY = float(np.finfo(np.float64).tiny)
CONSTANT_OPERATIONS = 6
"""A row's operations that do not grow with it: the probability and gamma as they are given,
gamma * value, probability * weight, and the two of the outward rounding itself."""


def shrink(value: Float, operations: Float | float) -> Float:
    """A lower bound of what ``value`` is after that many operations."""
    result: Float = np.maximum(value * (1 - operations * UNIT) - operations * TINY, 0.0)
    return result


def grow(value: Float, operations: Float | float) -> Float:
    """An upper bound of what ``value`` is after that many operations."""
    result: Float = value * (1 + (operations + 2) * UNIT) + operations * TINY
    return result


@dataclass(frozen=True, eq=False)
class RoundedKernel:
    """Rows of probabilities, and how many operations their sums take.

    Attributes:
        matrix: CSR (R, S). Columns of states whose weight is always 0 are empty, so that an
            empty row means exactly 0.
        operations: float (R,), for shrink and grow; 0 on empty rows.
        certain: bool (R,): rows whose sum is exactly 1, because all their successors have
            weight 1.
    """

    matrix: Csr
    operations: Float
    certain: NDArray[np.bool_]

    @classmethod
    def build(
        cls, kernel: Csr, zero: NDArray[np.bool_], one: NDArray[np.bool_], merged: int = 0
    ) -> RoundedKernel:
        """The rows of ``kernel`` without the states of weight 0.

        Args:
            kernel: CSR (R, S).
            zero, one: bool (S,), states whose weight is 0 or 1 in every product to come.
            merged: the operations that an entry of the kernel took.
        """
        matrix = kernel @ sparse.diags_array((~zero).astype(np.float64))
        matrix.eliminate_zeros()
        matrix = sparse.csr_array(matrix)
        terms = np.diff(matrix.indptr).astype(np.float64)
        operations = np.where(terms > 0, terms + merged + CONSTANT_OPERATIONS, 0.0)
        others = product(pattern(kernel), (~one).astype(np.float64))
        certain = (others == 0) & (np.diff(kernel.indptr) > 0)
        return cls(matrix, operations, certain)

    def rows(self, index: NDArray[Any]) -> RoundedKernel:
        """Some of the rows."""
        return RoundedKernel(
            sparse.csr_array(self.matrix[index]), self.operations[index], self.certain[index]
        )

    def sums(self, weights: Float) -> Float:
        """sum_s' P(s') w(s') of each row, to nearest."""
        return np.where(self.certain, 1.0, product(self.matrix, weights))

    def lower(self, weights: Float) -> Float:
        """Lower bounds of the sums, given lower bounds of the weights."""
        return np.where(self.certain, 1.0, shrink(product(self.matrix, weights), self.operations))

    def upper(self, weights: Float) -> Float:
        """Upper bounds of the sums, given upper bounds of the weights."""
        return np.where(self.certain, 1.0, grow(product(self.matrix, weights), self.operations))


def product(matrix: Csr, vector: Float) -> Float:
    """matrix times vector, as an array."""
    return np.asarray(matrix @ vector, dtype=np.float64)


def pattern(kernel: Csr) -> Csr:
    """The same matrix with ones."""
    return sparse.csr_array(
        (np.ones(len(kernel.data)), kernel.indices, kernel.indptr), shape=kernel.shape
    )
