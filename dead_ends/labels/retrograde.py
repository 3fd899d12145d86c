"""Backward analysis: which states must fail, and how long they can put it off.

The survival time T is the least solution of

    T(s) = 0                          for s in fail,
    T(s) = 1 + max_a T(next(s, a))    otherwise,

with T(s) infinite where some infinite path from s avoids fail. A state is dead if it is not
fail and T(s) is finite (S_dead of the paper, Definition 2); the horizon of Assumption 1 is
H = max T over the dead states.

Method. Each state that still survives *watches* one successor that still survives. Only when
that successor dies does the state look for another, further along its row: what it passed is
dead, and dead states stay dead. When there is none left, every successor has its final T,
so T(s) = 1 + max is right in whatever order states die. Each row is read at most twice: the
cost is linear in the transitions, whatever the numbering of the states and whatever H.

Memory beside the model: 12 bytes and one bit a state, T included. The watchers of a state
form a linked list (``heads``, ``links``); the states that died and whose watchers wait form a
stack, threaded through the same links; until a state dies, its T holds ``-1 - k``, where k is
the place of the watched successor in its row.

This module imports numba, so it is imported when a model is first solved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dead_ends.labels.labelling import INFINITE, Label
from dead_ends.model.safe_mdp import SafeMDP

__all__ = [
    "boundary_horizon",
    "labels_of",
    "reachable",
    "safe_choices",
    "survival_times",
]

Function = TypeVar("Function", bound=Callable[..., Any])
Bits = NDArray[np.uint8]
Indices = NDArray[np.int32]
Mask = NDArray[np.bool_]
Offsets = NDArray[Any]
"""int32 or int64: where each row of a sparse kernel starts."""

DEAD, FAIL, SAFE = int(Label.DEAD), int(Label.FAIL), int(Label.SAFE)


def compiled(function: Function) -> Function:
    """The function, compiled by numba when it is first called and cached on disk."""
    return cast(Function, njit(cache=True)(function))


def survival_times(model: SafeMDP) -> Indices:
    """T of every state, over all transitions that are possible.

    Args:
        model: deterministic or stochastic. In a stochastic model every successor with
            positive probability counts, so that T is finite where all paths fail.

    Returns:
        int32 (S,), 0 on fail states, ``INFINITE`` where some path never fails.
    """
    if model.next_state is not None:
        return _survival(
            model.next_state.reshape(-1), model.num_actions, None, model.fail, model.terminal
        )
    kernel = model.transitions()
    return _survival(kernel.indices, model.num_actions, kernel.indptr, model.fail, model.terminal)


@compiled
def _row(state: int, num_actions: int, indptr: Offsets | None) -> tuple[int, int]:
    """Where the successors of a state begin and end, in a table or in a sparse kernel."""
    first = state * num_actions
    if indptr is None:
        return first, first + num_actions
    return indptr[first], indptr[first + num_actions]


@compiled
def _is_set(bits: Bits, index: int) -> bool:
    return bool((bits[index >> 3] >> (index & 7)) & 1)


@compiled
def _set(bits: Bits, index: int) -> None:
    bits[index >> 3] |= np.uint8(1 << (index & 7))


@compiled
def _survival(
    successors: Indices, num_actions: int, indptr: Offsets | None, fail: Mask, terminal: Mask
) -> Indices:
    """T; ``successors`` is a flat table (indptr None) or the indices of a sparse kernel."""
    count = len(fail)
    time = np.full(count, -1, dtype=np.int32)
    heads = np.full(count, -1, dtype=np.int32)
    links = np.empty(count, dtype=np.int32)
    dead = np.zeros((count >> 3) + 1, dtype=np.uint8)
    for state in range(count):
        if fail[state]:
            time[state] = 0
            _set(dead, state)
    # One loop looks at a state at a time, so that its body is written (and inlined) once:
    # every state in turn, then the watchers of each state that died, until nobody waits.
    fresh, watcher, waiting = 0, np.int32(-1), np.int32(-1)
    while True:
        if fresh < count:
            state = fresh
            fresh += 1
            if fail[state] or terminal[state]:
                continue
        elif watcher >= 0:
            state = int(watcher)
            watcher = links[state]
        elif waiting >= 0:
            watcher = heads[waiting]
            waiting = links[waiting]
            continue
        else:
            break
        start, stop = _row(state, num_actions, indptr)
        survivor = np.int32(-1)
        for place in range(start - 1 - time[state], stop):
            successor = successors[place]
            if successor >= 0 and not _is_set(dead, successor):
                survivor = successor
                time[state] = start - 1 - place
                break
        if survivor >= 0:
            links[state] = heads[survivor]
            heads[survivor] = state
            continue
        longest = np.int32(0)
        for place in range(start, stop):
            if successors[place] >= 0:
                longest = max(longest, time[successors[place]])
        time[state] = longest + 1
        _set(dead, state)
        # A dead state gains no watchers: without any, nobody needs to be told.
        if heads[state] >= 0:
            links[state] = waiting
            waiting = np.int32(state)
    for state in range(count):
        if time[state] < 0:
            time[state] = INFINITE
    return time


@compiled
def labels_of(time: Indices) -> tuple[NDArray[np.uint8], int]:
    """Labels of a deterministic model from its survival times, and the horizon H."""
    labels = np.empty(len(time), dtype=np.uint8)
    horizon = np.int32(0)
    for state in range(len(time)):
        if time[state] == INFINITE:
            labels[state] = SAFE
        else:
            labels[state] = DEAD if time[state] > 0 else FAIL
            horizon = max(horizon, time[state])
    return labels, int(horizon)


@compiled
def boundary_horizon(
    successors: Indices,
    num_actions: int,
    indptr: Offsets | None,
    terminal: Mask,
    labels: NDArray[np.uint8],
    time: Indices,
    reached: Mask | None,
) -> int:
    """max T(s') over unsafe successors s' of safe states; -1 if there are none.

    Safe is everything neither fail nor dead; only states in ``reached`` count, if given.
    """
    longest = np.int32(-1)
    for state in range(len(labels)):
        if labels[state] < SAFE or terminal[state]:
            continue
        if reached is not None and not reached[state]:
            continue
        start, stop = _row(state, num_actions, indptr)
        for place in range(start, stop):
            successor = successors[place]
            if successor >= 0 and labels[successor] < SAFE:
                longest = max(longest, time[successor])
    return int(longest)


@compiled
def reachable(
    successors: Indices,
    num_actions: int,
    indptr: Offsets | None,
    fail: Mask,
    terminal: Mask,
    initial: NDArray[np.int64],
) -> Mask:
    """bool (S,): the states reachable from the initial ones before the episode ends.

    Dead states have no way back, so the safe states among them are exactly those that are
    reachable inside S_safe.
    """
    reached = np.zeros(len(fail), dtype=np.bool_)
    stack = np.empty(len(fail), dtype=np.int32)
    size = 0
    for state in initial:
        reached[state] = True
        stack[size] = state
        size += 1
    while size > 0:
        size -= 1
        state = int(stack[size])
        if fail[state] or terminal[state]:
            continue
        start, stop = _row(state, num_actions, indptr)
        for place in range(start, stop):
            successor = successors[place]
            if successor >= 0 and not reached[successor]:
                reached[successor] = True
                stack[size] = successor
                size += 1
    return reached


@compiled
def safe_choices(
    successors: Indices,
    num_actions: int,
    indptr: Offsets | None,
    terminal: Mask,
    labels: NDArray[np.uint8],
) -> Mask:
    """bool (S*A,): the actions, of states that are not lost, all of whose successors are safe."""
    count = len(labels)
    allowed = np.zeros(count * num_actions, dtype=np.bool_)
    for state in range(count):
        if labels[state] < SAFE:
            continue
        for choice in range(state * num_actions, (state + 1) * num_actions):
            if terminal[state]:
                allowed[choice] = True
                continue
            start, stop = _row(choice, 1, indptr)
            good = stop > start
            for place in range(start, stop):
                successor = successors[place]
                good = good and successor >= 0 and labels[successor] == SAFE
            allowed[choice] = good
    return allowed
