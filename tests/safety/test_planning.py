"""Best returns: closed forms, brute force over policies, linear programming, the price."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.planning import PlanResult, _Bellman, plan, price_of_conservatism


def corridor(length: int, gamma: float) -> SafeMDP:
    """Cells 0 to length - 1 and a goal; moving on costs nothing, arriving pays 1."""
    n = length + 1
    states = np.arange(n, dtype=np.int32)
    table = np.stack([np.maximum(states - 1, 0), np.minimum(states + 1, n - 1)], axis=1)
    rewards = np.zeros((n, 2))
    rewards[length - 1, 1] = 1 / gamma ** (length - 1)
    return SafeMDP.deterministic(
        table.astype(np.int32),
        np.zeros(n, dtype=np.bool_),
        terminal=states == length,
        rewards=rewards,
        initial=[0],
    )


def random_model(rng: np.random.Generator) -> SafeMDP:
    """Five states, one fails, perhaps one is a goal; rewards of either sign."""
    n, m = 5, 2
    P = rng.random((n, m, n)) * (rng.random((n, m, n)) < 0.2)
    P[np.arange(n), :, rng.integers(0, n, n)] += 0.1
    P /= P.sum(axis=2, keepdims=True)
    return SafeMDP.stochastic(
        P,
        np.arange(n) == 4,
        terminal=(np.arange(n) == 3) & (rng.random() < 0.5),
        rewards=rng.normal(size=(n, m)),
        initial=rng.dirichlet(np.ones(n)),
    )


def policy_return(model: SafeMDP, policy: tuple[int, ...], gamma: float) -> NDArray[np.float64]:
    """V of a policy, by a dense linear solve."""
    assert model.rewards is not None
    rows = np.arange(model.num_states) * model.num_actions + np.array(policy)
    acts = ~(model.fail | model.terminal)
    steps = model.transitions().toarray()[rows] * acts[:, None]
    earned = np.where(acts, model.rewards[np.arange(model.num_states), np.array(policy)], 0)
    return np.asarray(np.linalg.solve(np.eye(model.num_states) - gamma * steps, earned))


def by_brute_force(model: SafeMDP, allowed: NDArray[np.bool_], gamma: float) -> NDArray[np.float64]:
    """The best value of each state over all policies of the restricted set."""
    safe = classify(model).paper_safe & ~model.terminal
    choices = [
        [a for a in range(model.num_actions) if allowed[s, a]] if safe[s] else [*range(2)]
        for s in range(model.num_states)
    ]
    values = [policy_return(model, policy, gamma) for policy in product(*choices)]
    return np.max(values, axis=0) if values else np.full(model.num_states, -np.inf)


def assert_optimal(model: SafeMDP, result: PlanResult, allowed: NDArray[np.bool_]) -> None:
    expected = by_brute_force(model, allowed, 0.9)
    assert result.feasible == bool(np.isfinite(expected).all())
    if not result.feasible:
        assert math.isinf(result.J)
        assert np.array_equal(result.values, expected)
        assert (result.policy == -1).all()
        return
    assert model.initial is not None
    assert result.error_bound < 1e-12
    assert np.abs(result.values - expected).max() <= result.error_bound + 1e-13
    assert abs(result.J - model.initial @ expected) <= result.error_bound + 1e-13
    attained = policy_return(model, tuple(result.policy), 0.9)
    assert np.abs(attained - expected).max() < 1e-12
    safe = np.flatnonzero(classify(model).paper_safe & ~model.terminal)
    assert allowed[safe, result.policy[safe]].all()


# The error bound: as tight as its formula, and each of its terms is needed


def loop(reward: float, row: float = 1.0) -> SafeMDP:
    """One state that pays for ever."""
    P = np.array([[[row]]])
    return SafeMDP.stochastic(P, np.array([False]), rewards=[[reward]], initial=[0])


def bellman(model: SafeMDP, gamma: float) -> _Bellman:
    """T of a model without constraints."""
    assert model.rewards is not None
    acting = ~(model.fail | model.terminal)
    return _Bellman(
        model.transitions(), model.rewards, model.available & acting[:, None], acting, gamma
    )


@pytest.mark.parametrize("reward", [1.0, -1.0])
def test_what_is_left_of_an_exact_answer_is_rounding(reward: float) -> None:
    """V = 2 at gamma = 1/2 without any error: (1 + 4) eps (|r| + |V|) / (1 - 1/2)."""
    result = plan(loop(reward), None, 0.5)
    assert result.J == 2 * reward
    assert result.error_bound == pytest.approx(5 * 3 * 2.0**-52 / 0.5, rel=1e-12)


def test_the_longest_row_has_the_most_roundings() -> None:
    P = np.array([[[1, 0, 0]], [[0.25, 0.5, 0.25]], [[0, 0.5, 0.5]]])
    model = SafeMDP.stochastic(P, np.zeros(3, dtype=bool), rewards=[[1], [1], [1]], initial=[0])
    bound = bellman(model, 0.5).error_bound(np.full(3, 2.0))
    assert bound == pytest.approx((3 + 4) * 3 * 2.0**-52 / 0.5, rel=1e-12)


@pytest.mark.parametrize("wrong", [1e-3, -1e-3, 1.0, -1.0])
@pytest.mark.parametrize(("gamma", "row"), [(0.5, 1.0), (0.99, 1.0), (1 - 1e-8, 1 + 9e-10)])
def test_the_error_bound_is_the_error_where_all_are_wrong_alike(
    wrong: float, gamma: float, row: float
) -> None:
    """T (V* + c) = V* + gamma p c in the loop: the bound is |c|, whatever the sign of c."""
    operator = bellman(loop(1 - gamma * row, row), gamma)
    bound = operator.error_bound(np.array([1 + wrong]))
    assert abs(wrong) <= bound <= abs(wrong) * (1 + 1e-3)


def test_the_error_bound_covers_the_worst_state_not_the_mean() -> None:
    """Off V* = (2, 4) by (0, 1): T V - V = (0, -1/2)."""
    table = np.array([[0], [1]])
    model = SafeMDP.deterministic(
        table, np.array([False, False]), rewards=[[1.0], [2.0]], initial=[0]
    )
    assert bellman(model, 0.5).error_bound(np.array([2.0, 5.0])) == pytest.approx(1, rel=1e-12)
    assert bellman(model, 0.5).error_bound(np.array([2.0, 3.0])) == pytest.approx(1, rel=1e-12)


def test_random_guesses_are_within_their_error_bound() -> None:
    """And the bound is at most (1 + gamma) / (1 - gamma) times the error."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        model = random_model(rng)
        best = by_brute_force(model, np.ones((5, 2), dtype=np.bool_), 0.9)
        guess = best + np.where(best == 0, 0, rng.normal(size=5) * 10.0 ** rng.integers(-6, 3))
        bound = bellman(model, 0.9).error_bound(guess)
        error = np.abs(guess - best).max()
        assert error <= bound <= error * 19 + 1e-12


def test_no_better_policy_is_left() -> None:
    """The greedy policy of the values is the policy, up to what rounding may gain."""
    rng = np.random.default_rng(5)
    for _ in range(30):
        model = random_model(rng)
        result = plan(model, None, 0.9)
        operator = bellman(model, 0.9)
        assert np.array_equal(operator.improve(result.values, result.policy), result.policy)
        assert np.abs(operator.sweep(result.values) - result.values).max() < 1e-13


def test_ties_keep_their_action_and_gains_do_not() -> None:
    rewards = [[1.0, 1.0, 1.0 + 1e-15, 1.0 + 1e-13]]
    model = SafeMDP.deterministic(np.zeros((1, 4), dtype=int), np.array([False]), rewards=rewards)
    operator = bellman(model, 0.5)
    assert operator.improve(np.array([2.0]), np.array([1])).tolist() == [3]
    narrow = SafeMDP.deterministic(
        np.zeros((1, 3), dtype=int), np.array([False]), rewards=[rewards[0][:3]]
    )
    for kept in range(3):
        assert bellman(narrow, 0.5).improve(np.array([2.0]), np.array([kept])).tolist() == [kept]


# Best returns


def test_random_models_agree_with_brute_force_over_policies() -> None:
    rng = np.random.default_rng(1)
    infeasible = 0
    for _ in range(60):
        model = random_model(rng)
        assert_optimal(model, plan(model, None, 0.9), np.ones((5, 2), dtype=np.bool_))
        allowed = rng.random((5, 2)) < 0.8
        restricted = plan(model, allowed, 0.9)
        assert_optimal(model, restricted, allowed)
        infeasible += not restricted.feasible
    assert 5 < infeasible < 55  # both cases were seen


def test_linear_programming_finds_the_same_values() -> None:
    """min sum V subject to V >= r + gamma P V, a second solver."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        model = random_model(rng)
        assert model.rewards is not None
        acts = ~(model.fail | model.terminal)
        pairs = np.repeat(acts, 2)
        states = np.repeat(np.eye(5), 2, axis=0)
        kernel = model.transitions().toarray()
        kernel[:, ~acts] = 0
        solution = linprog(
            np.ones(5),
            A_ub=(0.9 * kernel - states)[pairs],
            b_ub=-model.rewards.reshape(-1)[pairs],
            bounds=[(None, None) if act else (0, 0) for act in acts],
        )
        assert np.abs(solution.x - plan(model, None, 0.9).values).max() < 1e-8


@pytest.mark.parametrize("gamma", [0.5, 0.99, 0.999999])
def test_a_corridor_pays_at_its_end(gamma: float) -> None:
    model = corridor(40, gamma)
    result = plan(model, None, gamma)
    assert result.policy[:40].tolist() == [1] * 40
    assert abs(result.J - 1) <= min(result.error_bound + 1e-12, 1e-9)
    assert not result.values.flags.writeable
    assert not result.policy.flags.writeable


def test_a_loop_pays_a_geometric_series() -> None:
    model = SafeMDP.deterministic(
        np.array([[0, 1], [1, 1]]),
        np.array([False, True]),
        rewards=[[1.0, 5.0], [7.0, 7.0]],
        initial=[0],
    )
    assert plan(model, None, 0.75).J == 5.0  # violating pays more than 4
    assert plan(model, None, 0.875).J == 8.0
    assert plan(model, safe_actions(model), 0.75).J == 4.0
    assert plan(model, safe_actions(model), Fraction(3, 4)).J == 4.0


def test_acting_where_the_episode_has_ended_earns_nothing() -> None:
    model = SafeMDP.deterministic(
        np.array([[1, 2], [1, 1], [2, 2]]),
        np.array([False, True, False]),
        terminal=np.array([False, False, True]),
        rewards=np.full((3, 2), 9.0),
        initial=[0, 1, 2],
    )
    result = plan(model, None, 0.5)
    assert result.values.tolist() == [9.0, 0.0, 0.0]
    assert result.J == 3.0
    assert result.policy.tolist() == [0, 0, 0]
    nothing = plan(model, np.zeros((3, 2), dtype=np.bool_), 0.5)
    assert not nothing.feasible
    assert nothing.blocked_states == 1  # only state 0 acts


def test_dead_states_are_not_constrained() -> None:
    model = SafeMDP.deterministic(
        np.array([[0, 0], [2, 2], [2, 2]]),
        np.array([False, False, True]),
        rewards=[[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]],
        initial=[1],
    )
    allowed = np.array([[True, False], [False, False], [False, False]])
    result = plan(model, allowed, 0.9)
    assert result.feasible
    assert result.J == 2.0


def test_only_ended_states_have_nothing_to_plan() -> None:
    model = SafeMDP.deterministic(np.array([[0]]), np.array([True]), rewards=[[1.0]], initial=[0])
    assert plan(model).J == 0.0


def test_the_error_bound_covers_a_wrong_answer() -> None:
    """Rows that sum to a little more than 1 push the contraction to 1: no bound, said so."""
    P = np.array([[[1 + 9e-10]]])
    model = SafeMDP.stochastic(P, np.array([False]), rewards=[[1.0]], initial=[0])
    assert plan(model, None, 1 - 1e-10).error_bound == math.inf
    result = plan(model, None, 0.9)
    assert abs(result.J - 1 / (1 - 0.9 * (1 + 9e-10))) <= result.error_bound


def test_bad_input_is_named() -> None:
    table, fail = np.array([[0, 0]]), np.array([False])
    bare = SafeMDP.deterministic(table, fail)
    with pytest.raises(ValueError, match=r"^planning needs a model with rewards$"):
        plan(bare)
    with pytest.raises(ValueError, match=r"^planning needs a model with initial states$"):
        plan(SafeMDP.deterministic(table, fail, rewards=[[0.0, 0.0]]))
    model = SafeMDP.deterministic(table, fail, rewards=[[0.0, 0.0]], initial=[0])
    for gamma in (0.0, 1.0, math.nan, -0.5):
        with pytest.raises(ValueError, match=r"^gamma, the discount of the reward, must lie"):
            plan(model, None, gamma)
    for allowed in (np.ones((1, 3), dtype=np.bool_), np.ones((1, 2))):
        with pytest.raises(ValueError, match=r"^allowed must be a boolean mask of shape \(1, 2\)"):
            plan(model, allowed)


# The price of conservatism


def narrow_road() -> SafeMDP:
    """Through the field (slow), along the narrow road (fast), or off the cliff (best paid).

    The task policy, action 0, would drive off the narrow road; a careful driver does not.
    """
    start, road, field, goal, fail = range(5)
    table = [[field, road, fail], [fail, goal, fail], [goal] * 3, [goal] * 3, [fail] * 3]
    rewards = np.array([[1, 2, 100], [0, 10, 0], [1, 1, 1], [0, 0, 0], [0, 0, 0]])
    return SafeMDP.deterministic(
        np.array(table, dtype=np.int32),
        np.arange(5) == fail,
        terminal=np.arange(5) == goal,
        rewards=rewards.astype(float),
        initial=[start],
    )


def test_the_price_of_conservatism_on_the_narrow_road() -> None:
    first_action = np.zeros(5, dtype=np.int64)
    for gamma_safe in (0.5, Fraction(1, 2)):
        price = price_of_conservatism(narrow_road(), first_action, gamma_safe, 0.5, 0.5)
        assert price.unconstrained.J == 100.0
        assert price.recovery_set.J == 2 + 0.5 * 10
        assert price.task_set.J == 1 + 0.5 * 1
        assert price.dea_rrl.J == price.recovery_set.J
        assert price.rrl.J == price.task_set.J
    # At eps = 1 = gamma^H_b RRL too sees the road; above it even the cliff is allowed.
    assert price_of_conservatism(narrow_road(), first_action, 0.5, 1.0, 0.5).task_set.J == 7.0
    assert price_of_conservatism(narrow_road(), first_action, 0.5, 1.1, 0.5).task_set.J == 100.0


def test_rewards_are_discounted_by_a_hundredth_if_nothing_is_said() -> None:
    first_action = np.zeros(5, dtype=np.int64)
    price = price_of_conservatism(narrow_road(), first_action, 0.5, 0.5)
    assert price.recovery_set.J == 2 + 0.99 * 10
    assert price.task_set.J == 1 + 0.99 * 1
    assert plan(narrow_road()).J == 100
    assert plan(loop(1.0)).J == pytest.approx(100, rel=1e-12)


def test_an_empty_set_and_a_loop_that_fails() -> None:
    """P: (d2, q), q: (fail, q), d2 -> d1 -> fail: RRL's set is empty, its loop enters d2."""
    fail = np.arange(5) == 4
    table = np.array([[2, 1], [4, 1], [3, 3], [4, 4], [4, 4]], dtype=np.int32)
    rewards = np.zeros((5, 2))
    rewards[1, 1] = 1.0
    model = SafeMDP.deterministic(table, fail, rewards=rewards, initial=[0])
    price = price_of_conservatism(model, np.zeros(5, dtype=np.int64), 0.5, 0.25, 0.5)
    assert not price.task_set.feasible
    assert price.task_set.blocked_states == 2  # P and q
    assert price.rrl.J == 0.0
    assert price.dea_rrl.J == price.recovery_set.J == price.unconstrained.J == 1.0


def test_the_order_of_theorem_1_on_random_models() -> None:
    rng = np.random.default_rng(3)
    strict = 0
    for _ in range(40):
        n = 5
        table = rng.integers(0, n, (n, 2)).astype(np.int32)
        model = SafeMDP.deterministic(
            table, np.arange(n) == n - 1, rewards=rng.normal(size=(n, 2)), initial=[*range(n)]
        )
        tenths = rng.integers(0, 11, n)
        task = np.stack([tenths, 10 - tenths], axis=1) * Fraction(1, 10)
        price = price_of_conservatism(model, task, Fraction(9, 10), Fraction(1, 2), 0.9)
        best, wide, narrow = price.unconstrained.J, price.recovery_set.J, price.task_set.J
        assert best >= wide - 1e-12
        assert wide >= narrow - 1e-12
        strict += wide > narrow + 1e-12
    assert strict > 5
