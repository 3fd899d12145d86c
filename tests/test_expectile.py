"""The expectile critic: its defining equation, its bounds, its ends, and the brake lattice."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

from dead_ends.bellman import evaluate_policy, value_iteration
from dead_ends.envs.brake import BrakeLattice, brake, uniform_driver
from dead_ends.expectile import expectile_iteration
from dead_ends.labels import classify, safe_actions
from dead_ends.model import SafeMDP
from dead_ends.policies import greedy_actions
from proofs_check.random_models import (
    random_deterministic,
    random_policy,
    random_stochastic,
    rounded,
)

EXPECTILES = (Fraction(0), Fraction(1, 10), Fraction(3, 10), Fraction(1, 2), Fraction(9, 10))
GAMMAS = (Fraction(7, 10), Fraction(99, 100), Fraction(1))


@pytest.mark.parametrize("expectile", EXPECTILES)
def test_exact_values_solve_both_losses(expectile: Fraction) -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        model = random_stochastic(rng) if rng.random() < 0.7 else random_deterministic(rng)
        data = random_policy(rng, model)
        gamma = GAMMAS[int(rng.integers(3))]
        V, Q = expectile_iteration(model, data, expectile, gamma)
        kernel, probabilities = model.transitions(), model.exact_probabilities()
        for s, a in np.argwhere(model.available):
            places = range(*kernel.indptr[s * model.num_actions + a :][:2])
            weights = [1 if model.fail[t] else gamma * V[t] for t in kernel.indices]
            q = sum((probabilities[i] * weights[i] for i in places), Fraction(0))
            assert Q[s, a] == q
        for s in np.flatnonzero(~(model.fail | model.terminal)):
            taken = [a for a in range(model.num_actions) if data[s, a] > 0]
            if expectile == 0:
                assert V[s] == min(Q[s, a] for a in taken)
            else:
                tilt = sum(
                    data[s, a] * (expectile if Q[s, a] > V[s] else 1 - expectile) * (Q[s, a] - V[s])
                    for a in taken
                )
                assert tilt == 0


@pytest.mark.parametrize("expectile", EXPECTILES)
def test_bounds_enclose_the_exact_answer(expectile: Fraction) -> None:
    rng = np.random.default_rng(2)
    for _ in range(15):
        model = random_stochastic(rng)
        data = random_policy(rng, model)
        for gamma in GAMMAS:
            exact = expectile_iteration(model, data, expectile, gamma)
            floats = expectile_iteration(
                rounded(model), data.astype(float), float(expectile), float(gamma)
            )
            available = model.available
            assert (floats.V_upper - floats.V_lower <= 1e-9).all()
            for lower, truth, upper in (
                (floats.V_lower, exact.V, floats.V_upper),
                (floats.Q_lower[available], exact.Q[available], floats.Q_upper[available]),
            ):
                for low, x, high in zip(lower.ravel(), truth.ravel(), upper.ravel(), strict=True):
                    assert Fraction(float(low)) <= x <= Fraction(float(high))


def test_between_the_best_and_the_data_policy() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        model = random_stochastic(rng)
        data = random_policy(rng, model)
        gamma = Fraction(9, 10)
        tables = [value_iteration(model, gamma).Q[model.available]] + [
            expectile_iteration(model, data, tau, gamma).Q[model.available] for tau in EXPECTILES
        ]
        for lower, higher in itertools.pairwise(tables):
            assert (lower <= higher).all()
        mean = evaluate_policy(model, data, gamma).Q[model.available]
        np.testing.assert_array_equal(tables[1 + EXPECTILES.index(Fraction(1, 2))], mean)


def test_zero_on_full_support_is_the_best_critic() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        for model in (random_deterministic(rng), rounded(random_stochastic(rng))):
            count = np.maximum(model.available.sum(axis=1, keepdims=True), 1)
            data = model.available / count
            best, trained = value_iteration(model, 0.99), expectile_iteration(model, data, 0, 0.99)
            if model.is_deterministic:  # the same powers of gamma, without rounding
                np.testing.assert_array_equal(trained.Q, best.Q)
            else:
                np.testing.assert_allclose(trained.Q, best.Q, atol=1e-12)


def test_two_actions_half_bad_give_one_minus_expectile_less() -> None:
    """V = tau where half the data has Q = 1 and half Q = 0 (and staying is worth nothing)."""
    P = np.zeros((3, 2, 3))
    P[0, 0, 1] = P[0, 1, 2] = P[1, :, 1] = 1
    model = SafeMDP.stochastic(P, np.array([False, False, True]))
    half = np.full((3, 2), 0.5)
    for tau in (0.1, 0.3, 0.7, 0.999):
        values = expectile_iteration(model, half, tau)
        assert values.V[0] == pytest.approx(tau, abs=1e-12)
        assert values.V_upper[0] - values.V_lower[0] < 1e-11


def test_brake_lattice_blocks_most_of_what_is_safe() -> None:
    """What the paper trains blocks every safe action at its own epsilon = 0.3."""
    lattice = BrakeLattice(max_distance=60, max_speed=8, max_braking=2, max_acceleration=2)
    model = brake(lattice)
    labelling = classify(model)
    assert labelling.horizon == 3
    safe = safe_actions(model, labelling)
    shares = {}
    for tau in (0.3, 0.1):
        Q = expectile_iteration(model, uniform_driver(lattice), tau).Q[safe]
        for epsilon in (0.3, 0.99**3):
            shares[tau, epsilon] = round(100 * float(np.mean(epsilon <= Q)), 1)
    assert shares == {(0.3, 0.3): 100, (0.3, 0.99**3): 2.9, (0.1, 0.3): 46.3, (0.1, 0.99**3): 0}


@pytest.mark.parametrize(("share", "lured"), [(0.72, True), (0.68, False)])
def test_greedy_recovery_may_enter_a_dead_end(share: float, lured: bool) -> None:
    """P: (d2, q), q: (fail, q), d2 -> d1 -> fail; too much of q's data is on "fail"."""
    P, q, d2, d1, fail = range(5)
    table = np.array([[d2, q], [fail, q], [d1, d1], [fail, fail], [fail, fail]])
    model = SafeMDP.deterministic(table, np.arange(5) == fail)
    data = np.full((5, 2), 0.5)
    data[q] = share, 1 - share
    greedy = greedy_actions(expectile_iteration(model, data, 0.3).Q)
    np.testing.assert_array_equal(greedy[P], [lured, not lured])


@pytest.mark.parametrize("expectile", [-0.1, 1, 1.5, float("nan")])
def test_expectile_must_lie_in_the_unit_interval(expectile: float) -> None:
    model = SafeMDP.deterministic(np.array([[0, 1], [1, 1]]), np.array([False, True]))
    with pytest.raises(ValueError, match=r"expectile must lie in \[0, 1\), not "):
        expectile_iteration(model, np.full((2, 2), 0.5), expectile)


def test_data_policy_is_checked() -> None:
    model = SafeMDP.deterministic(np.array([[0, -1], [1, 1]]), np.array([False, True]))
    with pytest.raises(ValueError, match="state 0: action 1 is not available"):
        expectile_iteration(model, np.full((2, 2), 0.5), 0.3)
