"""From lists of transitions to models: violations, ends of episodes, storage forms."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from dead_ends.io.errors import NoFailureWarning, located
from dead_ends.io.transitions import Transitions, build_model, state_mask
from dead_ends.model.safe_mdp import Geometry


def listed(rows: list[tuple[Any, ...]], num_states: int, **more: Any) -> Transitions:
    """Rows (s, a, s', probability, reward, done)."""
    source, action, target, probability, reward, done = zip(*rows, strict=True)
    exact = isinstance(probability[0], Fraction)
    none = np.zeros(num_states, dtype=np.bool_)
    return Transitions(
        source=np.array(source),
        action=np.array(action),
        target=np.array(target),
        probability=np.array(probability, dtype=object if exact else np.float64),
        reward=np.array(reward, dtype=np.float64),
        done=np.array(done),
        num_actions=max(action) + 1,
        **{"fail": none, "terminal": none, **more},
    )


CHAIN = [
    (0, 0, 1, 1.0, 0.0, False),
    (0, 1, 0, 1.0, -1.0, False),
    (1, 0, 2, 1.0, 5.0, True),
    (1, 1, 0, 1.0, -100.0, False),
    (2, 0, 2, 1.0, 0.0, True),
]


def test_a_goal_that_only_ends_becomes_terminal() -> None:
    model = build_model(listed(CHAIN, 3))
    assert model.num_states == 3
    assert model.terminal.tolist() == [False, False, True]
    assert model.next_state is not None
    assert model.next_state[:2].tolist() == [[1, 0], [2, 0]]


def test_a_goal_that_loops_is_a_goal() -> None:
    """Tables often keep the agent at the goal, as if the episode went on there."""
    rows = [(0, 0, 1, 1.0, 1, True), (1, 0, 1, 1.0, 0, False)]
    assert build_model(listed(rows, 2)).terminal.tolist() == [False, True]


@pytest.mark.parametrize(
    "changed",
    [
        {"rows": [*CHAIN, (2, 1, 1, 1.0, 0.0, False), (0, 2, 2, 1.0, 0.0, False)]},
        {"rows": CHAIN, "initial": np.array([0.5, 0.0, 0.5])},
    ],
    ids=["entered and continued", "an episode starts there"],
)
def test_otherwise_the_episode_ends_in_an_added_state(changed: dict[str, Any]) -> None:
    """The target's own actions must count when the episode goes on there, and only then."""
    model = build_model(listed(changed.pop("rows"), 3, **changed))
    assert model.num_states == 4
    assert model.terminal.tolist() == [False, False, False, True]
    assert model.successors()[1, 0] == 3
    assert model.successors()[2, 0] == 3, "its own loop ends the episode too"


def test_a_loop_that_ends_does_not_make_its_state_a_goal() -> None:
    """No other transition enters state 2; whoever starts there may still choose action 1."""
    rows = [(0, 0, 0, 1.0, 0, False), (2, 0, 2, 1.0, 0, True), (2, 1, 1, 1.0, 0, False)]
    model = build_model(
        listed([*rows, (1, 0, 1, 1.0, 0, False)], 3, fail=np.array([False, True, False]))
    )
    assert model.terminal.tolist() == [False, False, False, True]
    assert model.successors()[2].tolist() == [3, 1]


def test_what_a_fail_state_does_afterwards_does_not_count() -> None:
    """Fail rows of tables often loop or restart: state 1 -> 2 would keep 2 from being a goal."""
    rows = [(0, 0, 2, 1.0, 0, True), (0, 1, 1, 1.0, 0, True), (1, 0, 2, 1.0, 0, False)]
    model = build_model(
        listed([*rows, (2, 0, 0, 1.0, 0, False)], 3, fail=np.array([False, True, False]))
    )
    assert model.num_states == 3
    assert model.terminal.tolist() == [False, False, True]


@pytest.mark.parametrize("condition", ["r <= -100", lambda *row: row[0] == 1 and row[3] == 0])
def test_violating_transitions_lead_to_an_added_fail_state(condition: Any) -> None:
    extra = {
        "initial": np.array([1.0, 0.0, 0.0]),
        "state_names": ("a", "b", "c"),
        "geometry": Geometry(cell=np.zeros((3, 2))),
    }
    model = build_model(listed(CHAIN, 3, **extra), condition)
    assert model.fail.tolist() == [False, False, False, True]
    assert model.successors()[1].tolist() == [2, 3]
    assert model.initial is not None
    assert model.initial.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert model.state_names == ("a", "b", "c", "fail")
    assert model.geometry is not None
    assert model.geometry.cell[3].tolist() == [-1, -1]
    assert model.rewards is not None
    assert model.rewards.tolist() == [[0, -1], [5, -100], [0, 0], [0, 0]]


def test_a_violation_that_also_ends_the_episode_is_a_violation() -> None:
    model = build_model(listed(CHAIN, 3), "r == 5 and done")
    assert model.fail.tolist() == [False, False, False, True, False]
    assert model.successors()[1, 0] == 3
    assert model.terminal.tolist() == [False, False, False, False, True]


def test_rewards_are_expected_rewards() -> None:
    rows = [(0, 0, 0, 0.25, 8.0, False), (0, 0, 1, 0.75, 4.0, False), (1, 0, 1, 1.0, 0, False)]
    model = build_model(listed(rows, 2))
    assert not model.is_deterministic
    assert model.rewards is not None
    assert model.rewards[0, 0] == 5.0


def test_impossible_transitions_do_not_count() -> None:
    rows = [(0, 0, 0, 1.0, 0, False), (0, 0, 1, 0.0, 0, False), (1, 0, 1, 1.0, 0, False)]
    model = build_model(listed(rows, 2))
    assert model.is_deterministic
    assert model.next_state is not None
    assert model.next_state.tolist() == [[0], [1]]


def test_parts_of_one_successor_add_up_exactly() -> None:
    third = Fraction(1, 3)
    rows = [(0, 0, 1, third, 0, False), (0, 0, 1, third, 0, False), (0, 0, 0, third, 0, False)]
    model = build_model(listed([*rows, (1, 0, 1, Fraction(1), 0, False)], 2))
    assert model.exact == (third, 2 * third, Fraction(1))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((0, 0, 7, 1.0, 0, False), "state 0, action 0: successor 7 does not exist"),
        ((0, 0, -1, 1.0, 0, False), "state 0, action 0: successor -1 does not exist"),
        ((9, 0, 0, 1.0, 0, False), "state 9, action 0: state 9 does not exist"),
        ((0, -2, 0, 1.0, 0, False), "state 0, action -2: action -2 does not exist"),
        ((0, 1, 0, -0.5, 0, False), "state 0, action 1: negative probability -0.5"),
        ((0, 0, 0, 0.5, 0, False), "state 0, action 0: probabilities sum to 1.5"),
        ((0, 1, 0, np.nan, 0, False), "state 0, action 1: probability nan"),
    ],
)
def test_bad_transitions_are_named(row: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build_model(listed([*CHAIN, row], 3))


def test_conditions_need_their_columns() -> None:
    transitions = replace(listed(CHAIN, 3), reward=None, done=None)
    with pytest.raises(ValueError, match="unknown name 'r'"):
        build_model(transitions, "r > 0")
    with pytest.raises(ValueError, match="the condition needs rewards"):
        build_model(transitions, lambda *row: not any(row))
    model = build_model(transitions, "s2 == 2")
    assert model.rewards is None
    assert model.fail.tolist() == [False, False, False, True]


def test_state_mask() -> None:
    assert state_mask([2, 0], 3).tolist() == [True, False, True]
    assert state_mask(np.array([True, False]), 2).tolist() == [True, False]
    for states, message in (([3], "3 is not a state"), ([-1], "-1 is not"), ([0.5], "0.5 is not")):
        with pytest.raises(ValueError, match=f"fail states: {message}"):
            state_mask(states, 3)
    with pytest.raises(ValueError, match=r"^fail_states\[1\] is masked, and must be known$"):
        state_mask(np.ma.array([True, False], mask=[False, True]), 2)
    with pytest.raises(ValueError, match=r"a mask must have shape \(3,\)"):
        state_mask([True], 3)


@pytest.mark.parametrize(
    ("condition", "said"), [("r <= -1000", "'r <= -1000'"), (lambda *_: False, "the condition")]
)
def test_a_condition_that_never_holds_is_said(condition: Any, said: str) -> None:
    with located("here"), pytest.warns(NoFailureWarning, match=f"^here: no .* satisfies {said}"):
        model = build_model(listed(CHAIN, 3), condition)
    assert not model.fail.any()


def test_a_condition_that_holds_in_a_fail_state_anyway_is_none_that_never_holds() -> None:
    build_model(listed(CHAIN, 3, fail=np.array([False, False, True])), "s2 == 2")


@pytest.mark.parametrize("states", [[], np.zeros(3, dtype=np.bool_)])
def test_no_state_is_said(states: Any) -> None:
    with pytest.warns(NoFailureWarning, match="^no state is .* in fail_states, so that"):
        assert not state_mask(states, 3).any()
