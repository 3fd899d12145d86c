"""Critics from solutions: bounds that are no wider than their roundings, and never above 1."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from dead_ends.labels.labelling import INFINITE
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.bellman import value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.critic import Settings, from_times
from dead_ends.values.fixed_point.rounding import grow, shrink
from dead_ends.values.values import Values

UNIT = 2.0**-53
CONVENTIONS = list(product(ValueConvention, CriticConvention))


def settings(gamma: float | Fraction = 0.5, **more: object) -> Settings:
    given: dict[str, object] = {
        "value": "cost-fail-0",
        "critic": "loss-target",
        "exact": None,
        "tolerance": 1e-9,
        "max_iterations": 100,
    }
    return Settings.read(gamma, **(given | more))  # type: ignore[arg-type]


def risky(p: float | Fraction, over: float = 0.0) -> SafeMDP:
    """0 -> 1 or fail, half and half (or a little more); 1 -> fail with probability p, or goal."""
    one_of = 1 - p
    P = np.zeros((4, 1, 4), dtype=object if isinstance(p, Fraction) else float)
    half = Fraction(1, 2) if isinstance(p, Fraction) else 0.5
    P[0, 0, 1], P[0, 0, 3] = half + over if over else half, half
    P[1, 0, 3], P[1, 0, 2] = p, one_of
    return SafeMDP.stochastic(P, np.arange(4) == 3, terminal=np.arange(4) == 2)


@pytest.mark.parametrize("gamma", [1.0, 1 - 1e-12])
def test_no_critic_is_above_one_though_rows_are(gamma: float) -> None:
    """0.5 + 0.5 (1 + 1.8e-9) almost surely: within the tolerance of rows, above 1."""
    values = value_iteration(risky(1 - 1e-13, over=9e-10), gamma)
    assert values.V[1] < 1  # not known from the graph, so that the sum is not known to be 1
    assert values.Q_upper[0, 0] == 1.0
    assert 1 - 1e-9 < values.Q_lower[0, 0] <= values.Q[0, 0] <= 1
    assert values.V_upper[0] <= 1


@pytest.mark.parametrize(("value", "critic"), CONVENTIONS)
@pytest.mark.parametrize("gamma", [Fraction(9, 10), Fraction(1)])
def test_bounds_are_as_wide_as_their_roundings(
    gamma: Fraction, value: ValueConvention, critic: CriticConvention
) -> None:
    """Nothing is solved here but sums of two terms: some twenty roundings, in every convention."""
    exact = value_iteration(risky(Fraction(3, 10)), gamma, value=value, critic=critic)
    floats = value_iteration(risky(0.3), float(gamma), value=value, critic=critic)
    for truth, low, mid, high in (
        (exact.V, floats.V_lower, floats.V, floats.V_upper),
        (exact.Q[:3].ravel(), *(q[:3].ravel() for q in (floats.Q_lower, floats.Q, floats.Q_upper))),
    ):
        for x, a, b, c in zip(truth, low, mid, high, strict=True):
            assert Fraction(float(a)) <= x <= Fraction(float(c))
            assert a <= b <= c
            assert c - a <= 60 * UNIT * float(x)  # so 0 is known to be 0
    assert floats.Q[3, 0] == floats.Q_lower[3, 0] == floats.Q_upper[3, 0] == np.inf


@pytest.mark.parametrize("gamma", [0.9, 1.0])
def test_a_factor_of_gamma_costs_four_operations_and_no_factor_none(gamma: float) -> None:
    """One row with one term, so that V is known within (7 + 9) u; gamma V within 10 u more."""
    plain = value_iteration(risky(0.3), gamma, value=ValueConvention.COST_FAIL_1)
    assert plain.V_upper[1] - plain.V_lower[1] <= 18 * UNIT * 0.3
    timed = value_iteration(risky(0.3), gamma, value=ValueConvention.TIME)
    if gamma == 1:
        assert timed.V_lower[:3].tolist() == plain.V_lower[:3].tolist()
        assert timed.V_upper[:3].tolist() == plain.V_upper[:3].tolist()
    else:
        assert timed.V_lower[:2].tolist() == shrink(gamma * plain.V_lower[:2], 4.0).tolist()
        assert timed.V_upper[:2].tolist() == grow(gamma * plain.V_upper[:2], 4.0).tolist()
        assert timed.V_upper[2] == 0


def test_a_factor_of_gamma_has_its_rounding() -> None:
    """For every real that rounds to gamma."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        gamma = float(rng.uniform(0.01, 1))
        p = float(rng.uniform(0.01, 0.99))
        values = value_iteration(
            risky(p),
            gamma,
            value=ValueConvention.TIME,
            critic=CriticConvention.DISCOUNTED_NEXT_VALUE,
        )
        for side in (-1, 1):
            g = Fraction(gamma) + side * Fraction(float(np.spacing(gamma))) / 2
            V = g * Fraction(p)  # fail in the step after this one, and one step more
            assert Fraction(float(values.V_lower[1])) <= V <= Fraction(float(values.V_upper[1]))


@pytest.mark.parametrize("gamma", [0.5, Fraction(1, 2)])
def test_times_are_exponents(gamma: float | Fraction) -> None:
    table = np.array([[1, 0], [2, -1], [3, 3], [0, 0]])
    model = SafeMDP.deterministic(table, np.arange(4) == 3)
    times = np.array([INFINITE, 2, 1, 0], dtype=np.int32)
    found: Values = from_times(model, times, settings(gamma))
    assert found.V.tolist() == [0, 0.5, 1, 0]
    assert found.Q.tolist() == [[0.25, 0], [0.5, np.inf], [1, 1], [np.inf, np.inf]]
    assert (found.iterations, found.model, found.gamma_safe) == (0, model, gamma)
    assert found.exact == isinstance(gamma, Fraction)
    next_value = settings(gamma, value="cost-fail-1", critic="next-value")
    assert from_times(model, times, next_value).V.tolist() == [0, 0.5, 1, 1]
    for low, high in ((found.V_lower, found.V_upper), (found.Q_lower, found.Q_upper)):
        if found.exact:
            assert low.tolist() == high.tolist()
        else:
            finite = np.isfinite(high)
            assert (high[finite] - low[finite] <= 30 * UNIT * high[finite]).all()


def test_settings_are_read() -> None:
    read = settings(0.25, value="time", critic="next-value")
    assert (read.gamma, read.exact) == (0.25, False)
    assert (read.value, read.critic) == (ValueConvention.TIME, CriticConvention.NEXT_VALUE)
    assert settings(Fraction(1, 4)).exact
    assert settings(0.1, exact=True).gamma == Fraction(1, 10)
    assert settings(max_iterations=1).max_iterations == 1
    for tolerance in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match=f"^tolerance must be positive, not {tolerance}$"):
            settings(tolerance=tolerance)
    for most in (0, -1):
        with pytest.raises(ValueError, match=f"^max_iterations must be at least 1, not {most}$"):
            settings(max_iterations=most)
