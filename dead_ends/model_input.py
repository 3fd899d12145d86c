"""What a safe MDP is built from, checked: one sentence about the first thing that is wrong.

Every array that is given back is read-only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "MAX_STATES",
    "ROW_SUM_TOLERANCE",
    "Names",
    "available_mask",
    "check_successors",
    "count_actions",
    "end_masks",
    "initial_distribution",
    "named",
    "read_only",
    "reward_table",
]

ROW_SUM_TOLERANCE = 1e-9
"""How far the probabilities of a row, given as floats, may be from summing to 1."""
MAX_STATES = int(np.iinfo(np.int32).max)

Scalar = TypeVar("Scalar", bound=np.generic)


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """The same array, which cannot be written to any more."""
    array.flags.writeable = False
    return array


def named(kind: str, index: int, names: Sequence[str] | None) -> str:
    """A state or an action for a sentence: its number, and its name if it has one."""
    return f"{kind} {index}" if names is None else f"{kind} {index} ({names[index]})"


class Names:
    """Checked names, and how an error names a place."""

    def __init__(
        self,
        states: Sequence[str] | None,
        actions: Sequence[str] | None,
        num_states: int,
        num_actions: int,
    ) -> None:
        self.states = _checked_names("state_names", states, num_states)
        self.actions = _checked_names("action_names", actions, num_actions)

    def state(self, state: int) -> str:
        """A state for a sentence."""
        return named("state", state, self.states)

    def pair(self, state: int, action: int) -> str:
        """A state and an action for a sentence."""
        return f"{self.state(state)}, {named('action', action, self.actions)}"


def _checked_names(what: str, names: Sequence[str] | None, count: int) -> tuple[str, ...] | None:
    if names is None:
        return None
    if len(names) != count:
        raise ValueError(f"{what}: expected {count} names, got {len(names)}")
    return tuple(str(name) for name in names)


def _mask(what: str, mask: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    array = np.asarray(mask)
    if array.dtype != np.bool_:
        raise ValueError(f"{what} must be a boolean mask, not {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"{what} must have shape {shape}, not {array.shape}")
    return read_only(array.copy())


def end_masks(
    fail: ArrayLike, terminal: ArrayLike | None, num_states: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """fail and terminal, each bool (S,); no state is both."""
    if num_states == 0:
        raise ValueError("a model needs at least one state")
    if num_states > MAX_STATES:
        raise ValueError(f"a model has at most {MAX_STATES} states, not {num_states}")
    fail_mask = _mask("fail", fail, (num_states,))
    if terminal is None:
        return fail_mask, read_only(np.zeros(num_states, dtype=np.bool_))
    terminal_mask = _mask("terminal", terminal, (num_states,))
    both = np.flatnonzero(fail_mask & terminal_mask)
    if len(both):
        raise ValueError(f"state {both[0]} is both fail and terminal; a violation is not a goal")
    return fail_mask, terminal_mask


def check_successors(
    table: NDArray[np.integer[Any]], ended: NDArray[np.bool_], names: Names
) -> None:
    """Every row that counts has its successors in range and at least one of them."""
    num_states = len(table)
    lowest, highest = int(table.min()), int(table.max())
    if lowest < -1 or highest >= num_states:  # perhaps only in a row that does not count
        bad = ((table < -1) | (table >= num_states)) & ~ended[:, None]
        if bad.any():
            state, action = (int(index) for index in np.argwhere(bad)[0])
            raise ValueError(
                f"{names.pair(state, action)}: successor {table[state, action]} is not a state "
                f"(0 to {num_states - 1}, or -1 for an action that is not available)"
            )
    if lowest < 0:
        stuck = ~ended
        for action in range(table.shape[1]):
            stuck &= table[:, action] < 0
        if stuck.any():
            raise _no_action(int(np.flatnonzero(stuck)[0]), names)


def _no_action(state: int, names: Names) -> ValueError:
    return ValueError(
        f"{names.state(state)} has no action and is neither fail nor terminal; "
        "if the episode ends there without harm, mark it in `terminal`"
    )


def count_actions(P: Any, num_states: int) -> int:
    """A, from the shape of transition probabilities."""
    shape = tuple(getattr(P, "shape", None) or np.shape(P))
    if len(shape) == 3:
        if shape[0] != num_states or shape[2] != num_states or shape[1] == 0:
            raise ValueError(f"P must have shape ({num_states}, A, {num_states}), not {shape}")
        return int(shape[1])
    if len(shape) != 2 or not hasattr(P, "tocsr"):
        raise ValueError(
            f"P must be dense with shape (S, A, S) or scipy.sparse with shape (S*A, S), not {shape}"
        )
    if shape[1] != num_states or shape[0] % num_states or shape[0] == 0:
        raise ValueError(f"P must have shape ({num_states}*A, {num_states}), not {shape}")
    return int(shape[0] // num_states)


def available_mask(
    available: ArrayLike | None,
    fail: NDArray[np.bool_],
    terminal: NDArray[np.bool_],
    num_actions: int,
    names: Names,
) -> NDArray[np.bool_]:
    """bool (S, A): the actions one can take; none in fail states, all in terminal ones."""
    shape = (len(fail), num_actions)
    if available is None:
        mask = np.ones(shape, dtype=np.bool_)
    else:
        mask = _mask("available", available, shape).copy()
    mask[terminal] = True
    stuck = np.flatnonzero(~mask.any(axis=1) & ~fail)
    if len(stuck):
        raise _no_action(int(stuck[0]), names)
    mask[fail] = False
    return read_only(mask)


def reward_table(
    rewards: ArrayLike | None, num_states: int, num_actions: int, names: Names
) -> NDArray[np.float64] | None:
    """float (S, A), or None."""
    if rewards is None:
        return None
    array = np.array(rewards, dtype=np.float64)
    if array.shape != (num_states, num_actions):
        raise ValueError(
            f"rewards must have shape ({num_states}, {num_actions}), not {array.shape}"
        )
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        state, action = (int(index) for index in bad[0])
        raise ValueError(
            f"{names.pair(state, action)}: reward {array[state, action]} is not finite"
        )
    return read_only(array)


def initial_distribution(initial: ArrayLike | None, num_states: int) -> NDArray[np.float64] | None:
    """The distribution of the first state, from indices, a mask or a distribution."""
    if initial is None:
        return None
    array = np.asarray(initial)
    distribution = np.zeros(num_states)
    if array.dtype == np.bool_:
        distribution[_mask("initial", array, (num_states,))] = 1.0
    elif np.issubdtype(array.dtype, np.integer):
        indices = np.atleast_1d(array)
        if len(indices) and (indices.min() < 0 or indices.max() >= num_states):
            raise ValueError(f"initial: states must lie in 0 to {num_states - 1}")
        distribution[indices] = 1.0
    else:
        return read_only(_distribution(array.astype(np.float64), num_states))
    if not distribution.any():
        raise ValueError("initial: at least one state is needed")
    return read_only(distribution / distribution.sum())


def _distribution(array: NDArray[np.float64], num_states: int) -> NDArray[np.float64]:
    if array.shape != (num_states,):
        raise ValueError(f"initial must have shape ({num_states},), not {array.shape}")
    bad = np.flatnonzero(~(array >= 0))
    if len(bad):
        raise ValueError(f"initial: state {bad[0]} has probability {array[bad[0]]}")
    if abs(array.sum() - 1) > ROW_SUM_TOLERANCE:
        raise ValueError(f"initial: probabilities sum to {array.sum()}, not 1")
    return array.copy()
