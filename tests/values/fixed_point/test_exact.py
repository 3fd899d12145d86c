"""Policy iteration in Fractions against the oracles, which share no code with it."""

from fractions import Fraction

import numpy as np
import pytest

from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.bellman import best_action, evaluate_policy, value_iteration
from dead_ends.values.fixed_point.exact import ExactProblem, exact_rows
from proofs_check.machinery import oracles
from proofs_check.machinery.random_models import random_policy, random_stochastic

GAMMAS = (Fraction(7, 10), Fraction(9999, 10_000))


@pytest.mark.parametrize("gamma", GAMMAS)
def test_values_are_the_oracles(gamma: Fraction) -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        model = random_stochastic(rng, max_states=4, max_actions=2)
        assert list(value_iteration(model, gamma).V) == oracles.optimal_entry_cost(model, gamma)
        policy = random_policy(rng, model)
        values = evaluate_policy(model, policy, gamma)
        assert list(values.V) == oracles.entry_cost(model, policy, gamma)


def test_undiscounted_values_are_the_oracles() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        model = random_stochastic(rng, max_states=4, max_actions=2)
        truth = oracles.least_failure_probability(model)
        V = value_iteration(model, Fraction(1), value="cost-fail-1").V
        assert list(V) == truth
        policy = random_policy(rng, model)
        V = evaluate_policy(model, policy, Fraction(1), value="cost-fail-1").V
        assert list(V) == oracles.failure_probability(model, policy)


def test_one_round_if_the_floats_chose_well() -> None:
    """A ring of 200 states that leaks to fail and to the goal."""
    n = 200
    P = np.full((n, 1, n), Fraction(0), dtype=object)
    for s in range(2, n):
        P[s, 0, 2 + (s - 1) % (n - 2)] = Fraction(98, 100)
        P[s, 0, s % 2] = Fraction(2, 100)
    states = np.arange(n)
    model = SafeMDP.stochastic(P, states == 0, terminal=states == 1)
    values = value_iteration(model, Fraction(1))
    assert values.iterations == 1
    keep = Fraction(98, 100)
    failing = Fraction(2, 100) / (1 - keep**2)  # every second state on the ring leaks to fail
    assert list(values.V[2::2]) == [failing] * 99
    assert list(values.V[3::2]) == [keep * failing] * 99


def test_bad_first_policy_is_improved() -> None:
    """Fail is farther away than the float sweeps see, so that all actions look alike."""
    far = 120
    P = np.full((far + 1, 2, far + 1), Fraction(0), dtype=object)
    for s in range(far):
        P[s, :, s + 1] = Fraction(1)
    P[0, 1, 0] = P[0, 1, 1] = Fraction(1, 2)
    gamma = Fraction(9, 10)
    values = value_iteration(SafeMDP.stochastic(P, np.arange(far + 1) == far), gamma)
    assert values.V[1] == gamma ** (far - 2)
    assert values.V[0] == gamma ** (far - 2) * (gamma / 2) / (1 - gamma / 2)
    assert values.iterations == 2


def test_rows_are_those_of_available_actions() -> None:
    P = np.zeros((3, 2, 3))
    P[0, 0] = [0.1, 0.2, 0.7]
    P[1] = 7  # terminal: not read
    model = SafeMDP.stochastic(
        P,
        np.array([False, False, True]),
        np.array([[True, False], [True, True], [False, False]]),
        terminal=np.array([False, True, False]),
    )
    tenths = [(t, Fraction(k, 10)) for t, k in enumerate((1, 2, 7))]
    loop = [(1, Fraction(1))]
    assert exact_rows(model) == [{0: tenths}, {0: loop, 1: loop}, {}]


def test_problem_without_unknowns() -> None:
    model = SafeMDP.stochastic(np.ones((1, 1, 1)), np.array([False]))
    known = {0: Fraction(0)}
    problem = ExactProblem(exact_rows(model), known, Fraction(1, 2), best_action)
    assert problem.solve() == ({}, 1)
