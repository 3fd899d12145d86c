"""Greedy and allowed actions, recovery policies and policy sets, on tables made by hand."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.critics import critic_table, unguarded
from dead_ends.safety.policies import (
    Reading,
    allowed_actions,
    greedy_actions,
    in_policy_set,
    recovery_policy,
)
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.values import Values

INF = math.inf
F = Fraction

# Rows: a tie, one minimiser, an unavailable action, a fail state.
TABLE = np.array([[0.5, 0.25, 0.25], [1.0, 0.9, 0.0], [INF, 0.3, 0.7], [INF, INF, INF]])


def fractions(rows: list[list[Any]]) -> NDArray[np.object_]:
    table = np.empty((len(rows), len(rows[0])), dtype=object)
    for index in np.ndindex(table.shape):
        table[index] = rows[index[0]][index[1]]
    return table


def values_of(
    Q: NDArray[Any],
    lower: NDArray[Any] | None = None,
    upper: NDArray[Any] | None = None,
    *,
    model: SafeMDP,
) -> Values:
    exact = Q.dtype == object
    V = Q.min(axis=1)
    return Values(
        V=V,
        Q=Q,
        V_lower=V,
        V_upper=V,
        Q_lower=Q if lower is None else lower,
        Q_upper=Q if upper is None else upper,
        exact=exact,
        iterations=1,
        model=model,
        gamma_safe=F(1, 2) if exact else 0.5,
        value=ValueConvention.COST_FAIL_0,
        critic=CriticConvention.LOSS_TARGET,
    )


def choice_model() -> SafeMDP:
    """State 0 stays or enters state 1, which falls into the fail state 2."""
    table = np.array([[0, 1], [2, 2], [-1, -1]], dtype=np.int32)
    return SafeMDP.deterministic(table, np.array([False, False, True]), state_names="abc")


def risky_model() -> SafeMDP:
    """The same, but action 1 of state 0 only risks state 1."""
    P = np.zeros((3, 2, 3))
    P[0, 0, 0] = 1
    P[0, 1, [0, 1]] = 0.5
    P[1, :, 2] = 1
    return SafeMDP.stochastic(P, np.array([False, False, True]), action_names=["stay", "risk"])


def test_greedy_actions_are_all_minimisers_and_no_unavailable_ones() -> None:
    expected = [[False, True, True], [False, False, True], [False, True, False], [False] * 3]
    assert greedy_actions(TABLE).tolist() == expected
    assert greedy_actions(TABLE.tolist()).tolist() == expected
    exact = fractions([[F(1, 3), F(2, 6), F(1, 2)], [INF, F(1, 7), INF], [INF, INF, INF]])
    assert greedy_actions(exact).tolist() == [
        [True, True, False],
        [False, True, False],
        [False] * 3,
    ]


def test_one_ulp_is_no_tie() -> None:
    table = np.array([[0.3, math.nextafter(0.3, 1)]])
    assert greedy_actions(table).tolist() == [[True, False]]


def test_recovery_policy_takes_the_first_minimiser() -> None:
    assert recovery_policy(TABLE).tolist() == [1, 2, 1, 0]


def test_recovery_policy_draws_among_the_minimisers_only() -> None:
    rng = np.random.default_rng(0)
    draws = np.array([recovery_policy(TABLE, rng) for _ in range(200)])
    assert set(draws[:, 0]) == {1, 2}
    assert 60 < np.count_nonzero(draws[:, 0] == 1) < 140
    assert set(map(tuple, draws[:, 1:])) == {(2, 1, 0)}


def test_allowed_is_strictly_below() -> None:
    assert allowed_actions(unguarded(TABLE), 0.25).tolist() == [
        [False, False, False],
        [False, False, True],
        [False] * 3,
        [False] * 3,
    ]
    assert allowed_actions(unguarded(TABLE), math.nextafter(0.25, 1))[0].tolist() == [
        False,
        True,
        True,
    ]
    assert not allowed_actions(unguarded(TABLE), 0).any()
    assert not allowed_actions(unguarded(TABLE), -1.0).any()
    assert np.array_equal(allowed_actions(unguarded(TABLE), INF), np.isfinite(TABLE))


def test_float32_tables_are_compared_exactly() -> None:
    table = np.array([[np.float32(0.3)]])  # 0.30000001192..., above 0.3
    assert not allowed_actions(unguarded(table), 0.3).any()
    assert np.array_equal(allowed_actions(unguarded(table), F(float(table[0, 0]))), [[False]])


def test_integer_tables_are_compared_exactly() -> None:
    assert allowed_actions(unguarded(np.array([[0, 1]])), 1).tolist() == [[True, False]]


@settings(deadline=None)  # a busy machine may pause
@given(st.floats(0, 1), st.fractions(0, 1))
def test_a_fraction_threshold_is_not_rounded(q: float, epsilon: Fraction) -> None:
    for each in (q, float(epsilon), math.nextafter(float(epsilon), 2)):
        assert allowed_actions(unguarded(np.array([[each]])), epsilon)[0, 0] == (F(each) < epsilon)


def test_beside_fractions_a_float_threshold_is_its_shortest_decimal() -> None:
    exact = fractions([[F(1, 10), F(1, 10) - F(1, 10**30), INF]])
    # The float 0.1 is a little above 1/10; compared as such it would let 1/10 pass.
    assert allowed_actions(unguarded(exact), 0.1).tolist() == [[False, True, False]]
    assert allowed_actions(unguarded(exact), F(1, 10)).tolist() == [[False, True, False]]
    assert allowed_actions(unguarded(exact), INF).tolist() == [[True, True, False]]


def test_bounds_decide_for_rounded_values() -> None:
    Q = np.array([[0.0, 0.25], [0.5, 0.5], [INF, INF]])
    lower, upper = Q - 0.01, Q + 0.01
    values = values_of(Q, lower, upper, model=risky_model())
    assert allowed_actions(values, 0.4).tolist() == [[True, True], [False] * 2, [False] * 2]
    with pytest.raises(
        ValueError,
        match=r"^state 0, action 1 \(risk\): Q lies between 0.24 and 0.26, so it is not certain "
        r"whether it is below epsilon_safe = 0.25: use exact values, or an epsilon_safe that is "
        r"farther away$",
    ):
        allowed_actions(values, 0.25)
    with pytest.raises(ValueError, match="state 0, action 1"):
        allowed_actions(values, 0.26)  # the upper bound may be attained
    assert allowed_actions(values, math.nextafter(0.26, 1))[0].tolist() == [True, True]
    assert allowed_actions(values, 0.24)[0].tolist() == [True, False]


def test_a_power_of_gamma_is_compared_as_a_power() -> None:
    Q = np.array([[0.0, 0.5], [1.0, 1.0], [INF, INF]])
    lower, upper = np.nextafter(Q, 0), np.where(Q > 0, np.nextafter(Q, 2), Q)
    values = values_of(Q, lower, upper, model=choice_model())
    assert allowed_actions(values, 0.5)[0].tolist() == [True, False]
    assert allowed_actions(values, 0.5**1.5)[0].tolist() == [True, False]
    assert allowed_actions(values, 0.5**0.5)[0].tolist() == [True, True]
    with pytest.raises(ValueError, match=r"state 0 \(a\), action 1"):
        allowed_actions(values, math.nextafter(0.5, 1))
    # A threshold that no float equals is no power of a float gamma.
    with pytest.raises(ValueError, match=r"state 0 \(a\), action 1"):
        allowed_actions(values, F(1, 2) + F(1, 10**40))


def test_an_underflowed_value_is_not_taken_for_a_safe_zero() -> None:
    Q = np.array([[0.0, 0.0], [1.0, 1.0], [INF, INF]])
    upper = np.array([[0.0, 5e-324], [1.0, 1.0], [INF, INF]])
    values = values_of(Q, Q, upper, model=risky_model())
    assert greedy_actions(values)[0].tolist() == [True, False]
    assert greedy_actions(Q)[0].tolist() == [True, True]
    assert critic_table(values)[0].tolist() == [0.0, 5e-324]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (np.array([[0.0, math.nan]]), "Q: state 0, action 1 is NaN"),
        (fractions([[F(1)], [math.nan]]), "Q: state 1, action 0 is NaN"),
        (fractions([[F(1)], [None]]), "Q: state 1, action 0 is None, not a number"),
        (fractions([["0.5"]]), "Q: state 0, action 0 is '0.5', not a number"),
        (np.zeros(3), r"Q must have shape \(S, A\), not \(3,\)"),
        (np.zeros((2, 0)), r"Q must have shape \(S, A\), not \(2, 0\)"),
        (np.zeros((2, 2), dtype=bool), "Q must hold floats or Fractions, not bool"),
        (np.zeros((2, 2), dtype=complex), "Q must hold floats or Fractions, not complex128"),
        (np.array([["a"]]), "Q must hold floats or Fractions, not <U1"),
    ],
)
def test_bad_tables_are_named(table: NDArray[Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        greedy_actions(table)
    with pytest.raises(ValueError, match=f"^{message}$"):
        allowed_actions(unguarded(table), 0.5)
    with pytest.raises(ValueError, match=f"^{message}$"):
        recovery_policy(table)


def test_a_bare_table_decides_only_if_one_says_so() -> None:
    for what in (TABLE, TABLE.tolist(), None):
        with pytest.raises(TypeError, match=r"^allowed_actions takes a Values .*unguarded\(Q\)"):
            allowed_actions(what, 0.5)  # type: ignore[arg-type]  # what a caller may get wrong
    table = TABLE.copy()
    critic = unguarded(table)
    table[:] = 0
    assert np.array_equal(critic.Q, TABLE)
    assert not critic.Q.flags.writeable
    assert recovery_policy(critic).tolist() == recovery_policy(TABLE).tolist()


def test_bad_thresholds_are_named() -> None:
    with pytest.raises(ValueError, match=r"^epsilon_safe is NaN$"):
        allowed_actions(unguarded(TABLE), math.nan)
    with pytest.raises(ValueError, match=r"^epsilon_safe must be a number, not '0.3'$"):
        allowed_actions(unguarded(TABLE), "0.3")  # type: ignore[arg-type]  # what a caller may get wrong
    with pytest.raises(ValueError, match=r"^epsilon_safe must be a number, not True$"):
        allowed_actions(unguarded(TABLE), True)


def test_the_readings_of_the_policy_set_differ() -> None:
    # s: {stay, fail}, the uniform policy, gamma = 1/2: V(s) = 1/2 (1/2 V(s)) + 1/2, V = 2/3.
    Q = fractions([[F(1, 3), F(1)], [INF, INF]])
    safe = np.array([True, False])
    uniform = fractions([[F(1, 2), F(1, 2)], [F(0), F(0)]])
    arguments: dict[str, Any] = {"epsilon_safe": F(7, 10), "safe": safe}
    assert not in_policy_set(uniform, unguarded(Q), **arguments)
    assert in_policy_set(uniform, unguarded(Q), **arguments, reading=Reading.EXPECTATION)
    assert in_policy_set(uniform, unguarded(Q), **arguments, reading="expectation")
    exactly = {**arguments, "epsilon_safe": F(2, 3)}
    assert not in_policy_set(uniform, unguarded(Q), **exactly, reading="expectation")
    assert in_policy_set(np.array([0, 0]), unguarded(Q), **arguments)
    assert not in_policy_set(np.array([1, 0]), unguarded(Q), **arguments)
    assert not in_policy_set(np.array([1, 0]), unguarded(Q), **arguments, reading="expectation")


def test_expectations_are_exact_and_rows_are_scaled() -> None:
    # Ten times 0.1 in floating point is 0.9999999999999999; the mean of equal numbers is exact.
    Q = np.full((1, 10), 0.3)
    Q[0, 0], Q[0, 1] = 0.25, 0.35
    policy = np.full((1, 10), 0.1)
    mean = sum((F(q) for q in Q[0]), F(0)) / 10
    safe = np.array([True])
    for epsilon in (mean, mean + F(1, 10**40)):
        expected = mean < epsilon
        assert (
            in_policy_set(policy, unguarded(Q), epsilon, safe=safe, reading="expectation")
            == expected
        )


def test_an_unavailable_action_has_an_infinite_expectation() -> None:
    policy = np.array([[0.5, 0.5]])
    Q = np.array([[0.0, INF]])
    safe = np.array([True])
    assert not in_policy_set(policy, unguarded(Q), 0.5, safe=safe, reading="expectation")


def test_states_that_are_not_safe_do_not_count() -> None:
    Q = np.array([[0.0, 0.5], [1.0, 1.0], [INF, INF]])
    policy = np.array([0, 1, 0])
    assert in_policy_set(policy, unguarded(Q), 0.5, safe=np.array([True, False, False]))
    assert not in_policy_set(policy, unguarded(Q), 0.5, safe=np.array([True, True, False]))


def test_values_know_which_states_are_safe() -> None:
    Q = np.array([[0.0, 0.5], [1.0, 1.0], [INF, INF]])
    values = values_of(Q, model=choice_model())
    assert in_policy_set(np.array([0, 1, -1]), values, 0.5)
    assert not in_policy_set(np.array([1, 1, -1]), values, 0.5)


def test_undecided_expectations_are_named() -> None:
    Q = np.array([[0.0, 0.5], [1.0, 1.0], [INF, INF]])
    values = values_of(Q, Q - 0.125, Q + 0.125, model=risky_model())
    policy = np.array([[0.5, 0.5], [0.5, 0.5], [0.0, 0.0]])
    with pytest.raises(
        ValueError, match=r"^state 0: the expectation of Q lies between 0.125 and 0.375, so"
    ):
        in_policy_set(policy, values, 0.25, reading="expectation")
    assert in_policy_set(policy, values, 0.38, reading="expectation")
    assert not in_policy_set(policy, values, 0.125, reading="expectation")


@settings(deadline=None)  # a busy machine may pause
@given(
    st.lists(
        st.tuples(st.fractions(0, 1, max_denominator=8), st.fractions(0, 1, max_denominator=8)),
        min_size=1,
        max_size=4,
    ),
    st.fractions(0, 1, max_denominator=8),
    st.lists(st.integers(0, 4), min_size=4, max_size=4),
)
def test_policy_sets_agree_with_their_definition(
    rows: list[tuple[Fraction, Fraction]], epsilon: Fraction, weights: list[int]
) -> None:
    Q = fractions([list(row) for row in rows])
    shares = [F(w, 4) for w in weights[: len(rows)]]
    policy = fractions([[1 - p, p] for p in shares])
    safe = np.ones(len(rows), dtype=np.bool_)
    per_action = all(
        q < epsilon
        for row, p in zip(rows, shares, strict=True)
        for q, weight in zip(row, (1 - p, p), strict=True)
        if weight > 0
    )
    expected = all(
        row[0] * (1 - p) + row[1] * p < epsilon for row, p in zip(rows, shares, strict=True)
    )
    assert in_policy_set(policy, unguarded(Q), epsilon, safe=safe) == per_action
    assert (
        in_policy_set(policy, unguarded(Q), epsilon, safe=safe, reading="expectation") == expected
    )


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (np.array([0, 2, 0]), r"policy: state 1: there is no action 2 \(0 to 1\)"),
        (np.array([-1, 0, 0]), r"policy: state 0: there is no action -1 \(0 to 1\)"),
        (np.array([0, 1]), r"policy must be integers \(3,\) or probabilities \(3, 2\), not .*"),
        (np.array([0.0, 1.0, 0.0]), r"policy must be integers \(3,\) or .*, not float64 \(3,\)"),
        (np.full((3, 2), 0.25), r"policy: state 0: probabilities sum to 0.5, not 1"),
        (np.full((3, 2), math.nan), r"policy: state 0, action 0: probability nan"),
        (
            np.array([[1.0, 0.0], [1.5, -0.5], [0.0, 0.0]]),
            r"policy: state 1, action 1: probability -0.5",
        ),
    ],
)
def test_bad_policies_are_named(policy: NDArray[Any], message: str) -> None:
    Q = np.array([[0.0, 0.5], [1.0, 1.0], [INF, INF]])
    with pytest.raises(ValueError, match=f"^{message}$"):
        in_policy_set(policy, unguarded(Q), 0.5, safe=np.array([True, False, False]))


def test_the_mask_of_safe_states_is_needed_and_checked() -> None:
    Q = np.array([[0.0, 0.5]])
    with pytest.raises(ValueError, match=r"^in_policy_set needs `safe`, the mask of S_safe"):
        in_policy_set(np.array([0]), unguarded(Q), 0.5)
    for safe in (np.array([True, True]), np.array([1])):
        with pytest.raises(ValueError, match=r"^safe must be a boolean mask of shape \(1,\), not"):
            in_policy_set(np.array([0]), unguarded(Q), 0.5, safe=safe)
    with pytest.raises(ValueError, match="'other' is not a valid Reading"):
        in_policy_set(np.array([0]), unguarded(Q), 0.5, safe=np.array([True]), reading="other")
