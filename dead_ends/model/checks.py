"""What a safe MDP is built from, checked: one sentence about the first thing that is wrong.

Every array that is given back is read-only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "MAX_STATES",
    "ROW_SUM_TOLERANCE",
    "ExactEntries",
    "Names",
    "available_mask",
    "available_rows",
    "check_successors",
    "count_actions",
    "end_masks",
    "initial_distribution",
    "mend_rows",
    "mendable",
    "named",
    "not_one",
    "plain_array",
    "read_fraction",
    "read_only",
    "reward_table",
    "shown",
    "successor_table",
    "transition_array",
]

ROW_SUM_TOLERANCE = 1e-9
"""How far the probabilities of a row, given as floats, may be from summing to 1."""
ROUNDED = 0.5001e-6
"""How far each of its entries may be off, where one asks for rows to be divided by their sums: by
rounding to six digits, or to single precision."""
MAX_STATES = int(np.iinfo(np.int32).max)
MAX_BITS = 10_000
"""No numerator or denominator is longer: sums and products of such numbers still end soon."""

Scalar = TypeVar("Scalar", bound=np.generic)
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ExactEntries:
    """A kernel (S*A, S) in Fractions, too sparse for a dense array.

    Attributes:
        row, column, value: (N,) P(column | row s*A + a) = value; entries of one place add up.
        shape: (S*A, S).
    """

    row: Integers
    column: Integers
    value: NDArray[np.object_]
    shape: tuple[int, int]


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
        self.num_states, self.num_actions = num_states, num_actions

    def state(self, state: int) -> str:
        """A state for a sentence."""
        return named("state", state, self.states)

    def action(self, action: int) -> str:
        """An action for a sentence."""
        return named("action", action, self.actions)

    def pair(self, state: int, action: int) -> str:
        """A state and an action for a sentence."""
        return f"{self.state(state)}, {self.action(action)}"


def _checked_names(what: str, names: Sequence[str] | None, count: int) -> tuple[str, ...] | None:
    if names is None:
        return None
    names = list(names)
    if len(names) != count:
        raise ValueError(f"{what}: expected {count} names, got {len(names)}")
    return tuple(str(name) for name in names)


def plain_array(what: str, values: Any) -> NDArray[Any]:
    """The values as an array; refused where one of them is masked, for there is none then.

    Raises:
        ValueError: naming ``what``.
    """
    array = _array(what, values)
    if np.ma.isMaskedArray(array) and np.ma.getmaskarray(array).any():
        place = ", ".join(map(str, np.argwhere(np.ma.getmaskarray(array))[0]))
        raise ValueError(f"{what}[{place}] is masked, and must be known")
    return np.asarray(array)


def _array(what: str, values: Any) -> NDArray[Any]:
    """The values as an array, with their mask if they have one."""
    masked = isinstance(values, list | tuple) and any(np.ma.isMaskedArray(row) for row in values)
    try:
        return np.ma.array(values) if masked else np.asanyarray(values)
    except ValueError as error:
        raise ValueError(f"{what} is not an array: {error}") from None


def read_fraction(text: str) -> Fraction:
    """A Fraction from text such as 1/3, 0.25 or 1e-9.

    Raises:
        ValueError: if it is none, or one whose digits would fill pages.
    """
    exponent = text.lower().partition("e")[2].strip().lstrip("+-")
    if len(text) > MAX_BITS or (exponent.isdecimal() and int(exponent) > MAX_BITS // 4):
        raise ValueError(f"'{text[:40]}...' has too many digits")
    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f"'{text if len(text) < 80 else text[:40] + '...'}' is not a fraction"
        ) from None


def mendable(total: Any, entries: Any) -> Any:
    """Whether a sum of so many rounded probabilities misses 1 by no more than their rounding.

    Within 1e-6 for one or two entries, within 5e-7 an entry for more.
    """
    return abs(total - 1) <= ROUNDED * np.maximum(entries, 2)


def not_one(total: Any, entries: int) -> str:
    """What to say of probabilities whose sum should be 1, with what mends it if anything does."""
    exactly = "exactly " if isinstance(total, Fraction) else ""
    hint = "; normalise=True (--normalise) divides such probabilities by their sum"
    what = f"probabilities sum to {shown(total)}, not {exactly}1"
    return what + hint if mendable(total, entries) else what


def shown(number: Any) -> str:
    """A number for a sentence."""
    if not isinstance(number, Fraction):
        return f"{number:.12g}"
    if max(number.numerator.bit_length(), number.denominator.bit_length()) <= 200:
        return str(number)
    exponent = number.numerator.bit_length() - number.denominator.bit_length()
    return (
        f"about {float(number):.12g}"
        if exponent < 1000
        else f"about {'-' * (number < 0)}2**{exponent}"
    )


def mend_rows(row: Integers, probability: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Divide each row that misses 1 by its entries' rounding (:func:`mendable`) by its sum.

    Args:
        row: (N,) the row of each probability, from 0.
        probability: (N,) floats or Fractions; the other rows stay as they are.

    Returns:
        (N,) the probabilities, and the number of rows that were divided.
    """
    if not len(row):
        return probability, 0
    exact = probability.dtype == object
    if exact:
        total = np.zeros(int(row.max()) + 1, dtype=object)
        np.add.at(total, row, probability)
    else:
        total = np.bincount(row, probability)
    wrong = abs(total - 1) > ROW_SUM_TOLERANCE * (not exact)
    entries = np.bincount(row[probability != 0], minlength=len(total))
    mended = (wrong & mendable(total, entries)).astype(np.bool_)
    inside = mended[row]
    result = probability.copy()
    result[inside] /= total[row[inside]]
    return result, int(np.count_nonzero(mended))


def _mask(what: str, mask: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    array = plain_array(what, mask)
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


def successor_table(next_state: ArrayLike, fail: ArrayLike) -> NDArray[Any]:
    """Integers (S, A); masked actions are -1, not available.

    Raises:
        ValueError: if it is none, or looks like (A, S).
    """
    table = _array("next_state", next_state)
    states = plain_array("fail", fail).shape
    if table.ndim != 2 or table.shape[1] == 0:
        raise ValueError(
            f"next_state must have shape (S, A) with at least one action, not {table.shape}"
        )
    if table.dtype.kind not in "iu":
        raise ValueError(f"next_state must hold integers, not {table.dtype}")
    if table.shape[0] != table.shape[1] and states == table.shape[1:]:
        raise ValueError(
            f"fail must have shape ({table.shape[0]},), not {table.shape[1:]}; "
            "if next_state is (A, S), pass next_state.T"
        )
    if np.ma.isMaskedArray(table):
        values = np.asarray(table)
        signed = np.where(values > MAX_STATES, MAX_STATES, values.astype(np.int64))
        return np.where(np.ma.getmaskarray(table), -1, signed)
    return np.asarray(table)


def transition_array(P: Any) -> Any:
    """P as it is if it is sparse, else as an array, with its mask if it has one."""
    if isinstance(P, list | tuple) and any(hasattr(part, "tocsr") for part in P):
        raise ValueError("P is a list of sparse matrices; it must be one, with row s*A + a")
    return P if isinstance(P, ExactEntries) or hasattr(P, "tocsr") else _array("P", P)


def available_rows(
    P: Any, available: ArrayLike | None, ended: NDArray[np.bool_], names: Names
) -> tuple[Any, ArrayLike | None]:
    """P without its mask, and the actions that are left: those whose rows are not masked.

    Raises:
        ValueError: if a row is masked in part, or is said to be available.
    """
    if not np.ma.isMaskedArray(P):
        return P, available
    masked: NDArray[np.bool_] = np.ma.getmaskarray(P)
    whole: NDArray[np.bool_] = np.all(masked, axis=2)
    some: NDArray[np.bool_] = np.any(masked, axis=2)
    given = None if available is None else _mask("available", available, whole.shape)
    bad = np.argwhere((some & ~whole if given is None else some & given) & ~ended[:, None])
    if len(bad):
        state, action = (int(index) for index in bad[0])
        what = "is available" if whole[state, action] else "is not masked as a whole"
        raise ValueError(f"{names.pair(state, action)}: has masked probabilities, but {what}")
    return np.asarray(P), ~some if given is None else given


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
    shape = tuple(P.shape)
    if len(shape) == 3:
        if shape[0] != num_states or shape[2] != num_states or shape[1] == 0:
            orders = {1: ("(A, S, S)", "1, 0, 2"), 0: ("(S, S, A)", "0, 2, 1")}
            hints = [
                f"; if it is {order}, pass P.transpose({axes})"
                for first, (order, axes) in orders.items()
                if shape[first : first + 2] == (num_states, num_states)
            ]
            wanted = f"({num_states}, A, {num_states})"
            raise ValueError(f"P must have shape {wanted}, not {shape}{''.join(hints[:1])}")
        return int(shape[1])
    if len(shape) != 2 or not (hasattr(P, "tocsr") or isinstance(P, ExactEntries)):
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
    array = _real("rewards", rewards)
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


def _real(what: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy in floats."""
    array = plain_array(what, values)
    if array.dtype.kind not in "biufO":
        raise ValueError(f"{what} must hold real numbers, not {array.dtype}")
    try:
        return np.array(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{what} must hold real numbers: {error}") from None


def initial_distribution(
    initial: ArrayLike | None, num_states: int, normalise: bool = False
) -> tuple[NDArray[np.float64] | None, int]:
    """The distribution of the first state, from indices, a mask or a distribution.

    Returns:
        It, and 1 if it had to be divided by its sum (which only ``normalise`` allows), else 0.
    """
    if initial is None:
        return None, 0
    array = plain_array("initial", initial)
    distribution = np.zeros(num_states)
    if array.dtype == np.bool_:
        distribution[_mask("initial", array, (num_states,))] = 1.0
    elif array.dtype.kind in "iu":
        indices = np.atleast_1d(array)
        if len(indices) and (indices.min() < 0 or indices.max() >= num_states):
            raise ValueError(f"initial: states must lie in 0 to {num_states - 1}")
        distribution[indices] = 1.0
    else:
        distribution = _distribution(_real("initial", array), num_states)
        mended = 0
        if normalise:
            distribution, mended = mend_rows(np.zeros(num_states, np.int64), distribution)
        if abs(distribution.sum() - 1) > ROW_SUM_TOLERANCE:
            entries = int(np.count_nonzero(distribution))
            raise ValueError(f"initial: {not_one(distribution.sum(), entries)}")
        return read_only(distribution), mended
    if not distribution.any():
        raise ValueError("initial: at least one state is needed")
    return read_only(distribution / distribution.sum()), 0


def _distribution(array: NDArray[np.float64], num_states: int) -> NDArray[np.float64]:
    if array.shape != (num_states,):
        raise ValueError(f"initial must have shape ({num_states},), not {array.shape}")
    bad = np.flatnonzero(~(array >= 0))
    if len(bad):
        raise ValueError(f"initial: state {bad[0]} has probability {array[bad[0]]}")
    return array + 0.0  # no negative zero
