"""Survival times: closed form, networkx, plain-Python sweeps; every numbering; odd rows."""

from __future__ import annotations

from itertools import permutations
from time import perf_counter

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dead_ends import INFINITE, SafeMDP
from dead_ends.labels.retrograde import _row, _survival, reachable, survival_times

GARBAGE = st.integers(min_value=-(2**31), max_value=2**31 - 1)


@st.composite
def tables(draw: st.DrawFn, max_states: int = 7, max_actions: int = 3) -> SafeMDP:
    """Any deterministic model; rows that do not count hold garbage."""
    num_states = draw(st.integers(1, max_states))
    num_actions = draw(st.integers(1, max_actions))
    kinds = draw(st.lists(st.sampled_from("....ft"), min_size=num_states, max_size=num_states))
    state = st.integers(0, num_states - 1)
    rows = []
    for kind in kinds:
        if kind != ".":
            row = draw(st.lists(GARBAGE, min_size=num_actions, max_size=num_actions))
        else:
            entry = st.one_of(state, state, st.just(-1))
            row = draw(st.lists(entry, min_size=num_actions, max_size=num_actions))
            if max(row) < 0:
                row[draw(st.integers(0, num_actions - 1))] = draw(state)
        rows.append(row)
    return SafeMDP.deterministic(
        np.array(rows, dtype=np.int32),
        np.array([kind == "f" for kind in kinds]),
        terminal=np.array([kind == "t" for kind in kinds]),
    )


def by_sweeps(model: SafeMDP) -> list[int]:
    """T by the recursion itself, from T = 1 upwards until nothing changes or T exceeds S."""
    successors = model.successors()
    time = [0 if fail else 1 for fail in model.fail]
    while True:
        new = [
            0 if model.fail[s] else 1 + max(time[t] for t in successors[s] if t >= 0)
            for s in range(model.num_states)
        ]
        new = [t if t <= model.num_states else model.num_states + 1 for t in new]
        if new == time:
            return [t if t <= model.num_states else INFINITE for t in time]
        time = new


def by_networkx(model: SafeMDP) -> list[int]:
    """T as the longest path of the acyclic part; all that reaches a cycle survives."""
    graph = nx.DiGraph()
    graph.add_nodes_from(range(model.num_states))
    for state, row in enumerate(model.successors()):
        graph.add_edges_from((state, int(successor)) for successor in row if successor >= 0)
    cycles = {
        state
        for part in nx.strongly_connected_components(graph)
        for state in part
        if len(part) > 1 or graph.has_edge(state, state)
    }
    alive = set(cycles).union(*(nx.ancestors(graph, state) for state in cycles))
    time = [INFINITE] * model.num_states
    lost = graph.subgraph(set(graph) - alive)
    for state in reversed(list(nx.topological_sort(lost))):
        time[state] = 0 if model.fail[state] else 1 + max(time[t] for t in lost.successors(state))
    return time


@settings(max_examples=400, deadline=None)
@given(tables())
def test_times_agree_with_two_other_solvers(model: SafeMDP) -> None:
    time = survival_times(model).tolist()
    assert time == by_sweeps(model)
    assert time == by_networkx(model)


@settings(max_examples=100, deadline=None)
@given(tables(max_states=12, max_actions=4), st.randoms(use_true_random=False))
def test_times_move_with_the_numbering(model: SafeMDP, random) -> None:
    new = list(range(model.num_states))
    random.shuffle(new)
    renumbered = np.empty_like(model.next_state)
    fail, terminal = np.empty_like(model.fail), np.empty_like(model.terminal)
    for state, row in enumerate(model.successors()):
        renumbered[new[state]] = [new[t] if t >= 0 else -1 for t in row]
        fail[new[state]], terminal[new[state]] = model.fail[state], model.terminal[state]
    other = survival_times(SafeMDP.deterministic(renumbered, fail, terminal=terminal))
    assert np.array_equal(other[new], survival_times(model))


def test_every_order_of_a_model_with_all_kinds_of_states_gives_its_times() -> None:
    # 0 may fail at once or go to 1, 1 -> 2 -> fail 3; 4 chooses between 0 and itself.
    table = np.array([[3, 1], [2, 2], [3, 3], [77, -9], [0, 4], [5, 0]])
    time = np.array([3, 2, 1, 0, INFINITE, INFINITE])
    orders = list(permutations(range(6)))
    for order in orders:
        new = np.array(order)
        other = np.empty_like(table)
        for state in range(6):
            other[new[state]] = table[state] if state == 3 else new[table[state]]
        fail = np.arange(6) == new[3]
        assert np.array_equal(survival_times(SafeMDP.deterministic(other, fail))[new], time)
    assert len(orders) == 720


@pytest.mark.parametrize("ascending", [True, False])
@pytest.mark.parametrize("length", [1, 2, 1000, 100_000])
def test_a_corridor_is_as_long_as_it_is(length: int, ascending: bool) -> None:
    states = np.arange(length + 1)
    table = (states + 1 if ascending else states - 1)[:, None]
    fail = states == (length if ascending else 0)
    expected = length - states if ascending else states
    assert np.array_equal(survival_times(SafeMDP.deterministic(table, fail)), expected)


def test_a_state_that_loses_its_watched_successors_one_by_one_takes_the_longest() -> None:
    # State 0 may go to any state of the chain 1 -> 2 -> ... -> 6 (fail).
    table = np.array([[1, 2, 3, 4, 5, 6]] + [[s + 1] * 6 for s in range(1, 6)] + [[0] * 6])
    for columns in permutations(range(6)):
        model = SafeMDP.deterministic(table[:, columns], np.arange(7) == 6)
        assert survival_times(model).tolist() == [6, 5, 4, 3, 2, 1, 0]


def test_a_long_row_is_read_on_from_where_it_was_left() -> None:
    # 0 -> 1 -> ... -> n (fail); state n + 1 watches n - 1, n - 2, ..., 0 in turn. Reading its
    # row from the start each time would take n * n / 2 steps, a minute instead of milliseconds.
    n = 300_000
    indices = np.concatenate((np.arange(1, n + 1), np.arange(n)[::-1])).astype(np.int32)
    indptr = np.concatenate((np.arange(n + 1), [n, 2 * n]))
    fail = np.arange(n + 2) == n
    started = perf_counter()
    time = _survival(indices, 1, indptr, fail, np.zeros_like(fail))
    assert perf_counter() - started < 10
    assert np.array_equal(time, [*range(n, -1, -1), n + 1])


def test_without_fail_states_everybody_survives() -> None:
    model = SafeMDP.deterministic(np.array([[1], [0]]), np.array([False, False]))
    assert survival_times(model).tolist() == [INFINITE, INFINITE]


def test_with_nothing_but_fail_states_no_row_is_read() -> None:
    model = SafeMDP.deterministic(np.array([[5], [-6]]), np.array([True, True]))
    assert survival_times(model).tolist() == [0, 0]


def test_a_terminal_state_survives_whatever_its_row_says() -> None:
    table = np.array([[1], [2], [0]])
    fail, terminal = np.array([0, 0, 1]) == 1, np.array([0, 1, 0]) == 1
    model = SafeMDP.deterministic(table, fail, terminal=terminal)
    assert survival_times(model).tolist() == [INFINITE, INFINITE, 0]


def test_an_action_that_is_not_available_saves_nobody() -> None:
    model = SafeMDP.deterministic(np.array([[-1, 1], [0, 0]]), np.array([False, True]))
    assert survival_times(model).tolist() == [1, 0]


def test_an_action_that_is_not_available_lengthens_nothing() -> None:
    # 1 -> 2 -> 3 -> fail, and 6 -> 5 -> 4 -> 3: the last state is dead before state 1 is.
    table = np.array([[0, 0], [-1, 2], [3, -1], [0, 0], [3, 3], [4, 4], [5, 5]])
    model = SafeMDP.deterministic(table, np.arange(7) == 0)
    assert survival_times(model).tolist() == [0, 3, 2, 1, 2, 3, 4]


def test_a_self_loop_survives() -> None:
    model = SafeMDP.deterministic(np.array([[1, 0], [0, 0]]), np.array([False, True]))
    assert survival_times(model).tolist() == [INFINITE, 0]


def test_rows_beyond_the_32_bit_integers_start_where_they_should() -> None:
    assert _row(2_000_000_000, 5, None) == (10_000_000_000, 10_000_000_005)


def test_a_memory_mapped_table_is_solved_where_it_lies(tmp_path) -> None:
    np.save(tmp_path / "table.npy", np.array([[1], [2], [0]], dtype=np.int32))
    table = np.load(tmp_path / "table.npy", mmap_mode="r")
    model = SafeMDP.deterministic(table, np.array([False, False, True]))
    assert np.shares_memory(model.next_state, table)
    assert survival_times(model).tolist() == [2, 1, 0]


@settings(max_examples=100, deadline=None)
@given(tables(), st.data())
def test_reachable_states_are_networkx_descendants(model: SafeMDP, data: st.DataObject) -> None:
    initial = data.draw(st.sets(st.integers(0, model.num_states - 1), min_size=1))
    graph = nx.DiGraph()
    graph.add_nodes_from(range(model.num_states))
    for state, row in enumerate(model.successors()):
        graph.add_edges_from((state, int(successor)) for successor in row if successor >= 0)
    expected = initial.union(*(nx.descendants(graph, state) for state in initial))
    assert model.next_state is not None
    reached = reachable(
        model.next_state.reshape(-1),
        model.num_actions,
        None,
        model.fail,
        model.terminal,
        np.array(sorted(initial)),
    )
    assert set(np.flatnonzero(reached).tolist()) == expected
