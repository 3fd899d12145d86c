"""Outward rounding against exact arithmetic."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from dead_ends.values.fixed_point.rounding import RoundedKernel, grow, shrink

numbers = st.floats(min_value=0, max_value=1, allow_subnormal=True)
rows = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=40)


@given(rows, st.floats(min_value=0, max_value=1))
def test_sums_of_products_are_enclosed(terms: list[tuple[float, float]], gamma: float) -> None:
    """Also for the numbers half an ulp beside the probabilities and the discount."""
    p, x = (np.array(column) for column in zip(*terms, strict=True))
    no = np.zeros(len(p), dtype=bool)
    kernel = RoundedKernel.build(sparse.csr_array(p[None, :]), no, no)
    lower, upper = (
        bound(gamma * x)[0] if p.any() else 0.0 for bound in (kernel.lower, kernel.upper)
    )
    for side in (-1, 0, 1):
        inputs = [Fraction(float(number)) for number in (gamma, *p)]
        ulps = [Fraction(float(np.spacing(number))) for number in (gamma, *p)]
        g, *exact = [
            max(a + side * ulp / 2, Fraction(0)) if a else a
            for a, ulp in zip(inputs, ulps, strict=True)
        ]
        truth = g * sum((a * Fraction(float(b)) for a, b in zip(exact, x, strict=True)), Fraction())
        assert Fraction(float(lower)) <= truth <= Fraction(float(upper))


@given(numbers, st.integers(1, 100))
def test_factors_are_on_the_right_side(value: float, operations: int) -> None:
    unit = Fraction(1, 2**53)
    low, high = (bound(np.array(value), operations) for bound in (shrink, grow))
    exact = Fraction(value)
    m = operations - 2  # the two roundings of the bounds themselves are counted
    assert Fraction(float(low)) <= exact * (1 - max(m, 0) * unit)
    assert Fraction(float(high)) >= exact * (1 + max(m, 0) * unit)


def test_empty_and_certain_rows_are_exact() -> None:
    P = sparse.csr_array(np.array([[0.1, 0.0, 0.9], [0.3, 0.7, 0.0], [0.0, 0.0, 0.0]]))
    kernel = RoundedKernel.build(
        P, zero=np.array([True, False, True]), one=np.array([True, True, False])
    )
    weights = np.array([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(kernel.lower(weights), [0, 1, 0])
    np.testing.assert_array_equal(kernel.upper(weights), [0, 1, 0])
    np.testing.assert_array_equal(kernel.sums(weights), [0, 1, 0])
