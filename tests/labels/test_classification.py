"""The labelling of deterministic models, its horizons, and the safe actions."""

from __future__ import annotations

import subprocess
import sys

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dead_ends import INFINITE, Label, SafeMDP, classify, safe_actions
from dead_ends.model import memory

F, D, S = Label.FAIL, Label.DEAD, Label.SAFE


@st.composite
def models(draw: st.DrawFn, max_states: int = 8) -> SafeMDP:
    """Any deterministic model with at least one fail state and one initial state."""
    num_states = draw(st.integers(1, max_states))
    num_actions = draw(st.integers(1, 3))
    state = st.integers(0, num_states - 1)
    row = st.lists(state, min_size=num_actions, max_size=num_actions)
    table = draw(st.lists(row, min_size=num_states, max_size=num_states))
    fail = draw(st.sets(state, min_size=1))
    return SafeMDP.deterministic(
        np.array(table), np.isin(np.arange(num_states), list(fail)), initial=draw(state)
    )


def corridor(length: int, *, outside: bool) -> SafeMDP:
    """States 0 (fail) to ``length``, each to the one below; outside: one more, at the end."""
    below = np.maximum(np.arange(length + 1 + outside) - 1, 0)
    stay = below.copy()
    if outside:
        stay[-1] = length + 1
    fail = np.arange(len(below)) == 0
    return SafeMDP.deterministic(np.stack((below, stay), axis=1), fail, initial=len(below) - 1)


@pytest.mark.parametrize("length", [1, 2, 50, 100_000])
def test_corridor(length: int) -> None:
    result = classify(corridor(length, outside=True))
    assert result.labels.tolist() == [F] + [D] * length + [S]
    assert result.survival_time.tolist() == [*range(length + 1), INFINITE]
    assert (result.horizon, result.boundary_horizon) == (length, length)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (length, length)


def test_corridor_that_nobody_enters() -> None:
    result = classify(corridor(7, outside=False))
    assert (result.horizon, result.boundary_horizon) == (7, None)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (7, None)


def test_masks_counts_and_types() -> None:
    result = classify(corridor(2, outside=True))
    assert result.labels.dtype == np.uint8
    assert result.survival_time.dtype == np.int32
    assert result.fail.tolist() == [True, False, False, False]
    assert result.dead.tolist() == [False, True, True, False]
    assert result.safe.tolist() == [False, False, False, True]
    assert result.paper_safe.tolist() == result.safe.tolist()
    assert not result.at_risk.any()
    assert [result.count(label) for label in Label] == [1, 2, 1, 0]


@pytest.mark.parametrize("array", ["labels", "survival_time"])
def test_results_are_read_only(array: str) -> None:
    result = classify(corridor(2, outside=True))
    with pytest.raises(ValueError, match="read-only"):
        getattr(result, array)[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        safe_actions(corridor(2, outside=True))[0, 0] = True


def test_a_fail_state_next_to_a_safe_one_counts_zero_in_the_boundary_horizon() -> None:
    model = SafeMDP.deterministic(np.array([[0, 1], [0, 0]]), np.array([False, True]))
    result = classify(model)
    assert (result.horizon, result.boundary_horizon) == (0, 0)


def test_horizons_without_fail_states() -> None:
    result = classify(SafeMDP.deterministic(np.array([[0]]), np.array([False]), initial=0))
    assert (result.horizon, result.boundary_horizon) == (0, None)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (0, None)


def test_horizons_with_nothing_but_fail_states() -> None:
    result = classify(SafeMDP.deterministic(np.array([[0]]), np.array([True]), initial=0))
    assert result.labels.tolist() == [F]
    assert (result.horizon, result.boundary_horizon) == (0, None)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (0, None)


def test_without_initial_states_there_are_no_reachable_horizons() -> None:
    result = classify(SafeMDP.deterministic(np.array([[0, 1], [0, 0]]), np.array([False, True])))
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (None, None)


def test_reachable_horizons_look_no_further_than_the_start_may_go() -> None:
    # Start 0 may enter 1 (T = 1); 3 may enter the corridor 4 -> 5 -> 1 that 0 never meets.
    table = np.array([[0, 1], [2, 2], [2, 2], [3, 4], [5, 5], [1, 1]])
    fail = np.arange(6) == 2
    result = classify(SafeMDP.deterministic(table, fail, initial=0))
    assert (result.horizon, result.boundary_horizon) == (3, 3)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (1, 1)
    both = classify(SafeMDP.deterministic(table, fail, initial=np.array([0, 3])))
    assert (both.reachable_horizon, both.reachable_boundary_horizon) == (3, 3)


def test_a_start_that_is_already_lost_has_a_horizon_but_no_boundary() -> None:
    table = np.array([[0, 1], [2, 2], [2, 2]])
    result = classify(SafeMDP.deterministic(table, np.arange(3) == 2, initial=1))
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (1, None)


def test_nothing_is_reachable_through_a_terminal_state() -> None:
    table, ends = np.array([[1], [2], [3], [3]]), np.array([False, True, False, False])
    result = classify(SafeMDP.deterministic(table, np.arange(4) == 3, terminal=ends, initial=0))
    assert result.labels.tolist() == [S, S, D, F]
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (0, None)
    assert (result.horizon, result.boundary_horizon) == (1, None)


@settings(max_examples=300, deadline=None)
@given(models())
def test_labels_horizons_and_safe_actions_follow_their_definitions(model: SafeMDP) -> None:
    result = classify(model)
    successors = model.successors()
    # Safe: some infinite path avoids fail, that is, a cycle outside fail is reachable.
    graph = nx.DiGraph()
    graph.add_nodes_from(np.flatnonzero(~model.fail).tolist())
    graph.add_edges_from(
        (s, int(t)) for s in list(graph) for t in successors[s] if not model.fail[t]
    )
    cycles = {state for cycle in nx.simple_cycles(graph) for state in cycle}
    safe = cycles.union(*(nx.ancestors(graph, state) for state in cycles))
    labels = [F if model.fail[s] else S if s in safe else D for s in range(model.num_states)]
    assert result.labels.tolist() == labels
    start = int(np.flatnonzero(model.initial)[0])
    inside = {start} | (nx.descendants(graph, start) if start in graph else set())
    for states, horizon, boundary in (
        (set(range(model.num_states)), result.horizon, result.boundary_horizon),
        (inside, result.reachable_horizon, result.reachable_boundary_horizon),
    ):
        time = result.survival_time
        assert horizon == max((int(time[s]) for s in states if labels[s] == D), default=0)
        entered = [int(time[t]) for s in states & safe for t in successors[s] if labels[t] != S]
        assert boundary == (max(entered) if entered else None)
    mask = safe_actions(model, result)
    for s, a in np.ndindex(mask.shape):
        assert mask[s, a] == (s in safe and labels[successors[s, a]] == S)


@settings(max_examples=200, deadline=None)
@given(models(max_states=12))
def test_horizons_are_ordered_and_bounded_by_the_number_of_dead_states(model: SafeMDP) -> None:
    result = classify(model)
    assert result.horizon is not None
    assert result.horizon <= result.count(D)
    assert sorted(set(result.survival_time[result.dead].tolist())) == list(
        range(1, result.horizon + 1)
    )
    if result.boundary_horizon is not None:
        assert result.boundary_horizon <= result.horizon


def test_the_bound_on_the_horizon_is_attained_by_a_chain() -> None:
    result = classify(corridor(9, outside=False))
    assert result.horizon == result.count(D) == 9


def test_safe_actions_by_hand() -> None:
    # 0: stay, die, unavailable. 1: dead. 2: fail. 3: terminal. 4: only the terminal state.
    table = np.array([[0, 1, -1], [2, -1, 2], [0, 0, 0], [9, -9, 1], [3, 2, -1]])
    model = SafeMDP.deterministic(table, np.arange(5) == 2, terminal=np.arange(5) == 3)
    assert safe_actions(model).tolist() == [
        [True, False, False],
        [False, False, False],
        [False, False, False],
        [True, True, True],
        [True, False, False],
    ]


def test_every_safe_state_has_a_safe_action() -> None:
    model = corridor(5, outside=True)
    assert np.array_equal(safe_actions(model).any(axis=1), classify(model).safe)


def test_safe_actions_of_another_model_are_refused() -> None:
    labelling = classify(corridor(3, outside=True))
    with pytest.raises(ValueError, match=r"^the labelling has 5 states, the model 6$"):
        safe_actions(corridor(4, outside=True), labelling)


def test_what_does_not_fit_the_memory_is_refused_before_it_starts(monkeypatch) -> None:
    monkeypatch.setattr(memory, "GIB", 100)
    monkeypatch.setattr(memory, "available_memory", lambda: 50)
    with pytest.raises(MemoryError, match=r"^labelling 11 states needs 1\.4 GiB of memory"):
        classify(corridor(10, outside=False))
    stochastic = SafeMDP.stochastic(np.full((3, 1, 3), 1 / 3), np.array([True, False, False]))
    with pytest.raises(MemoryError, match=r"^labelling 3 states needs 1\.4 GiB of memory"):
        classify(stochastic)


def test_numba_is_imported_at_the_first_solve_only() -> None:
    program = """
import sys
from dead_ends import SafeMDP, classify, safe_actions
model = SafeMDP.deterministic([[0]], [False])
assert "numba" not in sys.modules
classify(model)
assert "numba" in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True)
