"""DEA-RRL, its expectile form, RRL and RRL (MSDP) on finite models; conservatism."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dead_ends.envs.brake import BrakeLattice, brake
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.paper.methods import (
    Conservatism,
    conservatism,
    dea_rrl,
    dea_rrl_expectile,
    rrl,
    rrl_msdp,
)
from dead_ends.safety.critics import unguarded
from dead_ends.safety.policies import greedy_actions
from dead_ends.safety.thresholds import threshold_interval
from dead_ends.values.bellman import evaluate_policy, value_iteration

F = Fraction
HALF = F(1, 2)

untimed = settings(deadline=None)  # the first labelling compiles


def rrl_counterexample() -> SafeMDP:
    """P: (d2, q), q: (fail, q), d2 -> d1 -> fail; the task policy takes the first action."""
    table = np.array([[2, 1], [4, 1], [3, 3], [4, 4], [4, 4]], dtype=np.int32)
    return SafeMDP.deterministic(table, np.arange(5) == 4)


def small_brake() -> SafeMDP:
    """61 x 9 states, accelerations -2 to 2, H = 3."""
    lattice = BrakeLattice(max_distance=60, max_speed=8, max_braking=2, max_acceleration=2)
    return brake(lattice)


def random_stochastic(seed: int) -> SafeMDP:
    """Five states; probabilities in fifths, so that everything is exact."""
    rng = np.random.default_rng(seed)
    P = np.zeros((5, 2, 5), dtype=object)
    for s, a in product(range(5), range(2)):
        counts = rng.multinomial(5, rng.dirichlet(np.full(5, 0.3)))
        P[s, a] = [F(int(count), 5) for count in counts]
    return SafeMDP.stochastic(P, np.arange(5) == 4)


@st.composite
def deterministic_models(draw: st.DrawFn) -> SafeMDP:
    n, m = draw(st.integers(2, 6)), draw(st.integers(1, 3))
    rows = st.lists(st.integers(0, n - 1), min_size=m, max_size=m)
    table = np.array(draw(st.lists(rows, min_size=n, max_size=n)), dtype=np.int32)
    return SafeMDP.deterministic(table, np.arange(n) >= draw(st.integers(1, n - 1)))


@untimed
@given(deterministic_models(), st.data())
def test_dea_rrl_reaches_the_best_critic_from_every_start(
    model: SafeMDP, data: st.DataObject
) -> None:
    start = np.array([data.draw(st.integers(0, model.num_actions - 1)) for _ in model.fail])
    for gamma_safe in (0.99, HALF):
        best = value_iteration(model, gamma_safe)
        for method in (dea_rrl(model, gamma_safe, start), rrl_msdp(model, gamma_safe)):
            assert np.array_equal(method.critic.Q, best.Q)
            assert np.array_equal(method.critic.V, best.V)
            greedy = greedy_actions(best)
            states = np.flatnonzero(~model.fail)
            assert greedy[states, method.recovery[states]].all()


@pytest.mark.parametrize("seed", range(12))
def test_dea_rrl_reaches_the_best_critic_of_stochastic_models(seed: int) -> None:
    model = random_stochastic(seed)
    best = value_iteration(model, F(9, 10))
    starts = [np.array([*choice, 0]) for choice in product(range(2), repeat=4)]
    for start in starts[seed % 2 :: 5]:
        assert np.array_equal(dea_rrl(model, F(9, 10), start).critic.Q, best.Q)
    rounded = dea_rrl(model, 0.9).critic
    finite = np.isfinite(rounded.Q)
    assert np.abs(rounded.Q[finite] - best.Q[finite].astype(float)).max() < 1e-7


def test_undiscounted_policy_iteration_would_stall() -> None:
    """s: {stay, fail}, pi = fail: Q^pi = 1 for both actions, so greedy improves nothing."""
    model = SafeMDP.deterministic(np.array([[0, 1], [1, 1]]), np.array([False, True]))
    fails = np.array([1, 0])
    assert evaluate_policy(model, fails, 1).Q[0].tolist() == [1, 1]
    with pytest.raises(ValueError, match=r"^dea_rrl: at gamma_safe = 1 evaluating and improving"):
        dea_rrl(model, 1, fails)
    assert dea_rrl(model, 0.999, fails).recovery[0] == 0
    assert rrl_msdp(model, 1).recovery[0] == 0


def test_long_survival_is_not_safety() -> None:
    """gamma^T underflows long before the corridor ends; the cycle is safe all the same."""
    n = 1200
    table = np.minimum(np.arange(n)[:, None] + [1, 1], n - 1).astype(np.int32)
    table[0] = [1, 0]
    model = SafeMDP.deterministic(table, np.arange(n) == n - 1)
    for method in (dea_rrl(model, HALF), rrl_msdp(model, 0.5)):
        assert method.recovery[0] == 1
        assert method.critic.V[0] == 0
        assert method.critic.V[1] > 0


def test_recovery_rl_recovers_into_the_dead_end() -> None:
    model = rrl_counterexample()
    method = rrl(model, np.zeros(5, dtype=np.int64), HALF)
    assert method.name == "RRL"
    assert method.critic.Q[0].tolist() == [F(1, 4), F(1, 2)]
    assert method.recovery[0] == 0  # into d2
    assert dea_rrl(model, HALF).recovery[0] == 1
    assert not method.recovery.flags.writeable


def test_so_does_the_expectile_on_bad_data() -> None:
    """More than 70% of q's data on "fail", tau = 0.3: greedy recovery enters d2."""
    model = rrl_counterexample()
    data = np.array([[F(1, 2), F(1, 2)]] * 5)
    data[1] = [F(3, 4), F(1, 4)]
    trained = dea_rrl_expectile(model, data, F(3, 10), F(99, 100))
    assert trained.recovery[0] == 0
    assert trained.name == "DEA-RRL (expectile 3/10)"
    data[1] = [F(13, 20), F(7, 20)]
    assert dea_rrl_expectile(model, data, F(3, 10), F(99, 100)).recovery[0] == 1


@pytest.mark.parametrize("seed", range(6))
def test_the_expectile_lies_between_the_two_critics(seed: int) -> None:
    model = random_stochastic(seed)
    data = np.full((5, 2), HALF)
    best, task = rrl_msdp(model, F(9, 10)).critic.Q, rrl(model, data, F(9, 10)).critic.Q
    low, high = (dea_rrl_expectile(model, data, tau, F(9, 10)).critic.Q for tau in (0, HALF))
    middle = dea_rrl_expectile(model, data, F(3, 10), F(9, 10)).critic.Q
    assert np.array_equal(low, best)
    assert np.array_equal(high, task)
    assert (best <= middle).all()
    assert (middle <= task).all()


# Conservatism


def test_conservatism_counts_by_hand() -> None:
    # 0: {stay, dead-end, fail}, 1: {0, 1, -}, 2 dead, 3 goal, 4 fail.
    table = np.array([[0, 2, 4], [0, 1, -1], [4] * 3, [3] * 3, [-1] * 3], dtype=np.int32)
    model = SafeMDP.deterministic(table, np.arange(5) == 4, terminal=np.arange(5) == 3)
    inf = np.inf
    Q = np.array([[0.6, 0.4, 1.0], [0.1, 0.9, inf], [1.0] * 3, [0.0] * 3, [inf] * 3])
    result = conservatism(model, unguarded(Q), 0.5)
    assert result == Conservatism(
        safe_states=2,
        blocked_safe_states=1,
        safe_actions=3,
        blocked_safe_actions=2,
        unsafe_actions=2,
        missed_unsafe_actions=1,
    )
    assert result.blocked_safe_states_share == 0.5
    assert result.blocked_safe_actions_share == 2 / 3
    assert result.missed_unsafe_actions_share == 0.5


def test_no_safe_state_blocks_nothing() -> None:
    model = SafeMDP.deterministic(np.array([[1], [1]]), np.array([False, True]))
    result = conservatism(model, unguarded(np.ones((2, 1))), 0.5)
    assert result == Conservatism(0, 0, 0, 0, 0, 0)
    assert result.blocked_safe_states_share == 0
    assert result.blocked_safe_actions_share == 0
    assert result.missed_unsafe_actions_share == 0
    with pytest.raises(ValueError, match=r"^Q must have shape \(2, 1\), not \(2, 2\)$"):
        conservatism(model, unguarded(np.ones((2, 2))), 0.5)


@untimed
@given(deterministic_models(), st.sampled_from([0.99, 0.7, HALF]))
def test_inside_the_interval_the_best_critic_is_exact(
    model: SafeMDP, gamma_safe: float | Fraction
) -> None:
    upper = threshold_interval(model, gamma_safe).upper
    result = conservatism(model, rrl_msdp(model, gamma_safe).critic, upper)
    assert result.blocked_safe_actions == result.missed_unsafe_actions == 0
    safe = classify(model).safe
    assert result.safe_states == np.count_nonzero(safe)
    assert result.safe_actions == np.count_nonzero(safe_actions(model)[safe])


@pytest.mark.parametrize("seed", range(12))
def test_inside_the_interval_the_best_critic_is_exact_on_stochastic_models(seed: int) -> None:
    model = random_stochastic(seed)
    for gamma_safe in (0.9, F(9, 10)):
        upper = threshold_interval(model, gamma_safe).upper
        result = conservatism(model, rrl_msdp(model, gamma_safe).critic, upper)
        assert result.blocked_safe_actions == result.missed_unsafe_actions == 0


def test_worse_critics_block_more_on_the_brake() -> None:
    """The paper's story on its own example, 61 x 9 lattice, gamma 0.99, eps = gamma^H."""
    model = small_brake()
    labelling = classify(model)
    assert labelling.horizon == 3
    uniform = np.full((model.num_states, 5), 0.2)
    drivers: dict[str, Any] = {
        "best": rrl_msdp(model).critic,
        "expectile": dea_rrl_expectile(model, uniform, 0.3).critic,
        "uniform": rrl(model, uniform).critic,
    }
    counts = {name: conservatism(model, Q, 0.99**3) for name, Q in drivers.items()}
    assert [each.missed_unsafe_actions for each in counts.values()] == [0, 0, 0]
    assert [each.safe_actions for each in counts.values()] == [2392] * 3
    blocked = [each.blocked_safe_actions for each in counts.values()]
    assert blocked[:2] == [0, 69]  # 2.9%
    assert blocked[2] > blocked[1]
    # The paper's epsilon of 0.3 blocks everything at its expectile of 0.3.
    everything = conservatism(model, drivers["expectile"], 0.3)
    assert everything.blocked_safe_actions_share == 1
    assert everything.blocked_safe_states_share == 1
    safer = dea_rrl_expectile(model, uniform, 0.1).critic
    assert conservatism(model, safer, 0.3).blocked_safe_actions == 1107  # 46%
