"""Guess and verify where value iteration is hopeless; honest bounds where guesses fail."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import sparse

from dead_ends import enclosure, linear
from dead_ends.bellman import value_iteration
from dead_ends.linear import LinearSolver
from dead_ends.model import SafeMDP
from dead_ends.precision import UndecidedError


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
        assert set(raised.value.remedies) == {"exact", "max_iterations", "tolerance"}
        advice = raised.value.remedies["max_iterations"]
        advised = int(advice.removeprefix("raise max_iterations to "))
        values = value_iteration(model, 0.99, max_iterations=advised)
        assert made < values.iterations <= advised


def test_more_iterations_are_not_advised_where_they_may_not_help(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a discount bounds come to rest; with one they stay as wide as rounding makes them."""
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
        assert set(raised.value.remedies) == {"exact", "tolerance"}
