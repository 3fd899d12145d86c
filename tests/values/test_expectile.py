"""The expectile critic: its defining equation, its bounds, its ends, and the brake lattice."""

import inspect
import itertools
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy import sparse

from dead_ends.envs.brake import BrakeLattice, brake, uniform_driver
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.policies import greedy_actions
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.expectile import Expectile, expectile_iteration
from dead_ends.values.fixed_point.rounding import RoundedKernel
from proofs_check.machinery.random_models import (
    random_deterministic,
    random_policy,
    random_stochastic,
    rounded,
)

EXPECTILES = (Fraction(0), Fraction(1, 10), Fraction(3, 10), Fraction(1, 2), Fraction(9, 10))
GAMMAS = (Fraction(7, 10), Fraction(99, 100), Fraction(1))


# The operator: outward for every expectile that rounds to the one given, and no wider


def operator(data: list[float], expectile: float) -> Expectile:
    """One unknown state, the last, whose action a leads to state a."""
    count = len(data)
    nowhere = np.zeros(count + 1, dtype=np.bool_)
    kernel = sparse.csr_array(np.eye(count, count + 1))
    return Expectile(
        kernel=RoundedKernel.build(kernel, nowhere, nowhere),
        data=np.array([data]),
        expectile=expectile,
        unknown=np.array([count]),
        weights=np.zeros(count + 1),
        gamma=0.5,
    )


def with_q(op: Expectile, q: list[float]) -> Expectile:
    return replace(op, weights=np.array([*q, 0.0]))


def by_definition(data: list[float], q: list[float], tau: Fraction) -> Fraction:
    """The root of sum_a data(a) (tau or 1 - tau) (q(a) - V), in each interval between the q."""
    pairs = [(Fraction(d), Fraction(x)) for d, x in zip(data, q, strict=True) if d > 0]
    for k in range(len(pairs) + 1):
        ordered = sorted(pairs, key=lambda pair: pair[1])
        m = [d * (1 - tau if i < k else tau) for i, (d, _) in enumerate(ordered)]
        V = sum((w * x for w, (_, x) in zip(m, ordered, strict=True)), Fraction(0)) / sum(m)
        if all(x <= V for _, x in ordered[:k]) and all(x >= V for _, x in ordered[k:]):
            return V
    raise AssertionError


NEAR_ONE = 1 - 2.0**-40


@pytest.mark.parametrize("tau", [1e-12, 0.1, 0.3, 0.5, 0.7, 0.999, NEAR_ONE])
def test_the_operator_encloses_every_expectile_that_rounds_to_it(tau: float) -> None:
    rng = np.random.default_rng(6)
    half = Fraction(math.ulp(tau)) / 2
    for count in (1, 2, 3, 5):
        for _ in range(20):
            data = rng.dirichlet(np.ones(count)) * (rng.random(count) < 0.8)
            data[0] += 1e-3
            q = rng.random(count).tolist()
            op = with_q(operator(data.tolist(), tau), q)
            low, value, high = (
                Fraction(float(f(np.zeros(1))[0])) for f in (op.lower, op.value, op.upper)
            )
            for near in (Fraction(tau) - half, Fraction(tau), Fraction(tau) + half):
                assert low <= by_definition(data.tolist(), q, near) <= high
            assert low <= value <= high
            assert high - low <= value * Fraction(4 * op._operations + 24) / 2**53


@pytest.mark.parametrize("tau", [0.75, 0.999, NEAR_ONE])
def test_near_one_what_rounds_to_the_expectile_moves_the_value(tau: float) -> None:
    """Rare bad data: V hangs on (1 - tau) / data(bad), and 1 - tau has lost its last digits."""
    rare = 1 - tau
    data, q = [1 - rare, rare], [0.0, 1.0]
    op = with_q(operator(data, tau), q)
    low, high = (Fraction(float(f(np.zeros(1))[0])) for f in (op.lower, op.upper))
    half = Fraction(math.ulp(tau)) / 2
    ends = [by_definition(data, q, Fraction(tau) + side * half) for side in (-1, 1)]
    assert low <= ends[0] < ends[1] <= high
    if tau == NEAR_ONE:  # it is this that makes the bounds so wide
        assert (high - low) / 128 < ends[1] - ends[0]


def test_the_operations_that_are_counted() -> None:
    """Two sums of A terms and 8 more, each twice; and tau / (1 - tau)."""
    assert operator([0.5, 0.25, 0.25], 0.5)._operations == 2 * (3 + 8 + 1)
    assert operator([0.5, 0.5], 0.75)._operations == 2 * (2 + 8 + 3)
    assert operator([1.0], NEAR_ONE)._operations == pytest.approx(2 * 2**40)


@pytest.mark.parametrize("tau", [0.1, 0.5, 0.9])
def test_the_linear_part_is_the_operator_where_it_was_taken(tau: float) -> None:
    """Three unknown states, two known ones; and a piece that no other piece crosses."""
    rng = np.random.default_rng(7)
    unknown, weights = np.array([0, 2, 3]), np.array([0, 0.25, 0, 0, 1])
    nowhere = np.zeros(5, dtype=np.bool_)
    for _ in range(20):
        rows = sparse.csr_array(rng.dirichlet(np.ones(5), size=9))
        data = rng.dirichlet(np.ones(3), size=3)
        data[0, 1] = 0.0
        op = Expectile(
            RoundedKernel.build(rows, nowhere, nowhere), data, tau, unknown, weights, 0.9
        )
        x, other = rng.random(3), rng.random(3)
        matrix, constant = op.linear(x)
        np.testing.assert_allclose(matrix @ x + constant, op.value(x), rtol=1e-12)
        least = tau <= 0.5
        side = (matrix @ other + constant - op.value(other)) * (1 if least else -1)
        assert (side >= -1e-12).all()
        q = (rows @ np.where(np.isin(np.arange(5), unknown), 0, weights)).reshape(3, 3)
        q += 0.9 * (rows[:, unknown] @ x).reshape(3, 3)
        for s in range(3):
            truth = by_definition(data[s].tolist(), q[s].tolist(), Fraction(str(tau)))
            assert op.value(x)[s] == pytest.approx(float(truth), rel=1e-12)


@pytest.mark.parametrize("tau", [Fraction(1, 10**6), 1 - Fraction(1, 10**6)])
def test_bounds_enclose_the_exact_answer_at_extreme_expectiles(tau: Fraction) -> None:
    rng = np.random.default_rng(8)
    for _ in range(10):
        model = random_stochastic(rng)
        data = random_policy(rng, model)
        exact = expectile_iteration(model, data, tau, Fraction(9, 10))
        floats = expectile_iteration(
            rounded(model), data.astype(float), float(tau), 0.9, tolerance=1e-7
        )
        for low, x, high in zip(floats.V_lower, exact.V, floats.V_upper, strict=True):
            assert Fraction(float(low)) <= x <= Fraction(float(high))
            assert high - low <= 1e-7


def test_zero_follows_the_data_not_all_actions() -> None:
    """Two ways: only the worse has data. And a goal, where the data may say anything."""
    P = np.zeros((4, 2, 4), dtype=object)
    P[0, 0] = [Fraction(0), Fraction(1, 2), Fraction(1, 2), Fraction(0)]
    P[0, 1, 1] = P[1, :, 1] = P[2, :, 2] = P[3, :, 3] = Fraction(1)
    fail, goal = np.arange(4) == 2, np.arange(4) == 1
    model = SafeMDP.stochastic(P, fail, terminal=goal)
    data = np.eye(2)[[0, 0, 0, 0]] * 1.0
    data[3] = 0.5
    for gamma, kind in ((0.5, model), (Fraction(1, 2), model), (0.5, rounded(model))):
        V, Q = expectile_iteration(kind, data, 0, gamma)
        assert list(V) == [Fraction(1, 2), 0, 0, 0]
        assert Q[0].tolist() == [Fraction(1, 2), 0]
        assert Q[1].tolist() == [0, 0]


@pytest.mark.parametrize("tau", [0, 0.3, 0.5])
def test_the_caller_says_how_closely_and_for_how_long(tau: float) -> None:
    P = np.zeros((2, 2, 2))
    P[0, 0], P[0, 1] = (0.7, 0.3), (0.6, 0.4)
    model = SafeMDP.stochastic(P, np.array([False, True]))
    half = np.full((2, 2), 0.5)
    with pytest.raises(ValueError, match=r"^after 3 sweeps the value of state 0 "):
        expectile_iteration(model, half, tau, 0.9, tolerance=1e-30, max_iterations=3)
    options = [inspect.signature(f).parameters for f in (expectile_iteration, value_iteration)]
    for name in ("gamma_safe", "exact", "tolerance", "max_iterations"):
        assert options[0][name].default == options[1][name].default


# The critic


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
