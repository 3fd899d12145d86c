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

from dead_ends.model.checks import ROW_SUM_TOLERANCE, plain_array
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["as_distribution", "check_policy", "exact_distribution", "single_actions"]


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
    array = plain_array("policy", policy)
    if array.shape == (model.num_states,) and np.issubdtype(array.dtype, np.integer):
        return _checked_actions(model, array.astype(np.int64))
    if array.shape == (model.num_states, model.num_actions):
        if array.dtype == object:
            return _checked_rows(model, _fractions(array))
        if np.issubdtype(array.dtype, np.number) and not np.iscomplexobj(array):
            return _checked_rows(model, array.astype(np.float64))
    raise ValueError(
        f"a policy is an integer array ({model.num_states},) or an array of probabilities "
        f"({model.num_states}, {model.num_actions}), not {array.dtype} {array.shape}"
    )


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
    return _checked_rows(model, _fractions(distribution))


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


def _checked_actions(model: SafeMDP, actions: NDArray[np.int64]) -> NDArray[np.int64]:
    decides = ~(model.fail | model.terminal)
    wrong = np.flatnonzero(decides & ((actions < 0) | (actions >= model.num_actions)))
    if len(wrong):
        raise ValueError(
            f"policy: {model.state_name(wrong[0])}: there is no action {actions[wrong[0]]} "
            f"(0 to {model.num_actions - 1})"
        )
    taken = np.where(decides, actions, 0)
    unavailable = decides & ~model.available[np.arange(model.num_states), taken]
    if unavailable.any():
        state = int(np.flatnonzero(unavailable)[0])
        raise _not_available(model, state, int(actions[state]))
    return actions


def _checked_rows(model: SafeMDP, rows: NDArray[Any]) -> NDArray[Any]:
    decides = ~(model.fail | model.terminal)
    wrong = decides[:, None] & ~np.asarray(rows >= 0, dtype=np.bool_)
    if wrong.any():
        state, action = (int(index) for index in np.argwhere(wrong)[0])
        raise ValueError(
            f"policy: {model.state_name(state)}, {model.action_name(action)}: "
            f"probability {rows[state, action]}"
        )
    wrong = decides[:, None] & np.asarray(rows > 0, dtype=np.bool_) & ~model.available
    if wrong.any():
        state, action = (int(index) for index in np.argwhere(wrong)[0])
        raise _not_available(model, state, action)
    sums = rows.sum(axis=1)
    exact = rows.dtype == object
    off = np.asarray(sums != 1 if exact else ~(np.abs(sums - 1) <= ROW_SUM_TOLERANCE))
    if (decides & off).any():
        state = int(np.flatnonzero(decides & off)[0])
        total = f"{sums[state]}, not exactly 1" if exact else f"{sums[state]:.12g}, not 1"
        raise ValueError(f"policy: {model.state_name(state)}: probabilities sum to {total}")
    return rows


def _not_available(model: SafeMDP, state: int, action: int) -> ValueError:
    return ValueError(
        f"policy: {model.state_name(state)}: {model.action_name(action)} is not available"
    )


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
