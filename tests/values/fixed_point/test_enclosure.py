"""Guess and verify where value iteration is hopeless; honest bounds where guesses fail."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from scipy import sparse

from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.bellman import value_iteration
from dead_ends.values.fixed_point import enclosure, linear
from dead_ends.values.fixed_point.enclosure import Enclosure, _sweep, check_width, enclose
from dead_ends.values.fixed_point.linear import LinearSolver
from dead_ends.values.fixed_point.rounding import Csr, Float
from dead_ends.values.precision import UndecidedError

# As close as promised, with operators whose bounds are known


@dataclass(frozen=True)
class Affine:
    """F(x) = M x + c; its roundings are given: error, and more with the distance from ``at``.

    Without guesses its linear systems are singular, so that only sweeps are left.
    """

    matrix: Float
    constant: Float
    error: Float | float = 0.0
    slope: Float | float = 0.0
    at: Float | float = 0.0
    guesses: bool = True

    def value(self, x: Float) -> Float:
        return self.matrix @ x + self.constant

    def lower(self, x: Float) -> Float:
        return self.value(x) - self._rounding(x)

    def upper(self, x: Float) -> Float:
        return self.value(x) + self._rounding(x)

    def linear(self, _x: Float) -> tuple[Csr, Float]:
        matrix = self.matrix if self.guesses else np.eye(len(self.constant))
        return sparse.csr_array(matrix), self.constant

    def _rounding(self, x: Float) -> Float:
        return self.error + self.slope * np.abs(x - self.at).max()


def one(rate: float, constant: float, **more: float) -> Affine:
    """An operator of one number."""
    return Affine(np.array([[rate]]), np.array([constant]), **more)


def enclosed(
    operator: Affine, tolerance: float, max_iterations: int = 10_000, upper: float = 1.0
) -> Enclosure:
    count = len(operator.constant)
    return enclose(operator, np.zeros(count), np.full(count, upper), tolerance, max_iterations)


@pytest.mark.parametrize(("constant", "value"), [(0.0, 0.0), (0.1, 1.0)])
def test_sweeps_go_on_while_one_bound_moves(constant: float, value: float) -> None:
    """F(x) = 0.9 x + c: one bound is right at once, the other is 0.9^n off after n sweeps."""
    bounds = enclosed(one(0.9, constant, guesses=False), 1e-6)
    assert bounds.iterations == 132  # 0.9^131 > 1e-6 >= 0.9^132
    assert bounds.lower == pytest.approx(value - 0.9**132 * (value == 1), rel=1e-9)
    assert bounds.upper == pytest.approx(value + 0.9**132 * (value == 0), rel=1e-9)
    assert bounds.estimate == pytest.approx((bounds.lower + bounds.upper) / 2)


def test_sweeps_end_once_neither_bound_moves() -> None:
    bounds = enclosed(one(1.0, 0.0, guesses=False), 1e-6)
    assert (bounds.lower, bounds.upper, bounds.iterations) == (0.0, 1.0, 21)


@pytest.mark.parametrize("most", [1, 5, 20, 25])
def test_no_more_sweeps_than_allowed(most: int) -> None:
    bounds = enclosed(one(0.9, 0.0, guesses=False), 1e-6, most)
    assert bounds.iterations == most
    assert bounds.upper == pytest.approx(0.9**most, rel=1e-12)


def test_no_more_sweeps_than_needed() -> None:
    """20 to warm up; relative to values above 1: F(x) = 0.9 x + 1 from [0, 20] to 10."""
    assert enclosed(one(0.5, 0.0, guesses=False), 2.0**-20).iterations == 20
    assert enclosed(one(0.5, 0.0, guesses=False), 2.0**-21).iterations == 21
    bounds = enclosed(one(0.9, 1.0, guesses=False), 0.1, upper=20.0)
    widths = [20 * 0.9**n / (10 - 10 * 0.9**n) for n in (bounds.iterations - 1, bounds.iterations)]
    assert widths[0] > 0.1 >= widths[1]


def test_nothing_unknown_needs_no_sweep() -> None:
    bounds = enclosed(Affine(np.zeros((0, 0)), np.zeros(0)), 1e-6)
    assert (len(bounds.estimate), bounds.iterations) == (0, 0)


def test_guesses_are_verified_within_twice_the_rounding_of_each_component() -> None:
    """F = 0.99 x + 0.005 +- e: bounds of F +- 2 e are 1/2 +- 200 e, for each e its own."""
    error = np.array([1e-6, 1e-9])
    operator = Affine(np.diag([0.99, 0.99]), np.full(2, 0.005), error=error)
    bounds = enclosed(operator, 1.0)
    assert bounds.iterations == 20
    assert bounds.upper - 0.5 == pytest.approx(200 * error, rel=1e-3)
    assert 0.5 - bounds.lower == pytest.approx(200 * error, rel=1e-3)
    assert bounds.estimate == pytest.approx(0.5, abs=1e-12)
    # More sweeps would bring them to the bounds' own fixed points, 1/2 +- 100 e.
    closer = enclosed(operator, 1e-12)
    assert closer.upper - 0.5 == pytest.approx(100 * error, rel=1e-3)
    assert 0.5 - closer.lower == pytest.approx(100 * error, rel=1e-3)


@pytest.mark.parametrize(("share", "factor"), [(0.0, 1), (0.9, 8), (0.99, 64), (0.999, None)])
def test_a_guess_that_is_not_verified_is_tried_farther_off(share: float, factor: float) -> None:
    """The roundings grow with the distance; what F - 2 e cannot show F - 16 e may."""
    operator = one(0.99, 0.005, error=1e-9, slope=share * 0.01, at=0.5)
    bounds = enclosed(operator, 1.0)
    if factor is None:
        assert bounds.upper - bounds.lower > 0.5
    else:
        assert bounds.upper - 0.5 == pytest.approx(200e-9 * factor, rel=1e-3)
        assert 0.5 - bounds.lower == pytest.approx(200e-9 * factor, rel=1e-3)


def test_where_its_own_rounding_is_not_enough_the_greatest_is() -> None:
    """x_1 = x_0 / 2 has no rounding at the guess, and some beside it."""
    matrix = np.array([[0.99, 0.0], [0.5, 0.0]])
    operator = Affine(
        matrix,
        np.array([0.005, 0.0]),
        error=np.array([1e-9, 0.0]),
        slope=np.array([0.0, 0.005]),
        at=np.array([0.5, 0.25]),
    )
    bounds = enclosed(operator, 1.0)
    expected = np.array([200e-9, 102e-9])
    assert bounds.upper - [0.5, 0.25] == pytest.approx(expected, rel=1e-3)
    assert [0.5, 0.25] - bounds.lower == pytest.approx(expected, rel=1e-3)


def test_without_roundings_a_value_is_known_to_its_last_bit_or_two_and_zero_is_zero() -> None:
    """F = (x_0 / 2, x_1 / 2 + 1/4): d is eps / 2 at x_1 = 1/2, so that F +- d is 1/2 +- eps."""
    bounds = enclosed(Affine(np.diag([0.5, 0.5]), np.array([0.0, 0.25])), 1e-30, 20)
    assert bounds.upper.tolist() == [0, 0.5 + 2.0**-52]
    assert bounds.lower.tolist() == [0, 0.5 - 2.0**-52]
    assert bounds.estimate.tolist() == [0, 0.5]


@pytest.mark.parametrize("size", [1.0, 1e-20])
def test_policy_iteration_ends_once_nothing_changes(
    size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A linear operator is solved once; the second solve finds no change for its size."""
    solves: list[str] = []

    def counted(name: str) -> Callable[..., Float | None]:
        solve = getattr(LinearSolver, name)

        def counting(*args: object) -> Float | None:
            solves.append(name)
            return solve(*args)

        return counting

    for name in ("quickly", "carefully"):
        monkeypatch.setattr(LinearSolver, name, counted(name))
    enclosed(one(0.9, 0.05 * size), 1e-12)
    assert solves == ["quickly"] * 2 + ["carefully"] * (1 + 2)  # and one for each bound


def test_bounds_never_get_worse_and_never_cross() -> None:
    for rate, constant in ((2.0, 0.0), (0.5, 0.0), (0.5, 1.0)):
        at = np.array([1.0])
        lower, upper = _sweep(one(rate, constant), at, at)
        assert lower == upper == min(1.0, rate + constant)


def test_the_widest_place_is_named_with_its_bounds() -> None:
    def found(lower: list[float], upper: list[float]) -> Enclosure:
        return Enclosure(np.array(lower), np.array(lower), np.array(upper), 7, 0.0)

    bounds = found([0.0, 0.125, 2.0], [0.25, 0.625, 2.75])
    check_width(bounds, 0.5, str)
    message = r"^after 7 sweeps the value of 1 is only known to lie in \[0.125, 0.625\]"
    with pytest.raises(UndecidedError, match=message):
        check_width(bounds, 0.4, str)
    check_width(found([2.0], [3.0]), 0.5, str)
    with pytest.raises(UndecidedError, match=r"the value of 0 is only known to lie in \[2, 3\]"):
        check_width(found([2.0], [3.0]), 0.49, str)
    with pytest.raises(UndecidedError, match="the value of 0 is"):
        check_width(found([0.0], [np.nan]), 0.5, str)
    check_width(found([], []), 0.5, str)


# Where value iteration is hopeless


def walk(size: int, up: float) -> SafeMDP:
    """A random walk between fail (0) and a goal (size - 1)."""
    states = np.arange(size)
    rows = np.repeat(states, 2)
    columns = np.clip(states[:, None] + [-1, 1], 0, size - 1).ravel()
    kernel = sparse.csr_array((np.tile([1 - up, up], size), (rows, columns)), shape=(size, size))
    return SafeMDP.stochastic(kernel, states == 0, terminal=states == size - 1)


def noisy_grid(size: int, noise: float, rng: np.random.Generator) -> SafeMDP:
    """Four moves, each replaced by a random one; rare lava, a goal in the corner."""
    count = size * size
    x, y = np.divmod(np.arange(count), size)
    moves = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
    ends = [np.clip(x + dx, 0, size - 1) * size + np.clip(y + dy, 0, size - 1) for dx, dy in moves]
    rows = np.repeat(np.arange(4 * count), 4)
    columns = np.tile(np.stack(ends, axis=1), (1, 4)).ravel()
    weights = np.tile((np.eye(4) * (1 - noise) + noise / 4).ravel(), count)
    kernel = sparse.coo_array((weights, (rows, columns)), shape=(4 * count, count))
    states = np.arange(count)
    fail = (rng.random(count) < 0.01) & (states < count - 1)
    return SafeMDP.stochastic(kernel.tocsr(), fail, terminal=states == count - 1)


def random_graph(count: int, leak: float, rng: np.random.Generator) -> SafeMDP:
    """Three random successors an action, and a small leak to fail (0) or the goal (1)."""
    rows = np.repeat(np.arange(2 * count), 4)
    columns = rng.integers(2, count, (2 * count, 4))
    columns[:, 3] = rng.integers(0, 2, 2 * count)
    last = leak * rng.random(2 * count)
    weights = np.stack([(1 - last) / 3] * 3 + [last], axis=1)
    kernel = sparse.coo_array((weights.ravel(), (rows, columns.ravel())), shape=(2 * count, count))
    states = np.arange(count)
    return SafeMDP.stochastic(kernel.tocsr(), states == 0, terminal=states == 1)


def check_consistency(model: SafeMDP, gamma: float, width: float) -> None:
    values = value_iteration(model, gamma)
    assert values.iterations < 100
    assert (values.V_upper - values.V_lower).max() <= width
    alive = ~(model.fail | model.terminal)
    np.testing.assert_allclose(values.V[alive], values.Q[alive].min(axis=1), atol=width)


def test_random_walk_of_a_million_steps() -> None:
    """Fair: ruin has probability 1 - k/(n - 1), and takes up to n^2/4 steps."""
    values = value_iteration(walk(2001, 0.5), 1.0, tolerance=1e-8)
    ruin = 1 - np.arange(2001) / 2000
    assert (values.V_lower[1:] <= ruin[1:]).all()
    assert (ruin[1:] <= values.V_upper[1:]).all()
    assert values.iterations == 20


@pytest.mark.parametrize("gamma", [0.99, 0.9999, 1.0])
def test_noisy_grid(gamma: float) -> None:
    check_consistency(noisy_grid(50, 0.4, np.random.default_rng(1)), gamma, 1e-11)


@pytest.mark.parametrize("gamma", [0.99, 0.9999, 1.0])
def test_large_random_graph(gamma: float) -> None:
    check_consistency(random_graph(5000, 1e-4, np.random.default_rng(2)), gamma, 1e-9)


def test_small_values_have_small_relative_errors() -> None:
    """Going up is likely: from k the ruin has probability about 9^-k."""
    values = value_iteration(walk(60, 0.9), 1.0)
    k = np.arange(1, 59)
    ratio = 1 / 9.0
    ruin = (ratio**k - ratio**59) / (1 - ratio**59)
    np.testing.assert_allclose(values.V_lower[1:59], ruin, rtol=1e-12)
    np.testing.assert_allclose(values.V_upper[1:59], ruin, rtol=1e-12)


def test_value_iteration_alone_is_sound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without linear solves the same answer takes more sweeps."""
    model = noisy_grid(12, 0.4, np.random.default_rng(3))
    guided = value_iteration(model, 0.99)
    monkeypatch.setattr(linear, "_eliminated", lambda *_: None)
    alone = value_iteration(model, 0.99)
    assert alone.iterations > 100
    assert (alone.V_lower <= guided.V_upper).all()
    assert (guided.V_lower <= alone.V_upper).all()
    with pytest.raises(ValueError, match="after 50 sweeps the value of state"):
        value_iteration(model, 0.99, max_iterations=50)


@pytest.mark.parametrize("error", [0.01, -0.01])
def test_wrong_guesses_do_no_harm(error: float, monkeypatch: pytest.MonkeyPatch) -> None:
    model = walk(40, 0.45)
    truth = value_iteration(model, 1.0)

    def wrong(
        self: LinearSolver, matrix: linear.Csr, constant: linear.Float, start: linear.Float
    ) -> linear.Float | None:
        x = self.quickly(matrix, constant, start)
        return None if x is None else x + error

    monkeypatch.setattr(LinearSolver, "carefully", wrong)
    values = value_iteration(model, 1.0)
    assert values.iterations > 100
    assert (values.V_lower <= truth.V_upper).all()
    assert (truth.V_lower <= values.V_upper).all()


def test_solver_chooses_by_the_graph() -> None:
    rng = np.random.default_rng(5)
    for model, eliminates in ((walk(20_000, 0.5), True), (random_graph(8000, 0.1, rng), False)):
        inside = np.flatnonzero(~(model.fail | model.terminal))
        rows = model.transitions()[inside * model.num_actions]
        matrix = sparse.csr_array(0.9 * rows[:, inside])
        constant = np.asarray(rows @ model.fail.astype(float))
        solver = LinearSolver(matrix)
        assert solver._eliminates == eliminates
        for solve in (solver.quickly, solver.carefully):
            x = solve(matrix, constant, np.zeros(len(inside)))
            assert x is not None
            np.testing.assert_allclose(x, matrix @ x + constant, atol=1e-14)


def test_singular_systems_have_no_guess() -> None:
    identity = sparse.csr_array(sparse.eye_array(3))
    assert LinearSolver(identity).carefully(identity, np.ones(3), np.zeros(3)) is None


def test_krylov_iterations_admit_defeat() -> None:
    """On a walk of 10^8 steps fifty directions are not enough."""
    model = walk(20_000, 0.5)
    matrix = sparse.csr_array(model.transitions()[1:-1, 1:-1])
    constant = np.zeros(len(model.fail) - 2)
    constant[0] = 0.5
    assert linear._krylov(matrix, constant, np.zeros_like(constant)) is None


def test_a_hundred_thousand_states() -> None:
    values = value_iteration(walk(100_000, 0.49), 0.999)
    assert (values.V_upper - values.V_lower).max() < 1e-11
    assert values.iterations == 20


def slow_chain(n: int) -> SafeMDP:
    """From the middle n lucky flips in a row lead to fail (0) or to a goal (2 n)."""
    states = np.arange(2 * n + 1)
    outward = states + np.sign(states - n)
    kernel = np.zeros((2 * n + 1, 1, 2 * n + 1))
    kernel[states[1:-1], 0, outward[1:-1]] = 0.5
    kernel[states[1:-1], 0, n] += 0.5
    kernel[n, 0, [n - 1, n, n + 1]] = 0.5, 0, 0.5
    return SafeMDP.stochastic(kernel, states == 0, terminal=states == 2 * n)


def test_more_iterations_are_advised_where_they_help(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enclosure, "_guess", lambda *_: None)
    model = noisy_grid(12, 0.4, np.random.default_rng(3))
    for made in (50, 150):
        with pytest.raises(UndecidedError) as raised:
            value_iteration(model, 0.99, max_iterations=made)
        assert set(raised.value.remedies) - {"tolerance"} == {"exact", "max_iterations"}
        advice = raised.value.remedies["max_iterations"]
        advised = int(advice.removeprefix("raise max_iterations to "))
        values = value_iteration(model, 0.99, max_iterations=advised)
        assert made < values.iterations <= advised


def test_more_iterations_are_not_advised_where_they_may_not_help(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a discount bounds come to rest; with one they stay as wide as rounding makes them."""
    with monkeypatch.context() as unaided, pytest.raises(UndecidedError) as raised:
        unaided.setattr(enclosure, "_guess", lambda *_: None)
        value_iteration(slow_chain(20), 1.0, max_iterations=300)
    assert set(raised.value.remedies) == {"exact", "gamma_safe"}  # bounds too wide to be accepted
    with pytest.raises(UndecidedError) as raised:
        value_iteration(slow_chain(20), 1.0, max_iterations=300)
    assert set(raised.value.remedies) == {"exact", "gamma_safe", "tolerance"}
    accepted = float(raised.value.remedies["tolerance"].removeprefix("accept tolerance="))
    value_iteration(slow_chain(20), 1.0, max_iterations=300, tolerance=accepted)
    value_iteration(slow_chain(20), 0.99)
    assert value_iteration(slow_chain(20), 1.0, exact=True).V[20] == Fraction(1, 2)
    for gamma, tolerance in ((0.99, 1e-17), (1 - 1e-9, 1e-9)):
        monkeypatch.setattr(enclosure, "_guess", lambda *_: None)
        with pytest.raises(UndecidedError) as raised:
            value_iteration(walk(12, 0.5), gamma, tolerance=tolerance, max_iterations=100)
        assert set(raised.value.remedies) - {"tolerance"} == {"exact"}
