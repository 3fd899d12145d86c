"""Labels of deterministic models too large for a table: transitions on the fly.

The model is a compiled function ``successor(state, action)`` in place of the table
``next_state[state, action]``. What is stored is the survival time, two bytes a state, so that
10**9 states take 2 GB.

Method. In-place sweeps: a state all of whose successors have a survival time gets
T = 1 + max of theirs, at once, so that one sweep settles whole chains. Sweeps run upwards and
downwards in turn until one changes nothing. States settle in an order in which each of their
successors is settled before them, so every T is final when it is written. How many sweeps that
takes depends on the numbering of the states: few where most actions lead to nearby states
(grids), up to H + 1 where numbers are random; for those a table is the better choice
(:mod:`dead_ends.labels.retrograde`).

Results are exact: integers throughout. Source: Definition 2 and Assumption 1 of the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray
from tqdm import tqdm

from dead_ends.labels.labelling import Label
from dead_ends.model.checks import read_only
from dead_ends.model.memory import require_memory

__all__ = ["SURVIVES", "ImplicitLabelling", "Progress", "classify_implicit", "progress_bar"]

SURVIVES = int(np.iinfo(np.uint16).max)
"""The survival time, in two bytes, of a state that need not fail."""

CHUNK = 1 << 24
"""States looked at between two reports; an interrupt waits for no more than these."""

Times = NDArray[np.uint16]
Progress: TypeAlias = Callable[[int, int, int], None]
"""Called with the sweep (from 1), the states it has looked at, and all states settled so far."""

_FINE, _OUT_OF_RANGE, _NO_ACTION, _TOO_LONG = range(4)


@dataclass(frozen=True, eq=False)
class ImplicitLabelling:
    """The subsets and horizons of a model without a table.

    Attributes:
        survival_time: uint16 (S,), T: 0 on fail states, ``SURVIVES`` on safe ones.
        horizon: H, the greatest T over the dead states, 0 if there are none.
        boundary_horizon: H_b, the greatest T(next(s, a)) over safe s and actions a that lead
            to an unsafe state; None if there are none.
        counts: the number of states with each label.
        sweeps: how many sweeps it took.
    """

    survival_time: Times
    horizon: int
    boundary_horizon: int | None
    counts: dict[Label, int]
    sweeps: int

    def labels(self, states: slice | NDArray[Any] = slice(None)) -> NDArray[np.uint8]:
        """uint8, the :class:`Label` of some states (of all, one byte each)."""
        time = self.survival_time[states]
        labels = np.full(time.shape, Label.DEAD, dtype=np.uint8)
        labels[time == 0] = Label.FAIL
        labels[time == SURVIVES] = Label.SAFE
        return labels


def classify_implicit(
    successor: Callable[..., int],
    fail: Callable[..., bool],
    num_states: int,
    num_actions: int,
    *,
    data: tuple[Any, ...] = (),
    times: Times | None = None,
    progress: Progress | None = None,
) -> ImplicitLabelling:
    """Label the states 0 to S-1 of a deterministic model given by compiled functions.

    Args:
        successor: compiled by numba.njit, (state, action, *data) -> the next state, or -1
            where the action is not available. Never called on fail states. Goals are states
            that lead to themselves.
        fail: compiled by numba.njit, (state, *data) -> whether the state is a violation.
        num_states, num_actions: S and A.
        data: arrays or numbers that both functions get, a map for example.
        times: uint16 (S,), room for the survival times, such as a file gives that the system
            may keep on disk (:func:`dead_ends.io.labelling.survival_time_file`).
        progress: called now and then, :func:`progress_bar` for example.

    Raises:
        ValueError: if a function is not compiled; if ``times`` has another shape or type; if a
            successor is out of range, or a state
            that does not fail has no action (both named); if some T exceeds 65,534.
        MemoryError: if the survival times do not fit the memory, before anything is computed.
    """
    for name, function in (("successor", successor), ("fail", fail)):
        if not hasattr(function, "py_func"):
            raise ValueError(f"{name} must be compiled: decorate it with numba.njit")
    if num_states < 1 or num_actions < 1:
        raise ValueError("a model needs at least one state and one action")
    time = _storage(num_states) if times is None else _checked(times, num_states)
    sweeps = _settle(successor, fail, num_actions, data, time, progress)
    counts = dict.fromkeys(Label, 0)
    horizon, boundary = 0, -1
    for first, last in _chunks(num_states):
        failed, dead, longest = _count(time, first, last)
        entered, *problem = _entered(successor, num_actions, data, time, first, last)
        _check(tuple(problem), num_states)
        counts[Label.FAIL] += failed
        counts[Label.DEAD] += dead
        counts[Label.SAFE] += last - first - failed - dead
        horizon, boundary = max(horizon, longest), max(boundary, entered)
    return ImplicitLabelling(
        read_only(time), horizon, None if boundary < 0 else boundary, counts, sweeps
    )


@contextmanager
def progress_bar(num_states: int) -> Iterator[Progress]:
    """A progress bar on the terminal, filled once a sweep.

    ``with progress_bar(S) as progress: classify_implicit(..., progress=progress)``
    """
    with tqdm(total=num_states, unit=" states", unit_scale=True) as bar:

        def report(sweep: int, looked_at: int, settled: int) -> None:
            bar.set_description(f"sweep {sweep}, {settled:,} settled")
            bar.update(looked_at - bar.n)

        yield report


def _storage(num_states: int) -> Times:
    """Room for the survival times in memory."""
    require_memory(2 * num_states, f"labelling {num_states:,} states")
    return np.empty(num_states, dtype=np.uint16)


def _checked(times: Times, num_states: int) -> Times:
    if times.shape != (num_states,) or times.dtype != np.uint16:
        raise ValueError(
            f"times must be uint16 of shape ({num_states},), not {times.dtype} of {times.shape}"
        )
    return times


def _chunks(num_states: int) -> list[tuple[int, int]]:
    return [(first, min(first + CHUNK, num_states)) for first in range(0, num_states, CHUNK)]


def _settle(
    successor: Callable[..., int],
    fail: Callable[..., bool],
    num_actions: int,
    data: tuple[Any, ...],
    time: Times,
    progress: Progress | None,
) -> int:
    """Fill in the survival times; the number of sweeps."""
    num_states = len(time)
    settled = 0
    for first, last in _chunks(num_states):
        settled += _start(fail, data, time, first, last)
    sweeps, changed = 0, True
    while changed:
        sweeps, changed, looked_at = sweeps + 1, False, 0
        upwards = sweeps % 2 == 1
        for first, last in _chunks(num_states)[:: 1 if upwards else -1]:
            found, *problem = _sweep(successor, num_actions, data, time, first, last, upwards)
            _check(tuple(problem), num_states)
            settled += found
            changed = changed or found > 0
            looked_at += last - first
            if progress is not None:
                progress(sweeps, looked_at, settled)
    return sweeps


def _check(problem: tuple[int, ...], num_states: int) -> None:
    """Raise what a kernel found wrong: (kind, state, action, successor)."""
    kind, state, action, successor = problem
    if kind == _OUT_OF_RANGE:
        raise ValueError(
            f"state {state}, action {action}: successor {successor} is not a state "
            f"(0 to {num_states - 1}, or -1 for an action that is not available)"
        )
    if kind == _NO_ACTION:
        raise ValueError(
            f"state {state} has no action and does not fail; if the episode ends there without "
            "harm, let it lead to itself"
        )
    if kind == _TOO_LONG:
        raise ValueError(
            f"state {state} survives more than {SURVIVES - 1:,} steps, which two bytes do not "
            "hold; use a table"
        )


# Not cached on disk: these are compiled for the functions that they are given.


@njit
def _start(
    fail: Callable[..., bool], data: tuple[Any, ...], time: Times, first: int, last: int
) -> int:
    """T of fail states is 0, of all others not known; the number of fail states."""
    failed = 0
    for state in range(first, last):
        if fail(state, *data):
            time[state] = 0
            failed += 1
        else:
            time[state] = SURVIVES
    return failed


@njit
def _sweep(
    successor: Callable[..., int],
    num_actions: int,
    data: tuple[Any, ...],
    time: Times,
    first: int,
    last: int,
    upwards: bool,
) -> tuple[int, int, int, int, int]:
    """Settle the states from ``first`` up to ``last``, or down; how many, and what is wrong."""
    found = 0
    for step in range(last - first):
        state = first + step if upwards else last - 1 - step
        if time[state] != SURVIVES:
            continue
        longest, actions = -1, 0
        for action in range(num_actions):
            following = successor(state, action, *data)
            if following == -1:
                continue
            if following < 0 or following >= len(time):
                return found, _OUT_OF_RANGE, state, action, following
            actions += 1
            longest = max(longest, int(time[following]))
            if longest == SURVIVES:
                break
        if longest == SURVIVES:
            continue
        if actions == 0:
            return found, _NO_ACTION, state, 0, 0
        if longest + 1 == SURVIVES:
            return found, _TOO_LONG, state, 0, 0
        time[state] = longest + 1
        found += 1
    return found, _FINE, 0, 0, 0


@njit
def _entered(
    successor: Callable[..., int],
    num_actions: int,
    data: tuple[Any, ...],
    time: Times,
    first: int,
    last: int,
) -> tuple[int, int, int, int, int]:
    """The greatest T of an unsafe successor of a safe state, or -1; and what is wrong."""
    longest = -1
    for state in range(first, last):
        if time[state] != SURVIVES:
            continue
        for action in range(num_actions):
            following = successor(state, action, *data)
            if following == -1:
                continue
            if following < 0 or following >= len(time):
                return longest, _OUT_OF_RANGE, state, action, following
            if time[following] != SURVIVES:
                longest = max(longest, int(time[following]))
    return longest, _FINE, 0, 0, 0


@njit(cache=True)
def _count(time: Times, first: int, last: int) -> tuple[int, int, int]:
    """The numbers of fail and of dead states, and the greatest T among them."""
    failed, dead, longest = 0, 0, 0
    for state in range(first, last):
        if time[state] == 0:
            failed += 1
        elif time[state] != SURVIVES:
            dead += 1
            longest = max(longest, int(time[state]))
    return failed, dead, longest
