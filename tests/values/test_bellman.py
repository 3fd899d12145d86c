"""Values against closed forms, a second solver, brute force and the paper's conventions."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog

from dead_ends.envs.lifegate import DEAD_ENDS, lifegate
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.values import Values
from proofs_check.machinery.random_models import (
    random_deterministic,
    random_policy,
    random_stochastic,
    rounded,
)

CONVENTIONS = list(itertools.product(ValueConvention, CriticConvention))
GAMMAS = (0.7, 0.99, 0.9999, 1.0)


def as_fraction(gamma: float) -> Fraction:
    return Fraction(str(gamma))


def assert_brackets(floats: Values, exact: Values, width: float = 1e-9) -> None:
    assert exact.exact
    assert not floats.exact
    available = floats.model.available
    for lower, truth, upper in (
        (floats.V_lower, exact.V, floats.V_upper),
        (floats.Q_lower[available], exact.Q[available], floats.Q_upper[available]),
    ):
        assert (upper - lower <= width).all()
        for low, x, high in zip(lower.ravel(), truth.ravel(), upper.ravel(), strict=True):
            assert Fraction(float(low)) <= x <= Fraction(float(high))
    assert (floats.V_lower <= floats.V).all()
    assert (floats.V <= floats.V_upper).all()
    assert (floats.Q_lower <= floats.Q).all()
    assert (floats.Q <= floats.Q_upper).all()
    assert (floats.Q[~available] == np.inf).all()
    assert all(q == math.inf for q in exact.Q[~available])


# Closed forms


def corridor(length: int) -> SafeMDP:
    """State 0 fails, state n only steps to n - 1; the last state may also stay."""
    states = np.arange(length + 1)
    stay = np.where(states == length, states, -1)
    return SafeMDP.deterministic(np.stack((np.maximum(states - 1, 0), stay), 1), states == 0)


def gambler(size: int, p: Fraction) -> SafeMDP:
    """Fortune 0 fails, fortune ``size`` is the goal; win with probability p."""
    kernel = np.full((size + 1, 1, size + 1), Fraction(0), dtype=object)
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


def test_users_power_compares_exactly() -> None:
    for gamma in (0.5, 0.7, 0.9, 0.99, 0.9999):
        Q = value_iteration(corridor(80), gamma).Q
        for steps in range(80):
            assert Q[steps + 1, 0] == gamma**steps


def test_no_power_is_rounded_to_zero() -> None:
    values = value_iteration(corridor(2000), 0.5)
    assert (values.V[1:2000] > 0).all()
    assert values.V[2000] == 0
    assert values.Q[2000, 0] > 0
    assert values.V_lower[1999] == 0
    exact = value_iteration(corridor(2000), Fraction(1, 2))
    assert exact.V[1999] == Fraction(1, 2**1998)
    assert_brackets(values, exact)


def test_deterministic_bounds_enclose_the_shortest_decimal() -> None:
    rng = np.random.default_rng(5)
    for gamma in (0.5, 0.7, 0.99, 0.9999, 1.0, 1e-3, math.nextafter(1, 0)):
        model = corridor(300)
        assert_brackets(value_iteration(model, gamma), value_iteration(model, gamma, exact=True))
        policy = rng.integers(0, 1, 301)
        floats = evaluate_policy(model, policy, gamma)
        assert_brackets(floats, evaluate_policy(model, policy, gamma, exact=True))


@pytest.mark.parametrize("p", [Fraction(2, 5), Fraction(1, 2), Fraction(999, 1000)])
def test_gamblers_ruin(p: Fraction) -> None:
    size, ratio = 12, (1 - p) / p
    ruin = [
        Fraction(size - k, size) if ratio == 1 else (ratio**k - ratio**size) / (1 - ratio**size)
        for k in range(size + 1)
    ]
    model = gambler(size, p)
    exact = evaluate_policy(model, np.zeros(size + 1, dtype=int), Fraction(1))
    assert list(exact.V[1:]) == ruin[1:]
    floats = value_iteration(rounded(model), 1.0)
    assert_brackets(floats, exact, width=1e-12)


@pytest.mark.parametrize("gamma", [0.99, 0.5])
def test_lifegate_columns(gamma: float) -> None:
    model = lifegate()
    g, push = as_fraction(gamma), Fraction(7, 10)
    exact = value_iteration(model, g)
    floats = value_iteration(model, gamma)
    assert model.state_names is not None
    for x, y in DEAD_ENDS:
        state = model.state_names.index(f"x {x}, y {y}")
        closed = (push * g / (1 - (1 - push) * g)) ** (9 - x) / g
        assert exact.V[state] == closed
        assert abs(floats.V[state] - float(closed)) < 1e-14
    assert_brackets(floats, exact)


# A second solver


def linear_program(model: SafeMDP, gamma: float) -> np.ndarray:
    """V* as the greatest V with V(s) <= q(s, a) for all a, for gamma < 1."""
    kernel = model.transitions().toarray()
    n, m = model.available.shape
    inside = ~model.fail
    rows, right = [], []
    for s, a in np.argwhere(model.available):
        row = np.zeros(n)
        row[s] += 1
        row -= gamma * kernel[s * m + a] * inside
        rows.append(row)
        right.append(kernel[s * m + a] @ model.fail)
    bounds = [(0, 0) if f else (0, 1) for f in model.fail]
    solution = linprog(-np.ones(n), A_ub=np.array(rows), b_ub=right, bounds=bounds)
    assert solution.success
    return np.asarray(solution.x)


@pytest.mark.parametrize("gamma", [0.5, 0.9, 0.99])
def test_values_solve_the_linear_program(gamma: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(25):
        model = rounded(random_stochastic(rng, max_states=10))
        V = value_iteration(model, gamma).V
        np.testing.assert_allclose(V, linear_program(model, gamma), atol=1e-6)


def test_policy_values_solve_the_dense_system() -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        model = rounded(random_stochastic(rng, max_states=10))
        policy = random_policy(rng, model).astype(float)
        values = evaluate_policy(model, policy, 0.95)
        kernel = model.transitions().toarray().reshape(*policy.shape, -1)
        chain = np.einsum("sa,sat->st", np.where(model.available, policy, 0.0), kernel)
        alive = ~(model.fail | model.terminal)
        system = np.eye(len(chain)) - 0.95 * chain * alive * alive[:, None]
        V = np.linalg.solve(system, np.where(alive, chain @ model.fail, 0.0))
        np.testing.assert_allclose(values.V, V, atol=1e-12)


def test_deterministic_models_agree_with_their_kernels() -> None:
    rng = np.random.default_rng(4)
    for _ in range(60):
        model = random_deterministic(rng)
        kernel = SafeMDP.stochastic(model.transitions(), model.fail, model.available)
        policy = random_policy(rng, model)
        actions = np.asarray(policy > 0).argmax(axis=1)
        for gamma in (0.7, 1.0):
            g = as_fraction(gamma)
            for of_table, of_kernel in (
                (value_iteration(model, gamma), value_iteration(kernel, g)),
                (evaluate_policy(model, actions, gamma), evaluate_policy(kernel, actions, g)),
                (evaluate_policy(model, policy, gamma), evaluate_policy(kernel, policy, g)),
            ):
                assert_brackets(of_table, of_kernel)


# Brute force


@pytest.mark.parametrize("gamma", [Fraction(7, 10), Fraction(1)])
def test_best_value_is_the_least_over_all_deterministic_policies(gamma: Fraction) -> None:
    rng = np.random.default_rng(6)
    for _ in range(25):
        model = random_stochastic(rng, max_states=4)
        choices = [np.flatnonzero(row) if row.any() else [0] for row in model.available]
        tables = [
            evaluate_policy(model, np.array(policy), gamma).V
            for policy in itertools.product(*choices)
        ]
        assert list(value_iteration(model, gamma).V) == list(np.min(tables, axis=0))


@pytest.mark.parametrize("gamma", GAMMAS)
def test_bounds_enclose_the_exact_answer(gamma: float) -> None:
    rng = np.random.default_rng(int(1000 * gamma))
    for _ in range(60):
        model = random_stochastic(rng)
        exact = value_iteration(model, as_fraction(gamma))
        assert_brackets(value_iteration(rounded(model), gamma), exact)
        policy = random_policy(rng, model)
        floats = evaluate_policy(rounded(model), policy.astype(float), gamma)
        assert_brackets(floats, evaluate_policy(model, policy, as_fraction(gamma)))


def test_rounding_of_mixed_rows_is_enclosed() -> None:
    """A policy's row is a sum over many actions, each with its own rounding errors."""
    rng = np.random.default_rng(10)
    count = 60
    for _ in range(20):
        parts = rng.integers(1, 10**12, count)
        policy = np.full((3, count), Fraction(0), dtype=object)
        policy[0] = [Fraction(int(part), int(parts.sum())) for part in parts]
        P = np.full((3, count, 3), Fraction(0), dtype=object)
        for action in range(count):
            p = Fraction(int(rng.integers(1, 10**12)), 10**12)
            P[0, action, 1], P[0, action, 2] = 1 - p, p
        states = np.arange(3)
        model = SafeMDP.stochastic(P, states == 2, terminal=states == 1)
        floats = evaluate_policy(rounded(model), policy.astype(float), 0.9)
        assert_brackets(floats, evaluate_policy(model, policy, Fraction(9, 10)), width=1e-13)


# Conventions


@pytest.mark.parametrize(("value", "critic"), CONVENTIONS)
def test_conventions_are_the_papers_formulas(
    value: ValueConvention, critic: CriticConvention
) -> None:
    rng = np.random.default_rng(8)
    gamma = Fraction(9, 10)
    for model in [random_stochastic(rng) for _ in range(12)] + [
        random_deterministic(rng) for _ in range(12)
    ]:
        base = value_iteration(model, gamma)
        given = value_iteration(model, gamma, value=value, critic=critic)
        V = base.V.copy()
        if value is ValueConvention.TIME:
            V = gamma * V
        V[model.fail] = Fraction(0 if value is ValueConvention.COST_FAIL_0 else 1)
        assert list(given.V) == list(V)
        kernel = model.transitions()
        probabilities = model.exact_probabilities()
        for s, a in np.argwhere(model.available):
            row = range(*kernel.indptr[s * model.num_actions + a :][:2])
            q = Fraction(0)
            for place in row:
                t = kernel.indices[place]
                cost = int(model.fail[t])
                if critic is CriticConvention.NEXT_VALUE:
                    q += probabilities[place] * V[t]
                elif critic is CriticConvention.DISCOUNTED_NEXT_VALUE:
                    q += probabilities[place] * gamma * V[t]
                else:
                    q += probabilities[place] * (cost + (1 - cost) * gamma * V[t])
            assert given.Q[s, a] == q
        floats = value_iteration(model, 0.9, value=value.value, critic=critic.value)
        assert_brackets(floats, given)


# What is exact, and the least fixed point


def test_value_zero_and_one_are_exact() -> None:
    rng = np.random.default_rng(9)
    certain = 0
    for _ in range(100):
        model = random_stochastic(rng)
        exact, floats = value_iteration(model, Fraction(1)), value_iteration(rounded(model), 1.0)
        for truth, lower, upper in (
            (exact.V, floats.V_lower, floats.V_upper),
            (exact.Q, floats.Q_lower, floats.Q_upper),
        ):
            for x, low, high in zip(truth.ravel(), lower.ravel(), upper.ravel(), strict=True):
                if x in (0, 1):
                    certain += 1
                    assert low == high == x
    assert certain > 300


def test_undiscounted_values_are_the_least_fixed_point() -> None:
    """Naive policy iteration from "fail" would stall: staying is worth 1 under it too."""
    P = np.zeros((2, 2, 2))
    P[0, 0, 0] = P[0, 1, 1] = 1
    for model in (
        SafeMDP.stochastic(P, np.array([False, True])),
        SafeMDP.deterministic(np.array([[0, 1], [0, 0]]), np.array([False, True])),
    ):
        for gamma in (1.0, Fraction(1)):
            assert value_iteration(model, gamma).V[0] == 0
            assert evaluate_policy(model, [0, 0], gamma).V[0] == 0
            assert evaluate_policy(model, [1, 0], gamma).V[0] == 1
            assert evaluate_policy(model, [1, 0], gamma).Q[0, 0] == 1


def test_exact_reads_floats_as_shortest_decimals() -> None:
    P = np.zeros((2, 1, 2))
    P[0, 0] = 0.9, 0.1
    model = SafeMDP.stochastic(P, np.array([False, True]))
    assert value_iteration(model, 0.9, exact=True).V[0] == Fraction(10, 19)
    assert value_iteration(model, Fraction(9, 10), exact=False).V.dtype == np.float64


def test_values_unpack_and_are_read_only() -> None:
    values = value_iteration(corridor(3))
    V, Q = values
    assert V is values.V
    assert Q is values.Q
    for array in (V, Q, values.V_lower, values.V_upper, values.Q_lower, values.Q_upper):
        assert not array.flags.writeable


def test_terminal_states_have_value_zero_and_every_action() -> None:
    P = np.zeros((2, 2, 2))
    P[:, :, 1] = 1
    model = SafeMDP.stochastic(P, np.array([False, False]), terminal=np.array([False, True]))
    for gamma in (0.9, 1.0, Fraction(1, 2)):
        V, Q = value_iteration(model, gamma)
        assert (V == 0).all()
        assert (Q == 0).all()


def test_rows_that_sum_to_slightly_more_than_one_stay_below_one() -> None:
    P = np.zeros((3, 1, 3))
    P[0, 0] = [0.5, 0.25, 0.25 + 5e-10]
    P[1, 0] = [0.5, 0.25, 0.25 + 5e-10]
    model = SafeMDP.stochastic(P, np.array([False, False, True]))
    for gamma in (0.999999, 1.0):
        values = value_iteration(model, gamma)
        assert (values.V_upper <= 1).all()
        assert (values.Q_upper[:2] <= 1).all()
        assert (values.V_lower <= values.V_upper).all()


# Errors


@pytest.mark.parametrize("gamma", [0, -0.5, 1.5, float("nan"), Fraction(3, 2)])
def test_discount_must_lie_in_the_unit_interval(gamma: float) -> None:
    with pytest.raises(ValueError, match=r"gamma_safe must lie in \(0, 1\], not "):
        value_iteration(corridor(3), gamma)


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="tolerance must be positive, not 0"):
        value_iteration(corridor(3), tolerance=0)
    with pytest.raises(ValueError, match="max_iterations must be at least 1, not 0"):
        value_iteration(corridor(3), max_iterations=0)
    with pytest.raises(ValueError, match="'loss' is not a valid CriticConvention"):
        value_iteration(corridor(3), critic="loss")


def test_unreached_tolerance_is_an_error_with_advice() -> None:
    model = rounded(gambler(12, Fraction(1, 2)))
    with pytest.raises(ValueError, match=r"state \d+ is only known to lie in .*exact=True"):
        value_iteration(model, 1.0, tolerance=1e-17, max_iterations=5)


def test_exact_rows_must_sum_to_exactly_one() -> None:
    P = np.zeros((2, 1, 2))
    P[0, 0] = [0.3333333333, 0.6666666666]
    model = SafeMDP.stochastic(P, np.array([False, True]))
    value_iteration(model, 0.9)
    with pytest.raises(ValueError, match="state 0, action 0: probabilities sum to .*exactly 1"):
        value_iteration(model, 0.9, exact=True)


def test_policies_are_checked() -> None:
    model = corridor(3)
    with pytest.raises(ValueError, match="state 1: action 1 is not available"):
        evaluate_policy(model, [0, 1, 0, 0])
    with pytest.raises(ValueError, match=r"state 2: there is no action 7 \(0 to 1\)"):
        evaluate_policy(model, [0, 0, 7, 0])
    rows = np.tile([1.0, 0.0], (4, 1))
    for entry, message in (
        ([0.5, 0.25], "state 3: probabilities sum to 0.75, not 1"),
        ([1.5, -0.5], "state 3, action 1: probability -0.5"),
        ([np.nan, 1], "state 3, action 0: probability nan"),
    ):
        rows[3] = entry
        with pytest.raises(ValueError, match=message):
            evaluate_policy(model, rows)
    rows[3] = [1, 0]
    rows[1] = [0.5, 0.5]
    with pytest.raises(ValueError, match="state 1: action 1 is not available"):
        evaluate_policy(model, rows)
    exact = np.full((4, 2), Fraction(1, 3), dtype=object)
    exact[1:3] = [Fraction(1), Fraction(0)]
    with pytest.raises(ValueError, match="state 3: probabilities sum to 2/3, not exactly 1"):
        evaluate_policy(model, exact)
    exact[3, 1] = "half"
    with pytest.raises(ValueError, match="state 3, action 1: 'half' is not a probability"):
        evaluate_policy(model, exact)
    with pytest.raises(
        ValueError, match=r"^policy must be integers \(4,\) or probabilities \(4, 2\)"
    ):
        evaluate_policy(model, [0.5, 0.5, 0.5, 0.5])


def test_rows_of_ended_states_are_not_checked() -> None:
    model = corridor(3)
    assert evaluate_policy(model, [9, 0, 0, 1]).V[3] == 0
