"""Labels of stochastic models: brute force over policies, THEORY in small, a second solver."""

from __future__ import annotations

from itertools import product

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dead_ends import INFINITE, Label, SafeMDP, classify, safe_actions
from dead_ends.labels import qualitative
from dead_ends.labels.qualitative import _p_min_zero, _predecessors, _reaching, _width

F, D, S, R = Label.FAIL, Label.DEAD, Label.SAFE, Label.AT_RISK


def stochastic(rows: dict[int, list[dict[int, float]]], num_states: int, fail: int) -> SafeMDP:
    """A model from one distribution an action; states without rows are fail or absorbing."""
    num_actions = max(len(actions) for actions in rows.values())
    P = np.zeros((num_states, num_actions, num_states))
    for state, actions in rows.items():
        for action, distribution in enumerate(actions):
            for successor, p in distribution.items():
                P[state, action, successor] = p
    available = P.any(axis=2)
    ends = np.array([s not in rows and s != fail for s in range(num_states)])
    is_fail = np.arange(num_states) == fail
    return SafeMDP.stochastic(P, is_fail, available, terminal=ends, initial=0)


@st.composite
def kernels(draw: st.DrawFn, max_states: int = 5) -> SafeMDP:
    """Any stochastic model of a few states, two actions and at most three successors each."""
    num_states = draw(st.integers(1, max_states))
    kinds = draw(st.lists(st.sampled_from("....ft"), min_size=num_states, max_size=num_states))
    P = np.zeros((num_states, 2, num_states))
    available = np.ones((num_states, 2), dtype=np.bool_)
    supports = st.sets(st.integers(0, num_states - 1), min_size=1, max_size=3)
    for state in range(num_states):
        for action in range(2):
            support = sorted(draw(supports))
            P[state, action, support] = 1 / len(support)
        available[state] = draw(st.sampled_from([(True, True), (True, False), (False, True)]))
    return SafeMDP.stochastic(
        P,
        np.array([kind == "f" for kind in kinds]),
        available,
        terminal=np.array([kind == "t" for kind in kinds]),
        initial=draw(st.integers(0, num_states - 1)),
    )


def chain(model: SafeMDP, policy: tuple[int, ...]) -> nx.DiGraph:
    """The graph of the Markov chain of a memoryless deterministic policy."""
    kernel = model.transitions().toarray().reshape(model.num_states, model.num_actions, -1)
    graph = nx.DiGraph()
    graph.add_nodes_from(range(model.num_states))
    for state, action in enumerate(policy):
        graph.add_edges_from((state, int(t)) for t in np.flatnonzero(kernel[state, action]))
    return graph


def by_brute_force(model: SafeMDP) -> list[Label]:
    """Label by all memoryless deterministic policies; some of them attains P_min everywhere."""
    fail = set(np.flatnonzero(model.fail).tolist())
    never, not_surely = set(fail) ^ fail, set(fail) ^ fail
    choices = [np.flatnonzero(row).tolist() or [0] for row in model.available]
    for policy in product(*choices):
        graph = chain(model, policy)
        for state in set(graph) - fail:
            visited = nx.descendants(graph, state) | {state}
            if not visited & fail:
                never.add(state)
            if any(not (nx.descendants(graph, t) | {t}) & fail for t in visited):
                not_surely.add(state)
    return [
        F if s in fail else S if s in never else R if s in not_surely else D
        for s in range(model.num_states)
    ]


def longest_paths(model: SafeMDP) -> list[int]:
    """T over all transitions, by the recursion from T = 1 upwards."""
    kernel = model.transitions().toarray().reshape(model.num_states, model.num_actions, -1)
    successors = [np.flatnonzero(kernel[s].any(axis=0)).tolist() for s in range(model.num_states)]
    time = [0 if fail else 1 for fail in model.fail]
    for _ in range(model.num_states + 1):
        time = [
            0 if model.fail[s] else 1 + max(time[t] for t in successors[s])
            for s in range(model.num_states)
        ]
    return [t if t <= model.num_states else INFINITE for t in time]


@settings(max_examples=300, deadline=None)
@given(kernels())
def test_labels_agree_with_all_policies(model: SafeMDP) -> None:
    labelling = classify(model)
    assert labelling.labels.tolist() == by_brute_force(model)
    assert labelling.survival_time.tolist() == longest_paths(model)


@settings(max_examples=200, deadline=None)
@given(kernels())
def test_horizons_and_safe_actions_follow_their_definitions(model: SafeMDP) -> None:
    result = classify(model)
    kernel = model.transitions().toarray().reshape(model.num_states, model.num_actions, -1)
    graph = nx.DiGraph([(int(s), int(t)) for s, _, t in zip(*np.nonzero(kernel), strict=True)])
    graph.add_nodes_from(range(model.num_states))
    start = int(np.flatnonzero(model.initial)[0])
    reached = nx.descendants(graph, start) | {start}
    for states, horizon, boundary in (
        (set(graph), result.horizon, result.boundary_horizon),
        (reached, result.reachable_horizon, result.reachable_boundary_horizon),
    ):
        times = [int(result.survival_time[s]) for s in states if result.dead[s]]
        expected = max(times, default=0)
        assert horizon == (None if expected == INFINITE else expected)
        entered = [
            int(result.survival_time[t])
            for s in states
            if result.paper_safe[s]
            for t in graph.successors(s)
            if not result.paper_safe[t]
        ]
        assert boundary == (max(entered) if entered and horizon is not None else None)
    mask = safe_actions(model, result)
    for s, a in np.ndindex(mask.shape):
        successors = np.flatnonzero(kernel[s, a])
        assert mask[s, a] == (len(successors) > 0 and bool(result.safe[successors].all()))


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_zero_one_kernels_are_labelled_as_their_tables(data: st.DataObject) -> None:
    num_states = data.draw(st.integers(1, 6))
    state = st.integers(0, num_states - 1)
    table = np.array(
        [[data.draw(state), data.draw(state | st.just(-1))] for _ in range(num_states)]
    )
    kinds = np.array([data.draw(st.sampled_from("....ft")) for _ in range(num_states)])
    initial = data.draw(state)
    fail, terminal = kinds == "f", kinds == "t"
    model = SafeMDP.deterministic(table, fail, terminal=terminal, initial=initial)
    kernel = SafeMDP.stochastic(
        model.transitions(), fail, model.available, terminal=terminal, initial=initial
    )
    one, other = classify(model), classify(kernel)
    assert np.array_equal(one.labels, other.labels)
    assert np.array_equal(one.survival_time, other.survival_time)
    assert (one.horizon, one.boundary_horizon) == (other.horizon, other.boundary_horizon)
    assert one.reachable_horizon == other.reachable_horizon
    assert one.reachable_boundary_horizon == other.reachable_boundary_horizon
    assert np.array_equal(safe_actions(model), safe_actions(kernel))


# Each: rows, number of states, fail; then labels, T and H as they should be.
SMALL = {
    "Assumption 1 fails: a dead state that may survive any number of steps": (
        ({0: [{1: 0.5, 0: 0.5}]}, 2, 1),
        ([D, F], [INFINITE, 0], None),
    ),
    "V* > 0 in S_safe": (
        ({0: [{2: 0.1, 1: 0.9}]}, 3, 2),
        ([R, S, F], [INFINITE, INFINITE, 0], 0),
    ),
    "no threshold separates: the state at risk has the greater V*": (
        ({0: [{3: 0.9, 2: 0.1}], 1: [{1: 0.99, 3: 0.01}]}, 4, 3),
        ([R, D, S, F], [INFINITE, INFINITE, INFINITE, 0], None),
    ),
    "Theorem 2 fails: a small risk, or staying": (
        ({0: [{1: 0.001, 0: 0.999}, {0: 1.0}]}, 2, 1),
        ([S, F], [INFINITE, 0], 0),
    ),
    "greedy on the discounted value chooses certain failure, slowly": (
        ({0: [{2: 0.1, 1: 0.9}, {2: 0.001, 0: 0.999}]}, 3, 2),
        ([R, S, F], [INFINITE, INFINITE, 0], 0),
    ),
    "greedy on the discounted value chooses certain failure, a step later": (
        ({0: [{3: 0.99, 2: 0.01}, {1: 1.0}], 1: [{3: 1.0}]}, 4, 3),
        ([R, D, S, F], [INFINITE, 1, INFINITE, 0], 1),
    ),
    "a choice with two bad successors is one choice less, not two": (
        ({0: [{2: 0.5, 1: 0.5}, {0: 1.0}], 1: [{2: 1.0}]}, 3, 2),
        ([S, D, F], [INFINITE, 1, 0], 1),
    ),
    "dead for certain, with chance only in how long it takes": (
        ({0: [{1: 0.5, 4: 0.5}], 1: [{2: 0.5, 4: 0.5}], 2: [{4: 1.0}]}, 5, 4),
        ([D, D, D, S, F], [3, 2, 1, INFINITE, 0], 3),
    ),
    "dead, but not on every path; and dead on every path": (
        ({0: [{0: 0.5, 1: 0.5}], 1: [{3: 1.0}]}, 4, 3),
        ([D, D, S, F], [INFINITE, 1, INFINITE, 0], None),
    ),
}


@pytest.mark.parametrize("name", SMALL)
def test_small_models_are_what_theory_says(name: str) -> None:
    arguments, (labels, time, horizon) = SMALL[name]
    result = classify(stochastic(*arguments))
    assert result.labels.tolist() == labels
    assert result.survival_time.tolist() == time
    assert result.horizon == horizon


def test_boundary_horizon_counts_dead_states_that_are_entered_by_chance() -> None:
    # State 0 is at risk: fail (T = 0), or 1 (dead, T = 2), or the goal.
    model = stochastic({0: [{4: 0.2, 1: 0.2, 3: 0.6}], 1: [{2: 1.0}], 2: [{4: 1.0}]}, 5, 4)
    result = classify(model)
    assert (result.horizon, result.boundary_horizon) == (2, 2)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (2, 2)
    assert not safe_actions(model).any(axis=1)[[0, 1, 2, 4]].any()


def test_reachable_horizons_exist_where_the_others_do_not() -> None:
    # 1 may survive any number of steps, but the start never meets it.
    model = stochastic({0: [{0: 1.0}, {2: 1.0}], 1: [{1: 0.5, 3: 0.5}], 2: [{3: 1.0}]}, 4, 3)
    result = classify(model)
    assert (result.horizon, result.boundary_horizon) == (None, None)
    assert (result.reachable_horizon, result.reachable_boundary_horizon) == (1, 1)


def test_probabilities_that_underflow_in_a_product_still_count() -> None:
    # The goal is reached with probability 1e-300 ** 3 = 0 in floating point.
    tiny = {s: [{s + 1: 1e-300, 4: 1 - 1e-300}] for s in range(3)}
    assert classify(stochastic(tiny, 5, 4)).labels.tolist() == [R, R, R, S, F]


# Beyond 32-bit integers


def test_choices_are_as_wide_as_they_need_to_be() -> None:
    """Numbers up to R - 1; a model of so many choices does not fit a test."""
    assert _width(1) is np.int32
    assert _width(2**31 - 1) is np.int32
    assert _width(2**31 + 1) is np.int64
    assert np.iinfo(_width(2**31)).max >= 2**31 - 1


def test_it_is_choices_that_are_numbered_not_states(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def wide(num_choices: int) -> type[np.int64]:
        asked.append(num_choices)
        return np.int64

    monkeypatch.setattr(qualitative, "_width", wide)
    model = stochastic({0: [{2: 0.1, 1: 0.9}, {0: 1.0}]}, 3, 2)
    assert qualitative.qualitative_labels(model).tolist() == [S, S, F]
    assert asked == [3 * 2]


@settings(max_examples=50, deadline=None)
@given(kernels())
def test_the_width_of_choices_changes_no_label(model: SafeMDP) -> None:
    kernel = model.transitions()
    available = np.diff(kernel.indptr) > 0
    found = []
    for width in (np.int32, np.int64):
        choices = np.full(kernel.nnz, -1, dtype=width)
        starts = _predecessors(kernel.indices, kernel.indptr, model.num_states, choices)
        zero = _p_min_zero(starts, choices, available, model.num_actions, model.fail)
        found.append((starts, choices, zero, _reaching(starts, choices, zero, model.num_actions)))
    for narrow, wide in zip(*found, strict=True):
        assert np.array_equal(narrow, wide)


def test_predecessors_are_the_transposed_kernel() -> None:
    """Rows 0 to 3 of two states: 0 -> {0, 2}, 1 -> {2}, 2 none, 3 -> {1, 2}."""
    indices, indptr = np.array([0, 2, 2, 1, 2], dtype=np.int32), np.array([0, 2, 3, 3, 5])
    choices = np.empty(5, dtype=np.int64)
    assert _predecessors(indices, indptr, 3, choices).tolist() == [0, 1, 2, 5]
    assert choices.tolist() == [0, 3, 0, 1, 3]


def test_only_what_leads_to_the_target_reaches_it() -> None:
    """1 -> 0, and a chain 99 -> 98 -> ... -> 2, with the target at its end."""
    chain = np.concatenate(([-1, 0, -1], np.arange(2, 99)))
    choices = np.array([np.flatnonzero(chain == t)[0] for t in range(100) if t in chain])
    starts = np.concatenate(([0], np.cumsum(np.isin(np.arange(100), chain))))
    reached = _reaching(starts, choices, np.arange(100) == 2, 1)
    assert np.array_equal(reached, np.arange(100) >= 2)


def test_a_stack_of_all_states_is_large_enough() -> None:
    """Nine states lead to the last; in plain Python, where every index is checked."""
    starts, choices, last = np.array([0] * 10 + [9]), np.arange(9), np.arange(10) == 9
    assert _reaching.py_func(starts, choices, last, 1).all()
    assert not _p_min_zero.py_func(starts, choices, np.arange(9) < 9, 1, last).any()


def test_rows_beyond_the_32_bit_integers_belong_to_their_states() -> None:
    """State 0 is reached from row 10^10 + 1 of state 1, which has 10^10 actions."""
    starts = np.array([0, 1, 1, 1])
    choices = np.array([10**10 + 1])
    reached = _reaching(starts, choices, np.array([True, False, False]), 10**10)
    assert reached.tolist() == [True, True, False]
