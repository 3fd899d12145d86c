"""What models are built from: each sentence names the first place, each array is read-only."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.model.checks import (
    MAX_STATES,
    ROW_SUM_TOLERANCE,
    Names,
    available_mask,
    check_successors,
    count_actions,
    end_masks,
    initial_distribution,
    named,
    reward_table,
)

NAMES = Names(["a", "b", "c", "d"], ["x", "y"], 4, 2)


def mask(count: int, *places: int) -> NDArray[np.bool_]:
    return np.isin(np.arange(count), places)


def test_names_of_places() -> None:
    assert named("state", 1, ["a", "b"]) == "state 1 (b)"
    assert named("action", 1, None) == "action 1"
    assert NAMES.state(2) == "state 2 (c)"
    assert NAMES.pair(3, 1) == "state 3 (d), action 1 (y)"
    assert Names(None, None, 2, 2).pair(1, 0) == "state 1, action 0"
    assert Names([1, 2], None, 2, 3).states == ("1", "2")  # type: ignore[list-item]  # they become text
    for given, message in (
        ((["a"], None), "state_names: expected 2 names, got 1"),
        ((None, ["x"] * 4), "action_names: expected 3 names, got 4"),
    ):
        with pytest.raises(ValueError, match=f"^{message}$"):
            Names(*given, 2, 3)


def test_ends_are_copies_and_the_first_contradiction_is_named() -> None:
    given = mask(3, 1)
    fail, terminal = end_masks(given, None, 3)
    given[0] = True
    assert fail.tolist() == [False, True, False]
    assert terminal.tolist() == [False, False, False]
    for array in (fail, terminal):
        assert array.dtype == np.bool_
        assert not array.flags.writeable
    assert end_masks(mask(3, 1), mask(3, 2), 3)[1].tolist() == [False, False, True]
    assert len(end_masks([True], None, 1)[0]) == 1
    with pytest.raises(ValueError, match=r"^state 1 is both fail and terminal; a violation is not"):
        end_masks(mask(4, 0, 1, 3), mask(4, 1, 2, 3), 4)
    with pytest.raises(ValueError, match=r"^a model needs at least one state$"):
        end_masks(mask(0), None, 0)
    with pytest.raises(ValueError, match=r"^terminal must have shape \(3,\), not \(4,\)$"):
        end_masks(mask(3), mask(4), 3)


def test_states_are_counted_in_32_bits() -> None:
    """Refused before a mask of that length is looked at; one less is only a wrong shape."""
    with pytest.raises(ValueError, match=rf"^a model has at most {2**31 - 1} states, not {2**31}$"):
        end_masks(mask(1), None, 2**31)
    assert MAX_STATES == 2**31 - 1
    with pytest.raises(ValueError, match=rf"^fail must have shape \({2**31 - 1},\), not \(1,\)$"):
        end_masks(mask(1), None, 2**31 - 1)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            [[0, -1], [1, 4], [-2, 9], [0, 0]],
            r"state 1 \(b\), action 1 \(y\): successor 4 is not a",
        ),
        (
            [[0, -1], [-2, 4], [9, 9], [0, 0]],
            r"state 1 \(b\), action 0 \(x\): successor -2 is not a",
        ),
        ([[0, 0], [0, 0], [0, 0], [0, 4]], r"state 3 \(d\), action 1 \(y\): .*\(0 to 3, or -1 for"),
        ([[0, 0], [-1, -1], [-1, -1], [0, 4]], r"state 3 \(d\), action 1 \(y\): successor 4"),
        ([[-1, 3], [-1, -1], [3, -1], [-1, -1]], r"state 1 \(b\) has no action and is neither"),
        ([[-1, -1], [0, 0], [-1, -1], [0, 0]], r"state 0 \(a\) has no action and is neither"),
    ],
)
def test_the_first_successor_that_is_none_is_named(table: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        check_successors(np.array(table), mask(4), NAMES)


def test_rows_that_do_not_count_may_hold_anything() -> None:
    table = np.array([[-9, 99], [0, 3], [-1, -1], [-1, 3]])
    check_successors(table, mask(4, 0, 2), NAMES)
    for ended, message in (
        (mask(4, 2), "state 0 .*successor -9"),
        (mask(4, 0), "state 2 .* has no"),
    ):
        with pytest.raises(ValueError, match=f"^{message}"):
            check_successors(table, ended, NAMES)


@pytest.mark.parametrize(
    ("P", "actions"),
    [
        (np.zeros((3, 2, 3)), 2),
        (np.zeros((3, 1, 3)), 1),
        (sparse.csr_array((6, 3)), 2),
        (sparse.csr_array((3, 3)), 1),
    ],
)
def test_actions_are_counted(P: Any, actions: int) -> None:
    assert count_actions(P, 3) == actions


@pytest.mark.parametrize(
    ("P", "message"),
    [
        (np.zeros((3, 0, 3)), "P must have shape (3, A, 3), not (3, 0, 3)"),
        (np.zeros((4, 2, 3)), "P must have shape (3, A, 3), not (4, 2, 3)"),
        (np.zeros((3, 2, 4)), "P must have shape (3, A, 3), not (3, 2, 4)"),
        (np.zeros((2, 3, 3)), "P must have shape (3, A, 3), not (2, 3, 3)"),
        (
            np.zeros((6, 3)),
            "dense with shape (S, A, S) or scipy.sparse with shape (S*A, S), not (6",
        ),
        (np.zeros(3), "dense with shape (S, A, S) or scipy.sparse with shape (S*A, S), not (3,)"),
        (sparse.csr_array((6, 4)), "P must have shape (3*A, 3), not (6, 4)"),
        (sparse.csr_array((7, 3)), "P must have shape (3*A, 3), not (7, 3)"),
        (sparse.csr_array((0, 3)), "P must have shape (3*A, 3), not (0, 3)"),
    ],
)
def test_shapes_of_probabilities(P: Any, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        count_actions(P, 3)


def test_what_can_be_done_where() -> None:
    """Everything in goals, nothing in fail states, and something elsewhere."""
    given = np.array([[True, False], [False, False], [True, True], [False, True]])
    found = available_mask(given, mask(4, 2), mask(4, 1), 2, NAMES)
    assert found.tolist() == [[True, False], [True, True], [False, False], [False, True]]
    assert not found.flags.writeable
    assert given.tolist()[1:3] == [[False, False], [True, True]]
    every = available_mask(None, mask(4, 2), mask(4, 1), 2, NAMES)
    assert found.dtype == every.dtype == np.bool_
    assert every.tolist() == [[True, True], [True, True], [False, False], [True, True]]
    with pytest.raises(ValueError, match=r"^state 1 \(b\) has no action and is neither fail nor"):
        available_mask(np.zeros((4, 2), dtype=bool), mask(4, 0), mask(4, 2), 2, NAMES)
    with pytest.raises(ValueError, match=r"^available must have shape \(4, 2\), not \(4, 3\)$"):
        available_mask(np.ones((4, 3), dtype=bool), mask(4, 0), mask(4, 2), 2, NAMES)


def test_rewards_are_copied_and_the_first_that_is_not_finite_is_named() -> None:
    given = np.arange(8, dtype=np.float64).reshape(4, 2)
    found = reward_table(given, 4, 2, NAMES)
    assert found is not None
    assert not found.flags.writeable
    given[2, 1] = np.inf
    assert found[2, 1] == 5
    given[3, 0] = np.nan
    with pytest.raises(
        ValueError, match=r"^state 2 \(c\), action 1 \(y\): reward inf is not finite$"
    ):
        reward_table(given, 4, 2, NAMES)
    with pytest.raises(ValueError, match=r"^rewards must have shape \(4, 2\), not \(2, 4\)$"):
        reward_table(given.T, 4, 2, NAMES)
    assert reward_table(None, 4, 2, NAMES) is None
    whole = reward_table([[1, 2]] * 4, 4, 2, NAMES)
    assert whole is not None
    assert whole.dtype == np.float64


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (0, [1, 0, 0, 0]),
        (3, [0, 0, 0, 1]),
        ([3, 3, 0], [0.5, 0, 0, 0.5]),
        (mask(4, 1, 2), [0, 0.5, 0.5, 0]),
        (mask(4, 3), [0, 0, 0, 1]),
        ([0.25, 0.0, 0.75, 0.0], [0.25, 0, 0.75, 0]),
        ([0.5, 0.5 + ROW_SUM_TOLERANCE / 2, 0, 0], [0.5, 0.5 + ROW_SUM_TOLERANCE / 2, 0, 0]),
    ],
)
def test_where_an_episode_begins(given: Any, expected: list[float]) -> None:
    found, mended = initial_distribution(given, 4)
    assert found is not None
    assert (found.tolist(), mended) == (expected, 0)
    assert found.dtype == np.float64
    assert not found.flags.writeable


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (4, "initial: states must lie in 0 to 3"),
        (-1, "initial: states must lie in 0 to 3"),
        ([0, -1], "initial: states must lie in 0 to 3"),
        ([1, 4], "initial: states must lie in 0 to 3"),
        (np.array([], dtype=np.int64), "initial: at least one state is needed"),
        (mask(4), "initial: at least one state is needed"),
        (mask(3, 0), "initial must have shape (4,), not (3,)"),
        ([0.5, 0.5], "initial must have shape (4,), not (2,)"),
        ([1.0, -0.5, -0.25, 0.75], "initial: state 1 has probability -0.5"),
        ([1.0, 0.0, float("nan"), -1.0], "initial: state 2 has probability nan"),
        ([0.5, 0.25, 0, 0], "initial: probabilities sum to 0.75, not 1"),
        ([0.75, 0.5, 0, 0], "initial: probabilities sum to 1.25, not 1"),
        ([0.5, 0.5 + 2 * ROW_SUM_TOLERANCE, 0, 0], "initial: probabilities sum to 1.000000002"),
    ],
)
def test_no_episode_begins_like_that(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        initial_distribution(given, 4)


def test_an_initial_distribution_is_copied() -> None:
    given = np.array([0.5, 0.5])
    found, _ = initial_distribution(given, 2)
    given[0] = 0.0
    assert found is not None
    assert found.tolist() == [0.5, 0.5]
    assert initial_distribution(None, 2) == (None, 0)
    assert ROW_SUM_TOLERANCE == 1e-9
