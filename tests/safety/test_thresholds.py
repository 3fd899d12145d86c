"""The interval against the definition, "allowed if and only if safe", on small models."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.thresholds import ThresholdInterval, threshold_interval
from dead_ends.values.bellman import value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.discount import power_at_most

HALF = Fraction(1, 2)
CONVENTIONS = list(itertools.product(ValueConvention, CriticConvention))


def all_models(num_states: int, num_actions: int) -> list[SafeMDP]:
    """All deterministic models whose last state is the only fail state."""
    fail = np.arange(num_states) == num_states - 1
    entries = (num_states - 1) * num_actions
    tables = itertools.product(range(num_states), repeat=entries)
    rows = [np.reshape([*t, *[0] * num_actions], (num_states, num_actions)) for t in tables]
    return [SafeMDP.deterministic(table, fail) for table in rows]


def random_models(count: int, seed: int) -> list[SafeMDP]:
    rng = np.random.default_rng(seed)
    models = []
    for _ in range(count):
        n, m = int(rng.integers(3, 8)), int(rng.integers(1, 4))
        fail = np.arange(n) == n - 1
        # Mostly downhill, so that there are long ways to fail.
        steps = np.minimum(np.arange(n)[:, None] + rng.integers(0, 3, (n, m)), n - 1)
        jumps = rng.integers(0, n, (n, m))
        models.append(SafeMDP.deterministic(np.where(rng.random((n, m)) < 0.8, steps, jumps), fail))
    return models


def corridor(horizon: int) -> SafeMDP:
    """State 0 fails, every other state steps down; the last one may also stay: H_b = horizon."""
    states = np.arange(horizon + 2)
    stay = np.where(states == horizon + 1, states, -1)
    return SafeMDP.deterministic(np.stack((np.maximum(states - 1, 0), stay), 1), states == 0)


def survival(model: SafeMDP) -> list[float]:
    """T by n rounds of its definition."""
    table, n = model.successors(), model.num_states
    times = [0.0 if f else math.inf for f in model.fail]
    for length in range(1, n):  # the states that fail within `length` steps, whatever they do
        for s in range(n):
            if times[s] == math.inf and all(times[t] < length for t in table[s]):
                times[s] = 1 + max(times[t] for t in table[s])
    return times


def literal_critic(
    model: SafeMDP, gamma: Fraction, value: ValueConvention, critic: CriticConvention
) -> tuple[list[float], list[list[Fraction]]]:
    """T and Q as the paper's formulas read, without the exponents of the implementation."""
    times = survival(model)
    fail_value = Fraction(0 if value is ValueConvention.COST_FAIL_0 else 1)

    def v(t: float) -> Fraction:
        if t == 0:
            return fail_value
        if t == math.inf:
            return Fraction(0)
        return gamma ** int(t if value is ValueConvention.TIME else t - 1)

    def q(t: float) -> Fraction:
        cost = int(t == 0)
        if critic is CriticConvention.NEXT_VALUE:
            return v(t)
        if critic is CriticConvention.LOSS_TARGET:
            return cost + (1 - cost) * gamma * v(t)
        return gamma * v(t)

    table = model.successors()
    return times, [[q(times[t]) for t in row] for row in table]


@pytest.mark.parametrize(("value", "critic"), CONVENTIONS)
def test_deterministic_table_is_exactly_the_right_thresholds(
    value: ValueConvention, critic: CriticConvention
) -> None:
    empty = unbounded = 0
    for model in all_models(3, 2) + random_models(60, seed=1):
        times, Q = literal_critic(model, HALF, value, critic)
        table = model.successors()
        safe = [s for s in range(model.num_states) if times[s] == math.inf]
        pairs = [(s, a) for s in safe for a in range(model.num_actions)]
        staying = [Q[s][a] for s, a in pairs if times[table[s, a]] == math.inf]
        leaving = [Q[s][a] for s, a in pairs if times[table[s, a]] < math.inf]
        assert set(staying) <= {0}
        interval = threshold_interval(model, HALF, value=value, critic=critic)
        assert interval.upper == min(leaving, default=math.inf)
        empty += interval.empty
        unbounded += interval.upper == math.inf
        if not interval.empty and leaving:
            assert isinstance(interval.upper, Fraction)
            assert interval.contains(interval.upper)
            assert not interval.contains(interval.upper + Fraction(1, 10**30))
    assert unbounded
    literal = value is ValueConvention.COST_FAIL_0 and critic is not CriticConvention.LOSS_TARGET
    assert bool(empty) == literal


@pytest.mark.parametrize(("value", "critic"), CONVENTIONS)
@pytest.mark.parametrize("gamma", [0.99, 0.7, 1.0, HALF])
def test_filter_is_exact_at_the_end_and_at_the_recommendation(
    value: ValueConvention, critic: CriticConvention, gamma: float | Fraction
) -> None:
    for model in random_models(15, seed=2):
        interval = threshold_interval(model, gamma, value=value, critic=critic)
        if interval.empty:
            assert interval.recommended is None
            continue
        labelling = classify(model)
        safe = labelling.safe
        Q = value_iteration(model, gamma, value=value, critic=critic).Q[safe]
        expected = safe_actions(model, labelling)[safe]
        assert interval.recommended is not None
        for epsilon in (interval.upper, interval.recommended):
            if epsilon != math.inf:
                assert interval.contains(epsilon)
                np.testing.assert_array_equal(np.asarray(epsilon > Q, dtype=bool), expected)


def test_users_power_is_contained() -> None:
    for gamma in (0.5, 0.7, 0.9, 0.99, 0.9999):
        for horizon in range(1, 40, 3):
            interval = threshold_interval(corridor(horizon), gamma)
            assert interval.exponent == horizon
            assert interval.upper == gamma**horizon
            assert interval.contains(gamma**horizon)
            assert not interval.contains(math.nextafter(gamma**horizon, 2))


def test_underflow_keeps_the_interval_open() -> None:
    model = corridor(2000)
    interval = threshold_interval(model, 0.5)
    assert interval.upper is None
    assert not interval.empty
    assert interval.recommended is None
    assert not interval.contains(math.ulp(0.0))
    assert interval.contains(HALF**2000)
    assert not interval.contains(HALF**2000 + HALF**2100)
    assert not interval.contains(Fraction(0))
    smaller = "gamma_safe**2000, about 8.70981e-603, which is smaller than every float"
    assert str(interval) == f"0 < epsilon_safe <= {smaller}"
    exact = threshold_interval(model, HALF)
    assert exact.upper == HALF**2000
    assert exact.recommended is None
    assert str(exact) == str(interval)


@pytest.mark.parametrize("gamma", [0.5, 0.7, 0.9, 0.99])
def test_where_floats_are_subnormal_no_promise_is_rounded(gamma: float) -> None:
    """Around the least float ``upper`` is the greatest one below the power, if there is one."""
    exact = Fraction(repr(gamma))
    last = round(math.log(math.ulp(0.0)) / math.log(gamma))
    for exponent in (*range(last - 40, last + 20, 3), last, last + 1):
        interval = ThresholdInterval(power_at_most(gamma, exponent), exponent, gamma)
        bound = exact**exponent
        if interval.upper is None:
            assert bound < math.ulp(0.0)
            assert interval.recommended is None
            continue
        assert interval.upper <= bound < math.nextafter(float(interval.upper), 1)
        assert interval.recommended is not None
        assert 0 < interval.recommended <= interval.upper
        if interval.upper > 2 * math.ulp(0.0):
            assert interval.recommended < interval.upper


@pytest.mark.parametrize(
    ("gamma", "exponent", "recommended"),
    [
        (1 - Fraction(1, 10**400), 3, 0.5),  # as a float it is 1, and no power lies between
        (1 - 2.0**-53, 1, (1 - 2.0**-53) / 2),
        (Fraction(1, 10**400), 0, 0.5),
        (Fraction(1, 10**400), 1, None),
        (Fraction(1, 3), 2, 3**-2.5),
    ],
)
def test_a_float_is_recommended_if_there_is_one(
    gamma: Fraction | float, exponent: int, recommended: float | None
) -> None:
    interval = threshold_interval(corridor(exponent), gamma)
    assert interval.exponent == exponent
    assert interval.recommended == pytest.approx(recommended)


def test_what_a_sentence_says_is_true() -> None:
    said = [
        (threshold_interval(corridor(2), 0.5), "gamma_safe**2 = 0.25"),
        (threshold_interval(corridor(2), HALF), "gamma_safe**2 = 1/4"),
        (threshold_interval(corridor(60), HALF), "gamma_safe**60, about 8.67362e-19"),
        (threshold_interval(corridor(1070), 0.5), "gamma_safe**1070, about 8e-323"),
        (threshold_interval(two_rooms(HALF), HALF), "1/8"),
        (
            threshold_interval(two_rooms(HALF**1100), HALF),
            "about 1.84054e-332, which is smaller than every float",
        ),
    ]
    for interval, text in said:
        assert str(interval) == f"0 < epsilon_safe <= {text}"


def two_rooms(p: Fraction) -> SafeMDP:
    """0 may stay or risk p; 1 is at risk (1/2 fail, 1/2 back to 0)."""
    P = np.full((3, 2, 3), Fraction(0), dtype=object)
    P[0, 0, 0] = Fraction(1)
    P[0, 1, 1], P[0, 1, 0] = p, 1 - p
    P[1, :, 2] = P[1, :, 0] = Fraction(1, 2)
    return SafeMDP.stochastic(P, np.array([False, False, True]))


def test_stochastic_interval_is_restored_theorem_2() -> None:
    model = two_rooms(Fraction(1, 10))
    gamma = Fraction(9, 10)
    exact = threshold_interval(model, gamma)
    assert exact.upper == Fraction(1, 10) * gamma * Fraction(1, 2)
    floats = threshold_interval(model, 0.9)
    assert isinstance(floats.upper, float)
    assert 0.045 * (1 - 1e-13) < floats.upper <= 0.045
    assert floats.exponent is None
    assert floats.recommended == floats.upper / 2


def test_stochastic_interval_is_about_states_that_need_not_fail() -> None:
    """State 1, which risks 1/100, is not reached from state 0, where the choice is 0 or 1."""
    P = np.zeros((3, 2, 3))
    P[0, 0, 0] = P[0, 1, 2] = 1
    P[1, :, 0], P[1, :, 2] = 0.99, 0.01
    model = SafeMDP.stochastic(P, np.array([False, False, True]))
    assert threshold_interval(model, 0.9).upper == 1


def test_stochastic_interval_may_be_empty_or_unbounded() -> None:
    P = np.zeros((2, 2, 2))
    P[0, 0, 0] = P[0, 1, 1] = 1
    model = SafeMDP.stochastic(P, np.array([False, True]))
    assert threshold_interval(model, critic=CriticConvention.NEXT_VALUE).empty
    P[0, 1] = [1, 0]
    interval = threshold_interval(SafeMDP.stochastic(P, np.array([False, True])))
    assert interval.upper == math.inf
    assert interval.recommended == 0.5


def test_random_stochastic_models_allow_exactly_what_stays_in_z() -> None:
    rng = np.random.default_rng(3)
    bounded = 0
    for _ in range(60):
        n, m = 6, 3
        P = np.full((n, m, n), Fraction(0), dtype=object)
        for s, a in np.ndindex(n, m):
            for t in rng.integers(0, n, 2):
                P[s, a, t] += HALF
        model = SafeMDP.stochastic(P, np.arange(n) == n - 1)
        labelling = classify(model)
        expected = safe_actions(model, labelling)[labelling.safe]
        for gamma in (Fraction(9, 10), 0.9, 1.0):
            interval = threshold_interval(model, gamma)
            if interval.upper == math.inf:
                continue
            bounded += 1
            values = value_iteration(model, gamma)
            allowed = np.asarray(values.Q[labelling.safe] < interval.upper, dtype=bool)
            np.testing.assert_array_equal(allowed, expected)
            if values.exact:
                wider = interval.upper + Fraction(1, 10**20)
                allowed = np.asarray(values.Q[labelling.safe] < wider, dtype=bool)
                assert (allowed != expected).any()
    assert bounded > 20


def test_values_too_small_for_floats_are_reported() -> None:
    size = 120
    P = np.zeros((size + 1, 2, size + 1))
    P[0, 0, 0] = 1
    P[0, 1, 1] = 1
    for s in range(1, size):
        P[s, :, 0], P[s, :, s + 1] = 1 - 1e-3, 1e-3
    model = SafeMDP.stochastic(P, np.arange(size + 1) == size)
    with pytest.raises(ValueError, match="state 0, action 1: Q is positive.*use exact=True"):
        threshold_interval(model, 0.99)
    assert threshold_interval(model, 0.99, exact=True).upper > 0


def test_nan_is_no_threshold() -> None:
    with pytest.raises(ValueError, match="epsilon_safe is NaN"):
        ThresholdInterval(0.5, 1, 0.5).contains(math.nan)


def test_float_epsilon_is_read_as_its_shortest_decimal_beside_fractions() -> None:
    interval = ThresholdInterval(Fraction(970299, 1000000), 3, Fraction(99, 100))
    assert interval.contains(0.970299)
    assert not interval.contains(math.nextafter(0.970299, 1))
    assert not interval.contains(math.inf)
