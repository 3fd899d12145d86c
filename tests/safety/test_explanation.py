"""Explanations: every witness is followed through the model and found to be one."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dead_ends.envs.bridge import bridge
from dead_ends.envs.lifegate import lifegate
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.labels.labelling import INFINITE, Label
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.explanation import Explanation, Path, explain, state_index


@st.composite
def models(draw: st.DrawFn) -> SafeMDP:
    """Up to seven states: deterministic, or with even chances between a few successors."""
    n, m = draw(st.integers(2, 7)), draw(st.integers(1, 3))
    num_fail, num_goals = draw(st.integers(1, n - 1)), draw(st.integers(0, 1))
    fail = np.arange(n) >= n - num_fail
    terminal = (np.arange(n) == 0) & (num_goals == 1)
    state = st.integers(0, n - 1)
    if draw(st.booleans()):
        rows = st.lists(state, min_size=m, max_size=m)
        table = np.array(draw(st.lists(rows, min_size=n, max_size=n)), dtype=np.int32)
        return SafeMDP.deterministic(table, fail, terminal=terminal)
    P = np.zeros((n, m, n))
    for index in np.ndindex(n, m):
        successors = draw(st.sets(state, min_size=1, max_size=2))
        P[index][list(successors)] = 1 / len(successors)
    return SafeMDP.stochastic(P, fail, terminal=terminal)


def assert_is_path(model: SafeMDP, path: Path) -> None:
    assert len(path.actions) == len(path.states) - 1
    kernel = model.transitions()
    for (state, successor), action in zip(pairwise(path.states), path.actions, strict=True):
        assert model.available[state, action]
        assert kernel[[state * model.num_actions + action]].toarray()[0, successor] > 0


def assert_explains(model: SafeMDP, state: int) -> Explanation:
    labelling = classify(model)
    result = explain(model, state, labelling)
    assert result.state == state
    assert result.label == labelling.labels[state]
    assert_is_path(model, result.path)
    assert result.path.states[0] == state
    assert (result.safe_path is None) == (result.p_min is None)
    assert (result.safe_path is None) == (result.label is not Label.AT_RISK)
    last = result.path.states[-1]
    if result.label is Label.FAIL:
        assert result.path.states == (state,)
        assert result.survival_time == 0
    elif result.label is Label.SAFE:
        stays = safe_actions(model, labelling)
        taken = zip(result.path.states, result.path.actions, strict=False)
        assert all(stays[s, a] for s, a in taken)
        if result.path.cycle_start is None:
            assert model.terminal[last]
        else:
            assert result.path.states.index(last) == result.path.cycle_start
        assert result.action == (None if model.terminal[state] else result.path.actions[0])
    else:
        assert model.fail[last]
        assert result.path.cycle_start is None
    if result.label is Label.DEAD:
        time = int(labelling.survival_time[state])
        assert result.survival_time == (None if time == INFINITE else time)
        if result.survival_time is not None:
            assert len(result.path.actions) == time
            assert result.action == result.path.actions[0]
    if result.safe_path is not None:
        assert_is_path(model, result.safe_path)
        assert labelling.safe[result.safe_path.states[-1]]
        assert not labelling.safe[list(result.safe_path.states[:-1])].any()
        assert result.p_min is not None
        assert 0 < result.p_min[0] <= result.p_min[1] < 1
        assert result.action == result.path.actions[0]
    return result


def test_every_public_name_is_what_it_says_and_no_module() -> None:
    """A module with the name of its function would hide it."""
    command = (
        "from types import ModuleType; import dead_ends; from dead_ends import *; "
        "print([name for name in dead_ends.__all__ if isinstance(globals()[name], ModuleType)])"
    )
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, check=True)
    assert done.stdout.decode().strip() == "[]"


@settings(deadline=None)  # the first labelling compiles
@given(models())
def test_every_witness_is_one(model: SafeMDP) -> None:
    for state in range(model.num_states):
        text = assert_explains(model, state).text
        assert text.startswith(f"State {state} is ")
        assert text.endswith(".")


def test_a_dead_state_survives_longest() -> None:
    # 0 -> 1 or 3; 1 -> 2 or 3; 2 -> 3, which is fail.
    table = np.array([[3, 1], [3, 2], [3, 3], [3, 3]], dtype=np.int32)
    names = ["brink", "edge", "slope", "ground"]
    model = SafeMDP.deterministic(table, np.arange(4) == 3, state_names=names)
    result = assert_explains(model, 0)
    assert result.path == Path((0, 1, 2, 3), (1, 1, 0))
    assert result.text == (
        "State 0 (brink) is dead: whatever the agent does, it fails within 3 steps. "
        "The longest surviving path is (brink) -> (edge) -> (slope) -> (ground)."
    )
    assert "it fails in the next step." in explain(model, "slope").text
    assert explain(model, 3).text == (
        "State 3 (ground) is fail: the violation has happened and the episode is over."
    )


def test_a_safe_state_stays_or_ends_or_goes_round() -> None:
    # 0 -> 1 -> 2 -> 1; 3 -> 4, a goal; 5 stays; 6 is fail.
    table = np.array([[6, 1], [2, 6], [1, 6], [4, 6], [0, 0], [5, 6], [6, 6]], dtype=np.int32)
    states = np.arange(7)
    model = SafeMDP.deterministic(
        table, states == 6, terminal=states == 4, action_names=["left", "right"]
    )
    assert explain(model, 0).text == (
        "State 0 is safe: action 1 (right) keeps it safe. "
        "The way on is 0 -> 1 -> 2 -> 1, which closes a cycle of 2 steps."
    )
    assert explain(model, 0).path == Path((0, 1, 2, 1), (1, 0, 0), 1)
    assert explain(model, 3).text == (
        "State 3 is safe: action 0 (left) keeps it safe. "
        "The way on is 3 -> 4, where the episode ends without a violation."
    )
    assert explain(model, 4).text == (
        "State 4 is safe: it is terminal, the episode ends there without a violation."
    )
    assert explain(model, 5).text.endswith("The way on is 5 -> 5, where it can stay for ever.")


def test_a_state_at_risk_has_bounds_and_both_paths() -> None:
    """s: {0.1 fail, 0.9 goal; 0.001 fail, 0.999 s}: P_min = 0.1 by the first action."""
    P = np.zeros((3, 2, 3))
    P[0, 0, [1, 2]] = 0.1, 0.9
    P[0, 1, [1, 0]] = 0.001, 0.999
    states = np.arange(3)
    model = SafeMDP.stochastic(P, states == 1, terminal=states == 2)
    result = assert_explains(model, 0)
    assert result.p_min is not None
    assert result.p_min[0] <= 0.1 <= result.p_min[1]
    assert result.action == 0
    assert result.path == Path((0, 1), (0,))
    assert result.safe_path == Path((0, 2), (0,))
    assert result.text == (
        "State 0 is at risk: acting best it fails with probability 0.1, beginning with "
        "action 0. Even so it may fail, by 0 -> 1; it may reach safety by 0 -> 2."
    )


def test_a_dead_state_may_survive_any_number_of_steps() -> None:
    model = lifegate()
    state = int(np.flatnonzero(classify(model).dead)[0])
    result = assert_explains(model, state)
    assert result.survival_time is None
    assert "fails with probability 1, although there is no bound" in result.text


def test_all_states_of_the_benchmarks_are_explained() -> None:
    for model in (bridge(), lifegate()):
        for state in range(0, model.num_states, 7):
            assert_explains(model, state)


def test_a_long_path_is_whole_in_the_field_and_short_in_the_text() -> None:
    n = 1000
    table = np.minimum(np.arange(n) + 1, n - 1)[:, None].astype(np.int32)
    result = explain(SafeMDP.deterministic(table, np.arange(n) == n - 1), 0)
    assert result.path.states == tuple(range(n))
    assert "is 0 -> 1 -> 2 -> ... 994 more ... -> 997 -> 998 -> 999." in result.text


def named(names: list[str] | None) -> SafeMDP:
    return SafeMDP.deterministic(
        np.array([[0], [1], [2]]), np.array([False] * 3), state_names=names
    )


def test_states_go_by_index_or_name() -> None:
    assert [state_index(named(["a", "2", "c"]), state) for state in ("c", "2", "0", 2)] == [
        2,
        1,
        0,
        2,
    ]
    assert state_index(named(None), np.int64(1)) == 1
    assert explain(named(["a", "b", "c"]), "b").state == 1


@pytest.mark.parametrize(
    ("names", "state", "message"),
    [
        (None, 3, "state 3: states are numbered 0 to 2"),
        (None, -1, "state -1: states are numbered 0 to 2"),
        (None, "a", "state a: states are numbered 0 to 2"),
        (None, True, "state True: states are numbered 0 to 2"),
        (None, 1.0, "state 1.0: states are numbered 0 to 2"),
        (["a", "b", "c"], "d", "state d: states are numbered 0 to 2 and no state has that name"),
        (
            ["a", "b", "a"],
            "a",
            "state a: 2 states have that name, such as 0 and 2; give the number",
        ),
    ],
)
def test_unknown_states_are_named(names: list[str] | None, state: int | str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        explain(named(names), state)


def test_a_state_that_seldom_moves_is_explained() -> None:
    """Probabilities near 1 are known to a few digits only where the agent stays for long."""
    P = np.zeros((3, 1, 3))
    P[0, 0] = [1 - 2e-6, 1e-6, 1e-6]
    explanation = explain(SafeMDP.stochastic(P, np.arange(3) == 1, terminal=np.arange(3) == 2), 0)
    assert explanation.label is Label.AT_RISK
    assert explanation.p_min is not None
    lower, upper = explanation.p_min
    assert lower <= 0.5 <= upper <= lower + 1e-6
