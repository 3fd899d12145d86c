"""The oracles, against answers worked out by hand and against slower searches."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from dead_ends import SafeMDP
from proofs_check.machinery import oracles

HALF = Fraction(1, 2)
F = Fraction


def corridor() -> SafeMDP:
    """0: {stay, 1}; 1 -> 2 -> 3 = fail; 4 goal; 0's second action is the only way down."""
    table = np.array([[0, 1], [2, 2], [3, 3], [-1, -1], [0, 0]])
    return SafeMDP.deterministic(table, np.arange(5) == 3, terminal=np.arange(5) == 4, rewards=None)


def coin(p: Fraction = HALF) -> SafeMDP:
    """0: {fail with p, else again; goal}; 1: {fail with p, else again}; 2 goal; 3 fail."""
    P = np.full((4, 2, 4), F(0), dtype=object)
    P[0, 0, 3], P[0, 0, 0], P[0, 1, 2] = p, 1 - p, F(1)
    P[1, :, 3], P[1, :, 1] = p, 1 - p
    P[2, :, 2] = F(1)
    return SafeMDP.stochastic(P, np.arange(4) == 3)


def test_kernel_lists_positive_probabilities_and_no_unavailable_action() -> None:
    kernel = oracles.kernel_of(corridor())
    assert kernel[0] == [{0: 1}, {1: 1}]
    assert kernel[3] == [{}, {}]
    assert kernel[4] == [{4: 1}, {4: 1}]
    assert oracles.kernel_of(coin(F(1, 3)))[0] == [{3: F(1, 3), 0: F(2, 3)}, {2: 1}]


def test_policies_are_all_choices_of_available_actions() -> None:
    table = np.array([[0, 1, 2], [-1, 2, -1], [0, 0, 0]])
    model = SafeMDP.deterministic(table, np.array([False, False, True]))
    assert list(oracles.policies(model)) == [(0, 1, 0), (1, 1, 0), (2, 1, 0)]


def test_solve_a_system_that_needs_a_row_exchange() -> None:
    matrix = [[F(0), F(2), F(1)], [F(1), F(1), F(0)], [F(3), F(0), F(1)]]
    assert oracles.solve(matrix, [F(7), F(3), F(6)]) == [F(1), F(2), F(3)]


def test_survival_times_and_horizons_of_a_corridor() -> None:
    assert oracles.survival_times(corridor()) == [None, 2, 1, 0, None]
    assert oracles.horizons(corridor()) == (2, 2)
    assert oracles.labels(corridor()) == [
        oracles.SAFE,
        oracles.DEAD,
        oracles.DEAD,
        oracles.FAIL,
        oracles.SAFE,
    ]


def test_horizons_without_an_unsafe_successor() -> None:
    model = SafeMDP.deterministic(np.array([[0], [2], [2]]), np.arange(3) == 2)
    assert oracles.horizons(model) == (1, None)


def test_values_of_a_corridor_are_powers() -> None:
    gamma = F(3, 4)
    down = [1, 0, 0, 0, 0]
    assert oracles.entry_cost(corridor(), down, gamma) == [gamma**2, gamma, 1, 0, 0]
    assert oracles.discounted_time(corridor(), down, gamma) == [gamma**3, gamma**2, gamma, 1, 0]
    assert oracles.optimal_entry_cost(corridor(), gamma) == [0, gamma, 1, 0, 0]
    assert oracles.optimal_discounted_time(corridor(), gamma) == [0, gamma**2, gamma, 1, 0]


def test_value_of_a_mixed_policy() -> None:
    """V = p gamma^2 + (1 - p) gamma V from state 0, which stays with 1 - p."""
    gamma, p = F(1, 2), F(1, 3)
    policy = np.full((5, 2), F(1, 2), dtype=object)
    policy[0] = [1 - p, p]
    expected = p * gamma**2 / (1 - (1 - p) * gamma)
    assert oracles.entry_cost(corridor(), policy, gamma)[0] == expected


def test_values_of_a_coin() -> None:
    gamma = F(2, 3)
    again = HALF / (1 - HALF * gamma)
    assert oracles.entry_cost(coin(), [0, 0, 0, 0], gamma) == [again, again, 0, 0]
    assert oracles.failure_probability(coin(), [0, 0, 0, 0]) == [1, 1, 0, 1]
    assert oracles.least_failure_probability(coin()) == [0, 1, 0, 1]
    assert oracles.survival_times(coin()) == [None, None, None, 0]


def test_failure_probability_is_the_least_solution() -> None:
    """On a state that stays put every number solves x = x; the probability is 0."""
    model = SafeMDP.deterministic(np.array([[0], [1]]), np.arange(2) == 1)
    assert oracles.failure_probability(model, [0, 0]) == [0, 1]


def test_state_at_risk() -> None:
    P = np.full((3, 1, 3), F(0), dtype=object)
    P[0, 0] = [0, F(1, 4), F(3, 4)]
    P[1, 0, 1] = P[2, 0, 2] = F(1)
    model = SafeMDP.stochastic(P, np.arange(3) == 2)
    assert oracles.labels(model) == [oracles.AT_RISK, oracles.SAFE, oracles.FAIL]
    assert oracles.least_failure_probability(model)[0] == F(3, 4)


def test_critics_from_values() -> None:
    gamma = F(1, 2)
    values = [F(0), gamma, F(1), F(0), F(0)]
    assert oracles.loss_target(corridor(), values, gamma)[:3] == [
        [0, gamma**2],
        [gamma, gamma],
        [1, 1],
    ]
    assert oracles.expectation(corridor(), values)[2] == [0, 0]
    assert oracles.loss_target(corridor(), values, gamma)[3] == [np.inf, np.inf]


@pytest.mark.parametrize("p", [F(1, 2), F(1, 10)])
def test_greatest_expected_time_of_a_coin(p: Fraction) -> None:
    assert oracles.greatest_expected_time(coin(p)) == [None, 1 / p, None, 0]


def test_steps_to_fail_ends_at_a_repetition() -> None:
    assert oracles.steps_to_fail([1, 2, 2], {2}, 0) == 2
    assert oracles.steps_to_fail([1, 0, 2], {2}, 0) is None


def test_stays_inside_follows_every_executed_action() -> None:
    safe = {0, 4}
    assert oracles.stays_inside(corridor(), [[0], [0], [0], [], [0]], safe)
    assert not oracles.stays_inside(corridor(), [[0, 1], [0], [0], [], [0]], safe)


def test_survival_probability_against_all_time_dependent_choices() -> None:
    """Two states at risk that feed each other; the worst choice changes with the steps left."""
    P = np.full((4, 2, 4), F(0), dtype=object)
    P[0, 0] = [0, F(1), 0, 0]
    P[0, 1] = [F(1, 2), 0, F(1, 4), F(1, 4)]
    P[1, 0] = [0, 0, F(1, 3), F(2, 3)]
    P[1, 1] = [F(2, 3), 0, 0, F(1, 3)]
    P[2, :, 2] = P[3, :, 3] = F(1)
    model = SafeMDP.stochastic(P, np.arange(4) == 3)
    steps, worst = 3, F(1)
    choices = list(oracles.policies(model))
    for plan in product(choices, repeat=steps):
        alive = {0: F(1)}
        for policy in plan:
            after: dict[int, Fraction] = {}
            for state, mass in alive.items():
                for successor, p in oracles.chain(model, policy)[state].items():
                    if not model.fail[successor]:
                        after[successor] = after.get(successor, F(0)) + mass * p
            alive = after
        worst = min(worst, sum(alive.values(), F(0)))
    executed = [[0, 1]] * 4
    assert oracles.survival_probability(model, executed, steps)[0] == worst
    assert 0 < worst < F(1, 2)


def test_expectile_condition() -> None:
    """tau (1 - m) w = (1 - tau) m (1 - w) for outcomes 1 and 0."""
    tau, w = F(3, 10), F(1, 2)
    m = tau * w / (tau * w + (1 - tau) * (1 - w))
    assert oracles.is_expectile([F(1), F(0)], [w, 1 - w], tau, m)
    assert not oracles.is_expectile([F(1), F(0)], [w, 1 - w], tau, m + F(1, 1000))
    assert oracles.is_expectile([F(1), F(0), F(9)], [w, 1 - w, F(0)], tau, m)
