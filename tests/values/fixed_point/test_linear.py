"""Floating-point solutions of x = M x + c, against substitution and dense elimination."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from dead_ends.values.fixed_point.linear import SMALL, LinearSolver


def chain_with(num_states: int, back: int, seed: int) -> sparse.csr_array:
    """Each state leads to some of the ``2 * back`` around it; all rows sum to 0.9.

    With ``back`` 0 to states of lower number and to itself only: time runs one way.
    """
    rng = np.random.default_rng(seed)
    rows = np.repeat(np.arange(num_states), 3)
    low = 200 if back == 0 else back
    columns = np.clip(rows + rng.integers(-low, back + 1, len(rows)), 0, num_states - 1)
    shape = (num_states, num_states)
    matrix = sparse.coo_array((np.full(len(rows), 0.3), (rows, columns)), shape=shape)
    order = rng.permutation(num_states)  # numbers say nothing about the order
    return sparse.csr_array(matrix.tocsr()[order][:, order])


@pytest.mark.parametrize("back", [0, 3])
@pytest.mark.parametrize("num_states", [50, SMALL + 500])
@pytest.mark.parametrize("how", ["quickly", "carefully"])
def test_solutions_solve(back: int, num_states: int, how: str) -> None:
    matrix = chain_with(num_states, back, seed=back)
    constant = np.random.default_rng(1).random(num_states)
    x = getattr(LinearSolver(matrix), how)(matrix, constant, constant)
    expected = np.linalg.solve(np.eye(num_states) - matrix.toarray(), constant)
    np.testing.assert_allclose(x, expected, rtol=1e-12)


def test_one_way_graphs_are_solved_with_small_relative_errors() -> None:
    """A corridor of 10,000 states, wide in any numbering: components down to 1e-300."""
    length = 10_000
    factor = 0.9334
    shift = sparse.diags_array([np.full(length - 1, factor)], offsets=[-1])
    order = np.random.default_rng(0).permutation(length)
    matrix = sparse.csr_array(shift.tocsr()[order][:, order])
    start = np.zeros(length)
    start[np.flatnonzero(order == 0)] = 1.0
    x = LinearSolver(matrix).carefully(matrix, start, start)
    assert x is not None
    np.testing.assert_allclose(x, factor ** order.astype(float), rtol=1e-10)


def test_a_singular_system_has_no_solution() -> None:
    matrix = sparse.csr_array(np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert LinearSolver(matrix).quickly(matrix, np.ones(2), np.ones(2)) is None
