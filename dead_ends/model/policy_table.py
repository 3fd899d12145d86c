"""Policies as they are given: checked, and as a distribution over actions.

A policy is an integer array (S,), the action of each state, or an array (S, A) whose row s
is pi(. | s), of floats or of Fractions. Rows of fail and terminal states are ignored: no
decision is taken there.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.model.checks import ROW_SUM_TOLERANCE, Names, plain_array
from dead_ends.model.safe_mdp import SafeMDP

__all__ = [
    "as_distribution",
    "check_actions",
    "check_policy",
    "check_table",
    "exact_distribution",
    "single_actions",
]


def check_policy(model: SafeMDP, policy: ArrayLike) -> NDArray[Any]:
    """The policy as an array, once it is found to be one of this model.

    Args:
        model: the model.
        policy: int (S,), or (S, A) of floats or Fractions.

    Returns:
        int64 (S,), float64 (S, A), or Fractions (S, A) with dtype object.

    Raises:
        ValueError: naming the state and action: an action that does not exist or is not
            available, a negative or NaN probability, a row that does not sum to 1 (within
            1e-9; exactly, for Fractions). Rows of fail and terminal states are not checked.
    """
    names = Names(model.state_names, model.action_names, model.num_states, model.num_actions)
    decides = ~(model.fail | model.terminal)
    checked = check_table("policy", policy, decides, model.available, names)
    return checked if checked.ndim == 1 or checked.dtype == object else checked.astype(np.float64)


def check_table(
    what: str,
    policy: ArrayLike,
    decides: NDArray[np.bool_],
    available: NDArray[np.bool_],
    names: Names,
) -> NDArray[Any]:
    """The policy as an array, once it is found to be one.

    Args:
        what: what an error calls it.
        policy: int (S,), or (S, A) of numbers or Fractions.
        decides: bool (S,), the states that are checked.
        available: bool (S, A), the actions that may be taken there.
        names: what an error calls the states and actions.

    Returns:
        int64 (S,), 0 where nothing is decided; or (S, A) as it is; objects as Fractions.

    Raises:
        ValueError: as :func:`check_policy`.
    """
    array = plain_array(what, policy)
    if array.shape == decides.shape and array.dtype.kind in "iu":
        actions = check_actions(what, np.where(decides, array, 0), names)
        states = np.flatnonzero(decides)
        _check_available(what, states, actions[states], available, names)
        return actions
    if array.shape != available.shape or array.dtype.kind not in "iufO":
        raise ValueError(
            f"{what} must be integers {decides.shape} or probabilities {available.shape}, "
            f"not {array.dtype} {array.shape}"
        )
    rows = _fractions(array) if array.dtype == object else array
    negative = np.argwhere(decides[:, None] & ~np.asarray(rows >= 0, dtype=np.bool_))
    if len(negative):
        state, action = (int(index) for index in negative[0])
        pair = names.pair(state, action)
        raise ValueError(f"{what}: {pair}: probability {rows[state, action]}")
    taken = decides[:, None] & np.asarray(rows > 0, dtype=np.bool_)
    states, actions = np.nonzero(taken)
    _check_available(what, states, actions, available, names)
    _check_sums(what, rows, decides, names)
    return rows


def check_actions(what: str, actions: ArrayLike, names: Names) -> NDArray[np.int64]:
    """One existing action a state, int64 (S,), be it available or not.

    Raises:
        ValueError: naming the state and action.
    """
    array = plain_array(what, actions)
    if array.shape != (names.num_states,) or array.dtype.kind not in "iu":
        raise ValueError(
            f"{what} must be integers of shape ({names.num_states},), "
            f"not {array.dtype} of shape {array.shape}"
        )
    wrong = np.flatnonzero((array < 0) | (array >= names.num_actions))
    if len(wrong):
        state = int(wrong[0])
        raise ValueError(
            f"{what}: {names.state(state)}: there is no action {array[state]} "
            f"(0 to {names.num_actions - 1})"
        )
    return array.astype(np.int64)


def as_distribution(policy: ArrayLike, num_actions: int) -> NDArray[Any]:
    """pi(a | s) as an array (S, A): integer policies become rows with a single 1.

    Entries of an integer policy outside 0 to A-1 (as on fail states) give a row of zeros.
    """
    array = plain_array("policy", policy)
    if array.ndim == 2:
        return array
    return np.asarray(array[:, None] == np.arange(num_actions), dtype=np.float64)


def exact_distribution(model: SafeMDP, policy: ArrayLike) -> NDArray[np.object_]:
    """pi(a | s) as Fractions (S, A); a float is read as its shortest decimal.

    Raises:
        ValueError: as :func:`check_policy`, and for a row that does not sum to exactly 1.
    """
    distribution = as_distribution(check_policy(model, policy), model.num_actions)
    exact = _fractions(distribution)
    names = Names(model.state_names, model.action_names, model.num_states, model.num_actions)
    _check_sums("policy", exact, ~(model.fail | model.terminal), names)
    return exact


def single_actions(model: SafeMDP, policy: NDArray[Any]) -> NDArray[np.int64] | None:
    """int (S,) if a checked policy takes one action a state with probability 1, else None."""
    if policy.ndim == 1:
        return policy.astype(np.int64)
    decides = ~(model.fail | model.terminal)
    # Rows sum to 1 only within a tolerance: beside a 1 there may be small probabilities.
    certain = (policy == 1).any(axis=1) & (np.count_nonzero(policy > 0, axis=1) == 1)
    if certain[decides].all():
        actions: NDArray[np.int64] = np.argmax(policy == 1, axis=1)
        return actions
    return None


def _check_available(
    what: str,
    states: NDArray[np.intp],
    actions: NDArray[Any],
    available: NDArray[np.bool_],
    names: Names,
) -> None:
    bad = np.flatnonzero(~available[states, actions])
    if len(bad):
        state, action = int(states[bad[0]]), int(actions[bad[0]])
        raise ValueError(f"{what}: {names.state(state)}: {names.action(action)} is not available")


def _check_sums(what: str, rows: NDArray[Any], decides: NDArray[np.bool_], names: Names) -> None:
    exact = rows.dtype == object
    sums = rows.sum(axis=1) if exact else rows.sum(axis=1, dtype=np.float64)
    off = np.asarray(sums != 1 if exact else ~(np.abs(sums - 1) <= ROW_SUM_TOLERANCE))
    if (decides & off).any():
        state = int(np.flatnonzero(decides & off)[0])
        total = f"{sums[state]}, not exactly 1" if exact else f"{sums[state]:.12g}, not 1"
        raise ValueError(f"{what}: {names.state(state)}: probabilities sum to {total}")


def _fractions(rows: NDArray[Any]) -> NDArray[np.object_]:
    result = np.empty(rows.shape, dtype=object)
    for index, p in np.ndenumerate(rows):
        result[index] = _fraction(p, index)
    return result


def _fraction(p: Any, index: tuple[int, ...]) -> Fraction:
    try:
        return Fraction(repr(float(p))) if isinstance(p, float) else Fraction(p)
    except (TypeError, ValueError):
        state, action = index
        raise ValueError(
            f"policy: state {state}, action {action}: {p!r} is not a probability"
        ) from None
