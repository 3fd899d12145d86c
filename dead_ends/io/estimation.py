"""A model estimated from logged transitions, with what was never tried taken either way.

Data (s, a, s') determine the model only where something was tried. For pairs (s, a) that the
data lack,

    pessimistic:  (s, a) leads to failure,
    optimistic:   (s, a) stays in s, safely.

This is the paper's problem of out-of-distribution actions ("Offline Pretrain"), exactly: a
critic that queries Q(s, a) of untried actions guesses one way or the other. If the task is
deterministic, every state that the pessimist calls safe is safe, and more data can only enlarge
that set: the pessimist is conservative, never wrong. The optimist calls every state safe in which
something is untried, and so may call a dead-end safe. In a stochastic task even the pessimist can
be wrong: a successor that was never seen has frequency 0, and a frequency is not a probability.

So the model of a log is an estimate (``model.estimate``), and nothing that follows from it is
guaranteed, unless somebody asserts that the task is deterministic and nothing is guessed
optimistically.

Observed pairs: the one successor (deterministic), or the relative frequencies of the successors
(maximum likelihood), as exact Fractions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.model.checks import plain_array
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["Unseen", "estimate_model"]

Integers = NDArray[np.int64]


class Unseen(StrEnum):
    """What an action that the data lack is taken for."""

    PESSIMISTIC = "pessimistic"
    """It leads to failure; its reward is the lowest of the data."""

    OPTIMISTIC = "optimistic"
    """It stays in the state, safely; its reward is the highest of the data."""


def estimate_model(
    num_states: int,
    num_actions: int,
    transitions: ArrayLike,
    fail: ArrayLike,
    unseen: Unseen | str = Unseen.PESSIMISTIC,
    *,
    deterministic: bool = False,
    rewards: ArrayLike | None = None,
    terminated: ArrayLike | None = None,
    available: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    state_names: Sequence[str] | None = None,
    action_names: Sequence[str] | None = None,
) -> SafeMDP:
    """The model that logged transitions show.

    Args:
        num_states, num_actions: S and A.
        transitions: integers (N, 3), a row (s, a, s') each; the order does not matter, and
            rows may repeat.
        fail: bool (S,), the violations.
        unseen: how pairs (s, a) without data are taken; pessimistically they lead to the
            first fail state.
        deterministic: True asserts that every pair has one successor in the task itself; a
            log that contradicts it is refused. Otherwise P is the relative frequency, in
            Fractions (``model.exact``), and the model is an estimate.
        rewards: float (N,), averaged over each pair.
        terminated: bool (N,), the episode ended at s'. An s' that is not fail is then a goal
            (a terminal state). Time limits are no ends: leave them False.
        available: bool (S, A), the actions that exist; None means all. Those that do not
            exist are not guessed about.
        initial, state_names, action_names: as in :meth:`dead_ends.SafeMDP.deterministic`.

    Returns:
        The model, marked as an estimate unless ``deterministic`` is asserted and no pair is
        taken optimistically. Its labels are no guarantee about the task; of an unmarked model
        "safe" is one, and "dead" means that the data show no way to stay safe.

    Raises:
        ValueError: naming the row: an index out of range, a transition that starts where an
            episode has ended or takes an action that is not available, a reward that is not
            finite; naming the state and action: two successors in a deterministic model, or
            an untried action while there is no fail state for it to lead to.
    """
    unseen = Unseen(unseen)
    if num_states < 1 or num_actions < 1:
        raise ValueError(
            f"a model needs at least one state and one action, not {num_states} and {num_actions}"
        )
    rows = _checked_rows(transitions, num_states, num_actions)
    fail_mask = _checked_mask("fail", fail, (num_states,))
    terminal = _terminal(rows, terminated, fail_mask)
    exists = np.ones((num_states, num_actions), dtype=np.bool_)
    if available is not None:
        exists &= _checked_mask("available", available, exists.shape)
    _check_starts(rows, fail_mask, terminal, exists)
    guessed = exists & ~(fail_mask | terminal)[:, None]
    guessed[rows[:, 0], rows[:, 1]] = False
    guess = _guess(unseen, fail_mask, guessed)
    common: dict[str, Any] = {
        "terminal": terminal,
        "rewards": _mean_rewards(rewards, rows, guessed, unseen),
        "initial": initial,
        "state_names": state_names,
        "action_names": action_names,
    }
    if deterministic:
        table = np.where(guessed, guess[:, None], -1).astype(np.int32)
        table[rows[:, 0], rows[:, 1]] = rows[:, 2]
        _check_one_successor(rows, table)
        model = SafeMDP.deterministic(table, fail_mask, **common)
        return replace(model, estimate=unseen is Unseen.OPTIMISTIC and bool(guessed.any()))
    return _most_likely(rows, guessed, guess, fail_mask, exists, common)


def _most_likely(
    rows: Integers,
    guessed: NDArray[np.bool_],
    guess: Integers,
    fail: NDArray[np.bool_],
    exists: NDArray[np.bool_],
    common: dict[str, Any],
) -> SafeMDP:
    """P(s' | s, a) = how often s' followed (s, a) / how often (s, a) was tried."""
    from scipy import sparse

    num_states, num_actions = guessed.shape
    goals = np.repeat(np.flatnonzero(common["terminal"]), num_actions)
    states, actions = np.nonzero(guessed)
    pairs = np.concatenate(
        (
            rows[:, 0] * num_actions + rows[:, 1],
            states * num_actions + actions,
            goals * num_actions + np.tile(np.arange(num_actions), len(goals) // num_actions),
        )
    )
    successors = np.concatenate((rows[:, 2], guess[states], goals))
    counts = sparse.coo_array(
        (np.ones(len(pairs)), (pairs, successors)), shape=(num_states * num_actions, num_states)
    ).tocsr()
    counts.sum_duplicates()
    tried = np.repeat(counts.sum(axis=1), np.diff(counts.indptr))
    frequencies = sparse.csr_array(
        (counts.data / tried, counts.indices, counts.indptr), shape=counts.shape
    )
    model = SafeMDP.stochastic(frequencies, fail, exists, **common)
    exact = tuple(
        Fraction(int(count), int(total)) for count, total in zip(counts.data, tried, strict=True)
    )
    return replace(model, exact=exact, estimate=True)


def _guess(unseen: Unseen, fail: NDArray[np.bool_], guessed: NDArray[np.bool_]) -> Integers:
    """The successor that untried actions are given in each state."""
    if unseen is Unseen.OPTIMISTIC:
        return np.arange(len(fail))
    if guessed.any() and not fail.any():
        state, action = np.argwhere(guessed)[0]
        raise ValueError(
            f"state {state}, action {action} was never tried, and no state is marked in `fail` "
            "for it to lead to; add a fail state, or take unseen actions optimistically"
        )
    return np.full(len(fail), int(fail.argmax()))


def _checked_rows(transitions: ArrayLike, num_states: int, num_actions: int) -> Integers:
    rows = plain_array("transitions", transitions)
    if rows.size == 0:
        return np.zeros((0, 3), dtype=np.int64)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.issubdtype(rows.dtype, np.integer):
        raise ValueError(
            f"transitions must be integers of shape (N, 3), a row (s, a, s') each, "
            f"not {rows.dtype} of shape {rows.shape}"
        )
    for column, (what, limit) in enumerate(
        (("state", num_states), ("action", num_actions), ("successor", num_states))
    ):
        bad = np.flatnonzero((rows[:, column] < 0) | (rows[:, column] >= limit))
        if len(bad):
            raise ValueError(
                f"transition {bad[0]}: {what} {rows[bad[0], column]} is not one of 0 to {limit - 1}"
            )
    return rows.astype(np.int64)


def _checked_mask(what: str, mask: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    array = plain_array(what, mask)
    if array.dtype != np.bool_ or array.shape != shape:
        raise ValueError(
            f"{what} must be a boolean mask of shape {shape}, not {array.dtype} of "
            f"shape {array.shape}"
        )
    return array


def _terminal(
    rows: Integers, terminated: ArrayLike | None, fail: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    terminal = np.zeros(len(fail), dtype=np.bool_)
    if terminated is not None:
        ended = _checked_mask("terminated", terminated, (len(rows),))
        terminal[rows[ended, 2]] = True
    return terminal & ~fail


def _check_starts(
    rows: Integers,
    fail: NDArray[np.bool_],
    terminal: NDArray[np.bool_],
    exists: NDArray[np.bool_],
) -> None:
    """No transition starts where an episode has ended, or takes an action that is none."""
    for mask, what in ((fail, "fail state"), (terminal, "terminal state")):
        bad = np.flatnonzero(mask[rows[:, 0]])
        if len(bad):
            raise ValueError(
                f"transition {bad[0]}: starts in {what} {rows[bad[0], 0]}, "
                "where the episode has ended"
            )
    bad = np.flatnonzero(~exists[rows[:, 0], rows[:, 1]])
    if len(bad):
        state, action, _ = rows[bad[0]]
        raise ValueError(f"transition {bad[0]}: action {action} is not available in state {state}")


def _check_one_successor(rows: Integers, table: NDArray[np.int32]) -> None:
    other = np.flatnonzero(table[rows[:, 0], rows[:, 1]] != rows[:, 2])
    if len(other):
        state, action, successor = rows[other[0]]
        raise ValueError(
            f"state {state}, action {action} leads to state {successor} (transition {other[0]}) "
            f"and to state {table[state, action]}, so the task is not deterministic; leave out "
            "deterministic=True"
        )


def _mean_rewards(
    rewards: ArrayLike | None, rows: Integers, guessed: NDArray[np.bool_], unseen: Unseen
) -> NDArray[np.float64] | None:
    """The mean reward of each pair; the lowest or highest of all where nothing was tried."""
    if rewards is None:
        return None
    earned = np.asarray(plain_array("rewards", rewards), dtype=np.float64)
    if earned.shape != (len(rows),):
        raise ValueError(f"rewards must have shape ({len(rows)},), not {earned.shape}")
    bad = np.flatnonzero(~np.isfinite(earned))
    if len(bad):
        raise ValueError(f"transition {bad[0]}: reward {earned[bad[0]]} is not finite")
    total, tried = np.zeros(guessed.shape), np.zeros(guessed.shape)
    np.add.at(total, (rows[:, 0], rows[:, 1]), earned)
    np.add.at(tried, (rows[:, 0], rows[:, 1]), 1)
    if len(earned):
        extreme = earned.min() if unseen is Unseen.PESSIMISTIC else earned.max()
        total[guessed] = extreme
    return total / np.maximum(tried, 1)
