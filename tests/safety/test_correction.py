"""Behavior correction: its equation, the closed loop as a model, and the theorems about it."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dead_ends.io.environment_model import Ended, model_of_environment
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.labels.labelling import INFINITE
from dead_ends.model.safe_mdp import Geometry, SafeMDP
from dead_ends.safety.correction import (
    behavior_correction,
    corrected_actions,
    corrected_model,
    safety_filter,
)
from dead_ends.safety.critics import unguarded
from dead_ends.safety.policies import greedy_actions

F = Fraction
INF = math.inf
HALF = F(1, 2)

untimed = settings(deadline=None)  # the first labelling compiles; a busy machine may pause


def fractions(rows: list[list[Any]]) -> NDArray[np.object_]:
    table = np.empty((len(rows), len(rows[0])), dtype=object)
    for index in np.ndindex(table.shape):
        table[index] = rows[index[0]][index[1]]
    return table


def power(T: int) -> Fraction:
    return F(0) if T == INFINITE else HALF**T


def critic_of_times(model: SafeMDP, times: NDArray[np.int32]) -> NDArray[np.object_]:
    """Q(s, a) = (1/2)^T(s'), exactly; +inf where there is no action."""
    table = model.successors()
    return fractions(
        [[power(int(times[s])) if s >= 0 else INF for s in row] for row in table.tolist()]
    )


def policy_times(model: SafeMDP, policy: NDArray[np.int64]) -> NDArray[np.int32]:
    """Steps until the policy fails, by following it."""
    table = model.successors()
    times = np.full(model.num_states, INFINITE, dtype=np.int32)
    for start in range(model.num_states):
        state = start
        for step in range(model.num_states + 1):
            if model.fail[state]:
                times[start] = step
                break
            state = int(table[state, policy[state]])
    return times


def reachable(model: SafeMDP, start: int) -> set[int]:
    table = model.successors()
    seen, frontier = {start}, [start]
    while frontier:
        for successor in table[frontier.pop()].tolist():
            if successor >= 0 and successor not in seen:
                seen.add(successor)
                frontier.append(successor)
    return seen


def stays_safe(model: SafeMDP, safe: NDArray[np.bool_]) -> bool:
    """Whether no agent leaves the safe states."""
    return all(safe[s] for start in np.flatnonzero(safe) for s in reachable(model, int(start)))


def recoveries(Q: NDArray[Any], num: int = 64) -> list[NDArray[np.int64]]:
    """Recovery policies greedy on Q, with every way to break ties (at most ``num``)."""
    choices = [np.flatnonzero(row).tolist() or [0] for row in greedy_actions(Q)]
    return [np.array(each) for _, each in zip(range(num), product(*choices), strict=False)]


@st.composite
def deterministic_models(draw: st.DrawFn) -> SafeMDP:
    n, m = draw(st.integers(2, 6)), draw(st.integers(1, 3))
    rows = st.lists(st.integers(0, n - 1), min_size=m, max_size=m)
    table = np.array(draw(st.lists(rows, min_size=n, max_size=n)), dtype=np.int32)
    fail = np.zeros(n, dtype=np.bool_)
    fail[draw(st.integers(1, n - 1)) :] = True
    return SafeMDP.deterministic(table, fail)


def rrl_counterexample() -> SafeMDP:
    """P: (d2, q), q: (fail, q), d2 -> d1 -> fail; the task policy takes the first action."""
    P, q, d2, d1, fail = range(5)
    table = np.array([[d2, q], [fail, q], [d1, d1], [fail, fail], [fail, fail]], dtype=np.int32)
    return SafeMDP.deterministic(
        table, np.arange(5) == fail, initial=[P], state_names=["P", "q", "d2", "d1", "fail"]
    )


# behavior_correction


def test_the_equation_for_integer_policies() -> None:
    Q = np.array([[0.0, 0.5], [0.4, 0.1], [INF, INF]])
    corrected = behavior_correction(np.array([1, 1, -1]), unguarded(Q), 0.5, np.array([0, 1, 0]))
    assert corrected.tolist() == [0, 1, 0]
    assert np.issubdtype(corrected.dtype, np.integer)


def test_blocked_probability_moves_to_the_recovery_action() -> None:
    Q = fractions([[F(0), F(1, 2), F(1)], [F(1), F(1), F(1)], [F(0), F(0), F(0)]])
    policy = fractions([[F(1, 2), F(1, 3), F(1, 6)], [F(1), F(0), F(0)], [F(0), F(1, 2), F(1, 2)]])
    corrected = behavior_correction(policy, unguarded(Q), HALF, np.array([0, 2, 1]))
    expected = [[F(1), F(0), F(0)], [F(0), F(0), F(1)], [F(0), F(1, 2), F(1, 2)]]
    assert corrected.tolist() == expected


def test_fractions_stay_fractions_beside_an_integer_policy() -> None:
    Q = np.array([[0.0, 1.0, 1.0]])
    thirds = fractions([[F(1, 3), F(1, 3), F(1, 3)]])
    recovered = behavior_correction(thirds, unguarded(Q), 0.5, np.array([1]))
    assert recovered.tolist() == [[F(1, 3), F(2, 3), F(0)]]
    shared = behavior_correction(np.array([2]), unguarded(Q), 0.5, thirds)
    assert shared.tolist() == thirds.tolist()


def test_fractions_beside_floats_become_floats() -> None:
    Q = np.array([[0.0, 1.0]])
    mixed = behavior_correction(
        fractions([[F(1, 3), F(2, 3)]]), unguarded(Q), 0.5, np.array([[0.5, 0.5]])
    )
    assert mixed.dtype == np.float64
    assert mixed == pytest.approx(np.array([[2 / 3, 1 / 3]]))


def test_a_stochastic_recovery_shares_what_was_blocked() -> None:
    Q = np.array([[0.0, 1.0], [1.0, 0.0]])
    recovery = np.array([[0.75, 0.25], [0.0, 1.0]])
    assert behavior_correction(np.array([1, 1]), unguarded(Q), 0.5, recovery).tolist() == [
        [0.75, 0.25],
        [0.0, 1.0],
    ]
    uniform = np.full((2, 2), 0.5)
    assert behavior_correction(uniform, unguarded(Q), 0.5, recovery).tolist() == [
        [0.875, 0.125],
        [0.0, 1.0],
    ]


def test_an_unavailable_proposal_is_corrected() -> None:
    Q = np.array([[0.0, INF]])
    assert behavior_correction(np.array([1]), unguarded(Q), 0.5, np.array([0])).tolist() == [0]


def test_behavior_correction_names_what_is_wrong() -> None:
    Q = np.array([[0.0, 0.7, INF], [0.2, 0.3, 0.4]])
    with pytest.raises(
        ValueError, match=r"^recovery: state 0, action 2 is not available there \(Q = \+inf\)$"
    ):
        behavior_correction(np.array([1, 0]), unguarded(Q), 0.5, np.array([2, 0]))
    # Where it is not needed, it may be anything.
    assert behavior_correction(np.array([0, 0]), unguarded(Q), 0.5, np.array([2, 0])).tolist() == [
        0,
        0,
    ]
    with pytest.raises(ValueError, match=r"^recovery: state 1: there is no action 3 \(0 to 2\)$"):
        behavior_correction(np.array([0, 0]), unguarded(Q), 0.5, np.array([0, 3]))
    with pytest.raises(ValueError, match=r"^policy must be integers \(2,\) or probabilities"):
        behavior_correction(np.array([0]), unguarded(Q), 0.5, np.array([0, 0]))


def test_shares_too_need_a_recovery_that_is_available() -> None:
    """A tiny share is enough; where nothing is blocked, or nothing can be done, it is not asked."""
    Q = np.array([[0.0, 0.7, INF], [0.2, 0.3, 0.4], [INF, INF, INF]])
    tiny = np.array([[1 - 1e-12, 1e-12, 0.0], [0.5, 0.25, 0.25], [0.0, 0.0, 1.0]])
    single = np.array([2, 1, 0])
    half = np.array([[0.5, 0.0, 0.5], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    refused = r"^recovery: state 0, action 2 is not available there \(Q = \+inf\)$"
    for task, recovery in ((tiny, single), (tiny, half), (np.array([1, 0, 0]), half)):
        with pytest.raises(ValueError, match=refused):
            behavior_correction(task, unguarded(Q), 0.5, recovery)
    for task, recovery in ((np.eye(3), single), (np.eye(3), half), (np.array([0, 1, 2]), half)):
        executed = behavior_correction(task, unguarded(Q), 0.5, recovery)
        assert executed[:2].tolist() == np.eye(3)[:2].tolist()


def test_the_first_state_without_its_recovery_is_named() -> None:
    Q = np.array([[0.0, INF, INF], [0.9, INF, 0.8], [0.9, 0.8, INF], [0.9, 0.8, INF]])
    for task in (np.zeros(4, dtype=np.int64), np.eye(3)[[0, 0, 0, 0]]):
        with pytest.raises(ValueError, match=r"^recovery: state 1, action 1 is not available"):
            behavior_correction(task, unguarded(Q), 0.5, np.array([1, 1, 2, 2]))
        with pytest.raises(ValueError, match=r"^recovery: state 2, action 2 is not available"):
            behavior_correction(task, unguarded(Q), 0.5, np.array([1, 2, 2, 2]))


@untimed
@given(st.data())
def test_integer_and_stochastic_forms_agree(data: st.DataObject) -> None:
    shares = st.sampled_from([F(0), F(1, 4), F(1, 2), F(1)])
    Q = fractions(
        data.draw(st.lists(st.lists(shares, min_size=3, max_size=3), min_size=1, max_size=4))
    )
    actions = st.lists(st.integers(0, 2), min_size=len(Q), max_size=len(Q))
    task, recovery = np.array(data.draw(actions)), np.array(data.draw(actions))
    epsilon = data.draw(st.fractions(0, 1, max_denominator=8))
    corrected = behavior_correction(task, unguarded(Q), epsilon, recovery)
    one_hot = np.eye(3)
    expected = one_hot[corrected].tolist()
    for policy, rec in product((task, one_hot[task]), (recovery, one_hot[recovery])):
        if policy.ndim == 2 or rec.ndim == 2:
            assert behavior_correction(policy, unguarded(Q), epsilon, rec).tolist() == expected


# corrected_actions, corrected_model


def test_a_blocked_action_is_replaced() -> None:
    allowed = np.array([[True, False], [False, False]])
    recovery = np.array([0, 1])
    every = corrected_actions(allowed, recovery, np.arange(2)[:, None], np.arange(2))
    assert every.tolist() == [[0, 0], [1, 1]]
    assert corrected_actions(allowed, recovery, [0, 0, 1], [0, 1, 0]).tolist() == [0, 0, 1]
    assert corrected_actions(allowed, recovery, 1, 0) == 1


def test_the_corrected_table_and_its_rewards() -> None:
    table = np.array([[0, 1, -1], [1, 2, 0], [3, 3, 3], [0, 0, 0]], dtype=np.int32)
    fail, terminal = np.arange(4) == 2, np.arange(4) == 3
    rewards = np.arange(12.0).reshape(4, 3)
    geometry = Geometry(np.zeros((4, 2), dtype=np.int32))
    model = SafeMDP.deterministic(
        table,
        fail,
        terminal=terminal,
        rewards=rewards,
        initial=[0],
        state_names=list("abcd"),
        action_names=list("xyz"),
        geometry=geometry,
    )
    Q = np.array([[0.0, 0.5, INF], [0.5, 1.0, 0.0], [INF] * 3, [0.0] * 3])
    corrected = corrected_model(model, unguarded(Q), 0.5)
    assert corrected.is_deterministic
    assert corrected.next_state is not None
    assert corrected.next_state.dtype == np.int32
    assert not corrected.next_state.flags.writeable
    assert corrected.successors().tolist() == [[0, 0, -1], [0, 0, 0], [-1] * 3, [3] * 3]
    assert corrected.rewards is not None
    # Proposing y in a earns what x earns; a closed action earns nothing that counts.
    assert corrected.rewards[0, :2].tolist() == [0.0, 0.0]
    assert corrected.rewards[1].tolist() == [5.0, 5.0, 5.0]
    assert np.array_equal(corrected.available, model.available)
    assert corrected.state_names == model.state_names
    assert corrected.action_names == model.action_names
    assert corrected.initial is model.initial
    assert corrected.geometry is geometry
    assert np.array_equal(corrected.terminal, terminal)
    other = corrected_model(model, unguarded(Q), 0.5, np.array([1, 1, 9, 0]) % 3)
    assert other.successors()[1].tolist() == [2, 2, 0]


def test_no_threshold_touches_terminal_states() -> None:
    table = np.array([[0, 0], [-1, -1]], dtype=np.int32)
    model = SafeMDP.deterministic(
        table, np.array([False, False]), terminal=np.array([False, True]), rewards=table * 1.0
    )
    corrected = corrected_model(model, unguarded(np.zeros((2, 2))), 0.0)
    assert corrected.successors().tolist() == [[0, 0], [1, 1]]
    assert corrected.rewards is not None
    assert corrected.rewards.tolist() == [[0.0, 0.0], [-1.0, -1.0]]


def stochastic_model(kind: type) -> SafeMDP:
    third = F(1, 3)
    P = fractions([[F(0)] * 3] * 6).reshape(3, 2, 3)
    P[0, 0] = [1 - third, third, F(0)]
    P[0, 1] = [F(0), third, 1 - third]
    P[1, 0] = [F(0), F(1), F(0)]
    fail = np.arange(3) == 2
    available = np.array([[True, True], [True, False], [False, False]])
    return SafeMDP.stochastic(P.astype(kind), fail, available, rewards=np.eye(3)[:, :2])


@pytest.mark.parametrize("kind", [object, float])
def test_the_corrected_kernel_stays_exact(kind: type) -> None:
    model = stochastic_model(kind)
    Q = np.array([[0.0, 0.7], [0.0, INF], [INF, INF]])
    corrected = corrected_model(model, unguarded(Q), 0.5)
    assert not corrected.is_deterministic
    dense = corrected.transitions().toarray().reshape(3, 2, 3)
    before = model.transitions().toarray().reshape(3, 2, 3)
    assert np.array_equal(dense[0], before[0, [0, 0]])
    assert np.array_equal(dense[1:], before[1:])
    assert (corrected.exact is None) == (kind is float)
    if corrected.exact is not None:
        assert corrected.exact == (F(2, 3), F(1, 3)) * 2 + (F(1),)
        assert [float(p) for p in corrected.exact] == corrected.transitions().data.tolist()
    assert np.array_equal(corrected.available, model.available)
    assert corrected.rewards is not None
    assert corrected.rewards[0].tolist() == [1.0, 1.0]
    assert not corrected.transitions().data.flags.writeable
    # Without anything to correct nothing changes.
    same = corrected_model(model, unguarded(Q), 1.0)
    assert np.array_equal(same.transitions().toarray(), model.transitions().toarray())


def test_corrected_model_names_what_is_wrong() -> None:
    model = rrl_counterexample()
    Q = np.full((5, 2), 0.25)
    with pytest.raises(ValueError, match=r"^Q must have shape \(5, 2\), not \(4, 2\)$"):
        corrected_model(model, unguarded(Q[:4]), 0.5)
    with pytest.raises(ValueError, match=r"^recovery must be integers of shape \(5,\), not float"):
        corrected_model(model, unguarded(Q), 0.5, np.zeros((5, 2)))
    with pytest.raises(
        ValueError, match=r"^recovery: state 1 \(q\): there is no action 2 \(0 to 1\)$"
    ):
        corrected_model(model, unguarded(Q), 0.5, np.array([0, 2, 0, 0, 0]))
    partial = SafeMDP.deterministic(np.array([[0, -1], [1, 1]]), np.array([False, True]))
    with pytest.raises(
        ValueError,
        match=r"^state 0: the recovery policy takes action 1, which is not available there$",
    ):
        corrected_model(partial, unguarded(np.zeros((2, 2))), 0.0, np.array([1, 0]))


def test_the_recovery_is_only_needed_where_something_is_proposed_and_blocked() -> None:
    """State 0 blocks nothing, 1 is a goal, 2 fails, 3 blocks: its recovery alone must exist."""
    table = np.array([[0, -1], [1, 1], [2, 2], [-1, 2], [-1, 2]])
    model = SafeMDP.deterministic(
        table, np.arange(5) == 2, terminal=np.arange(5) == 1, action_names=["x", "y"]
    )
    Q = np.array([[0.0, INF], [0.9, 0.9], [INF, INF], [INF, 1.0], [INF, 1.0]])
    corrected = corrected_model(model, unguarded(Q), 0.5, np.array([1, 0, 0, 1, 1]))
    assert corrected.successors().tolist() == model.successors().tolist()
    with pytest.raises(ValueError, match=r"^state 3: the recovery policy takes action 0 \(x\),"):
        corrected_model(model, unguarded(Q), 0.5, np.array([1, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match=r"^state 4: the recovery policy takes action 0 \(x\),"):
        corrected_model(model, unguarded(Q), 0.5, np.array([1, 0, 0, 1, 0]))


def test_a_recovery_action_that_does_not_exist_is_named_with_its_first_state() -> None:
    model = rrl_counterexample()
    for wrong, action in (([0, 0, -1, 2, 0], -1), ([0, 0, 2, -1, 5], 2)):
        with pytest.raises(
            ValueError, match=rf"^recovery: state 2 \(d2\): there is no action {action} \("
        ):
            corrected_model(model, unguarded(np.zeros((5, 2))), 0.5, np.array(wrong))
    for shape in (np.zeros(4, dtype=int), np.zeros((5, 1), dtype=int), np.zeros(5)):
        with pytest.raises(ValueError, match=r"^recovery must be integers of shape \(5,\), not "):
            corrected_model(model, unguarded(np.zeros((5, 2))), 0.5, shape)


# Theorem 2 and its limits


@untimed
@given(deterministic_models())
def test_the_loop_corrected_with_the_best_critic_never_leaves_the_safe_set(
    model: SafeMDP,
) -> None:
    """For 0 < eps <= gamma^H_b, every tie-break of the recovery policy, and every agent."""
    labelling = classify(model)
    Q = critic_of_times(model, labelling.survival_time)
    horizon = labelling.boundary_horizon
    for epsilon in (F(1, 10**6), HALF ** (horizon or 0)):
        for recovery in recoveries(Q):
            corrected = corrected_model(model, unguarded(Q), epsilon, recovery)
            assert stays_safe(corrected, labelling.safe)
            # And nothing safe is blocked: safe actions lead where they led.
            safe = safe_actions(model, labelling)
            assert np.array_equal(corrected.successors()[safe], model.successors()[safe])


@untimed
@given(deterministic_models())
def test_above_the_interval_some_agent_leaves_the_safe_set(model: SafeMDP) -> None:
    labelling = classify(model)
    if labelling.boundary_horizon is None:
        return
    Q = critic_of_times(model, labelling.survival_time)
    epsilon = HALF**labelling.boundary_horizon + F(1, 10**9)
    corrected = corrected_model(model, unguarded(Q), epsilon)
    assert not stays_safe(corrected, labelling.safe)


@untimed
@given(deterministic_models(), st.data())
def test_a_gate_on_a_policys_critic_is_safe_with_the_best_recovery(
    model: SafeMDP, data: st.DataObject
) -> None:
    labelling = classify(model)
    task = np.array([data.draw(st.integers(0, model.num_actions - 1)) for _ in model.fail])
    Q_task = critic_of_times(model, policy_times(model, task))
    Q = critic_of_times(model, labelling.survival_time)
    epsilon = HALF ** (labelling.boundary_horizon or 0)
    for recovery in recoveries(Q, 16):
        corrected = corrected_model(model, unguarded(Q_task), epsilon, recovery)
        assert stays_safe(corrected, labelling.safe)


def test_recovery_rl_enters_a_dead_end_from_a_safe_state() -> None:
    """The smallest strict counterexample to "both RRL and DEA-RRL prevent dead-ends" (m = 2)."""
    model = rrl_counterexample()
    labelling = classify(model)
    assert labelling.safe.tolist() == [True, True, False, False, False]
    assert labelling.boundary_horizon == 2
    Q_task = critic_of_times(model, policy_times(model, np.zeros(5, dtype=np.int64)))
    for epsilon in (F(1, 10**6), HALF**2):  # gamma^H_b is the largest allowed
        for recovery in recoveries(Q_task):
            loop = corrected_model(model, unguarded(Q_task), epsilon, recovery)
            assert loop.successors()[0].tolist() == [2, 2]
        Q = critic_of_times(model, labelling.survival_time)
        assert reachable(corrected_model(model, unguarded(Q), epsilon), 0) == {0, 1}


@pytest.mark.parametrize(("m", "by_a_tie"), [(1, False), (2, False), (3, True)])
def test_all_models_of_three_states_agree_on_when_recovery_rl_is_safe(
    m: int, by_a_tie: bool
) -> None:
    """All 3^(2m) models with one fail state; the task policy takes the first action.

    RRL is safe if every safe state keeps an allowed action. With three states it fails
    nowhere for m = 2, and only under an unlucky tie for m = 3.
    """
    fails_by_a_tie = False
    for codes in product(range(3), repeat=2 * m):
        table = np.array([*np.reshape(codes, (2, m)).tolist(), [2] * m], dtype=np.int32)
        model = SafeMDP.deterministic(table, np.arange(3) == 2)
        labelling = classify(model)
        Q_task = critic_of_times(model, policy_times(model, np.zeros(3, dtype=np.int64)))
        epsilon = HALF ** (labelling.boundary_horizon or 0)
        keeps = all((Q_task[s] < epsilon).any() for s in np.flatnonzero(labelling.safe))
        stays = [
            stays_safe(corrected_model(model, unguarded(Q_task), epsilon, recovery), labelling.safe)
            for recovery in recoveries(Q_task)
        ]
        assert all(stays) or not keeps
        assert any(stays)
        fails_by_a_tie |= not all(stays)
    assert fails_by_a_tie == by_a_tie


def test_the_filter_of_a_model() -> None:
    """Without a threshold it asks the graph alone, even where the critic sees no difference."""
    model = SafeMDP.deterministic(
        [[1, 0], [2, 2], [2, 2]],
        np.arange(3) == 2,
        state_names=["pier", "ice", "water"],
        action_names=["go", "stay"],
    )
    blind = np.zeros((3, 2))
    table = safety_filter(model, unguarded(blind))
    assert table.allowed.tolist() == [[False, True], [False, False], [False, False]]
    assert table.recovery[0] == 1
    assert (table.state_names, table.action_names) == (model.state_names, model.action_names)
    assert (table.keys, table.metadata) == (None, {})
    assert safety_filter(model).allowed.tolist() == table.allowed.tolist()
    assert safety_filter(model, unguarded(blind), 0.5).allowed.all()
    assert safety_filter(replace(model, estimate=True)).metadata == {"estimate": True}
    explored = model_of_environment(model, [0, (1, 2.5), Ended(0)], seed=3, table="abc")
    keyed = safety_filter(explored, metadata={"made by": "a test"})
    assert keyed.keys == ("0", "(1, 2.5)", "Ended(key=0)")
    assert keyed.metadata == {"made by": "a test", "seed": 3, "table": "abc"}
