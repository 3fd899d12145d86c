"""Values against closed forms; further sources of truth in test_enclosure and test_exact."""

from fractions import Fraction

import numpy as np
import pytest

from dead_ends.bellman import evaluate_policy, value_iteration
from dead_ends.model import SafeMDP


def corridor(length: int) -> SafeMDP:
    """State 0 fails, state n only steps to n - 1; the last state may also stay."""
    back = np.maximum(np.arange(length + 1) - 1, 0)
    stay = np.full(length + 1, -1)
    stay[length] = length
    fail = np.zeros(length + 1, dtype=bool)
    fail[0] = True
    return SafeMDP.deterministic(np.stack((back, stay), axis=1), fail)


def gambler(size: int, p: float | Fraction) -> SafeMDP:
    """Fortune 0 fails, fortune ``size`` is the goal; win with probability p."""
    kernel = np.full((size + 1, 1, size + 1), type(p)(0), dtype=object)
    for fortune in range(1, size):
        kernel[fortune, 0, fortune + 1] = p
        kernel[fortune, 0, fortune - 1] = 1 - p
    ends = np.arange(size + 1)
    return SafeMDP.stochastic(kernel, ends == 0, terminal=ends == size)


def test_corridor_has_powers_of_gamma() -> None:
    V, Q = value_iteration(corridor(5), 0.99)
    np.testing.assert_array_equal(V, [0, 1, 0.99, 0.99**2, 0.99**3, 0])
    np.testing.assert_array_equal(Q[:, 0], [np.inf, 1, 0.99, 0.99**2, 0.99**3, 0.99**4])
    np.testing.assert_array_equal(Q[:, 1], [np.inf] * 5 + [0])


def test_no_power_is_rounded_to_zero() -> None:
    values = value_iteration(corridor(2000), 0.5)
    assert (values.V[1:2000] > 0).all()
    assert values.V[2000] == 0
    assert values.Q[2000, 0] > 0
    assert values.V_lower[1999] == 0


def test_gamblers_ruin_is_bracketed() -> None:
    p, size = Fraction(2, 5), 12
    ratio = (1 - p) / p
    ruin = [(ratio**size - ratio**k) / (ratio**size - 1) for k in range(size + 1)]
    values = value_iteration(gambler(size, 0.4), 1.0)
    for k in range(1, size):
        assert Fraction(values.V_lower[k]) <= ruin[k] <= Fraction(values.V_upper[k])
    assert (values.V_upper - values.V_lower).max() < 1e-12
    exact = evaluate_policy(gambler(size, p), np.zeros(size + 1, dtype=int), Fraction(1))
    assert list(exact.V[1:]) == ruin[1:]


def test_discount_must_lie_in_the_unit_interval() -> None:
    with pytest.raises(ValueError, match=r"gamma_safe must lie in \(0, 1\], not 1.5"):
        value_iteration(corridor(3), 1.5)
