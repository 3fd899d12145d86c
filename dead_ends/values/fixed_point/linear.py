"""Floating-point solutions of x = M x + c, where M >= 0 has row sums of at most 1.

Nothing here is trusted: what is built on these solutions is verified with outward rounding
(:mod:`dead_ends.values.fixed_point.enclosure`). They only have to be good, and fast where that
is possible:

* sparse elimination, state by state where time runs one way (a car that nears an obstacle):
  in the order of the strong components next to nothing fills in; else where the graph is
  narrow enough. Without pivoting it adds, multiplies and divides non-negative numbers except
  on the diagonal, so that small components have small relative errors too;
* Krylov iterations, where the chain mixes fast. Errors are small against the largest
  component.

A large graph that is neither has no quick solution.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph, linalg

from dead_ends.values.fixed_point.rounding import Csr, Float, product

__all__ = ["LinearSolver"]

Csc: TypeAlias = "sparse.csc_array[np.float64]"
Order = NDArray[np.intp]

SMALL = 2000
"""Up to so many unknowns elimination takes no time."""
ELIMINATION_COST = 1e10
"""Beyond, it is used if an envelope method would need no more multiplications than this."""
TINY = 30
"""Up to so many states in each strong component elimination follows their order."""
REFINEMENTS = 8


class LinearSolver:
    """Solves systems with similar graphs; remembers whether elimination is affordable."""

    def __init__(self, matrix: Csr) -> None:
        """
        Args:
            matrix: M of the first system, for a look at its graph.
        """
        size = matrix.shape[0]
        self._small = size <= SMALL
        self._eliminates = self._small or _elimination_cost(matrix) <= ELIMINATION_COST

    def quickly(self, matrix: Csr, constant: Float, start: Float) -> Float | None:
        """x with errors small against its largest component; None if there is no quick way."""
        order = _one_way_order(matrix)
        if self._small or order is not None:
            return _eliminated(matrix, constant, order)
        x = _krylov(matrix, constant, start)
        return _eliminated(matrix, constant, order) if x is None and self._eliminates else x

    def carefully(self, matrix: Csr, constant: Float, start: Float) -> Float | None:
        """x with small relative errors, where elimination is affordable."""
        order = _one_way_order(matrix)
        if self._eliminates or order is not None:
            return _eliminated(matrix, constant, order)
        return _krylov(matrix, constant, start)


def _eliminated(matrix: Csr, constant: Float, order: Order | None) -> Float | None:
    """Sparse LU without pivoting: the diagonal of 1 - M dominates its row.

    ``order`` is the order of elimination, if there is a better one than least fill-in.
    """
    system = sparse.csc_array(sparse.eye_array(len(constant)) - matrix)
    if order is not None:
        system = sparse.csc_array(system[order][:, order])
        constant = constant[order]
    try:
        factors = linalg.splu(
            system,
            permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # exactly singular
        return None
    x: Float = factors.solve(constant)
    if order is not None:
        x[order] = x.copy()
    return x if np.isfinite(x).all() else None


def _one_way_order(matrix: Csr) -> Order | None:
    """Successors first, if all strong components are tiny; else None."""
    _, component = csgraph.connected_components(matrix, connection="strong")
    if np.bincount(component).max(initial=0) > TINY:
        return None
    # scipy numbers a component after those that it leads to, but does not promise it: where
    # it did not, elimination would take longer, not be wrong.
    return np.argsort(component, kind="stable")


def _krylov(matrix: Csr, constant: Float, start: Float) -> Float | None:
    """GMRES with refinement; None if the residual does not come down to rounding errors."""
    system = sparse.csr_array(sparse.eye_array(len(constant)) - matrix)
    x = start
    residual = constant - product(system, x)
    for _ in range(REFINEMENTS):
        before = np.abs(residual).max()
        if before <= 2e-16 * np.abs(x).max():
            break
        correction, _ = linalg.gmres(system, residual, rtol=1e-6, atol=0.0, restart=50, maxiter=1)
        x = x + correction
        residual = constant - product(system, x)
        if not np.abs(residual).max() < 0.3 * before:
            break
    return x if np.abs(residual).max() <= 4e-15 * np.abs(x).max() else None


def _elimination_cost(matrix: Csr) -> float:
    """Multiplications of an envelope method, an upper estimate for a good sparse one.

    The sum of the squared widths of the rows, after numbering the graph breadth-first
    (reverse Cuthill-McKee).
    """
    graph = sparse.csr_array(matrix + matrix.T + sparse.eye_array(matrix.shape[0]))
    order = csgraph.reverse_cuthill_mckee(graph, symmetric_mode=True)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    first = np.minimum.reduceat(place[graph.indices], graph.indptr[:-1])
    widths = (place - first).astype(np.float64)
    return float(widths @ widths)
