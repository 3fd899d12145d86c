"""All deterministic models up to a size, in exact integer arithmetic on whole batches.

What is enumerated, and why it is everything. A model has n states, m actions, a set of fail
states and a table next(s, a) on the others.

* One fail state is enough. Merging k fail states into one turns a model with n states into one
  with n - k + 1 states, and no statement can tell the two apart: labels, survival times and
  values off fail agree. A merged model in which j pairs (s, a) enter fail comes from k^j tables
  for each of the C(n, k) sets; :func:`multiplicities` adds these up and the sum is checked
  against the number of all labelled models (:func:`count_all`). A model without fail states is
  one whose fail state is never entered, with one state less.
* Fewer actions are enough: an action that is not available behaves like a copy of another one.
* One task policy is enough. Exchanging a state's actions turns any deterministic task policy
  into "always action 0" and permutes the models among themselves; a pair (model, policy) is
  met once for each of its m^(n-1) names.
* Up to the names of the n - 1 other states, one of each class is enough
  (:func:`representatives`, with the size of each class); the small sizes do without.

A model is a number: its digits in base n are next(0, 0), next(0, 1), ..., next(n - 2, m - 1),
most significant first; the fail state is n - 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations
from math import comb

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP

Tables = NDArray[np.int8]
"""Successors (B, n - 1, m) of a batch of models, fail = n - 1."""

FOREVER = 127
"""The time to fail of a state that need not fail."""


def count(n: int, m: int) -> int:
    """The number of labelled models with n states, m actions and one fail state."""
    return int(n ** ((n - 1) * m))


def count_all(n: int, m: int) -> int:
    """The number of labelled models with n states and m actions, with any set of fail states."""
    return sum(comb(n, k) * n ** ((n - k) * m) for k in range(n + 1))


def tables(n: int, m: int, codes: NDArray[np.int64]) -> Tables:
    """The successor tables of the models with these numbers."""
    digits = (n - 1) * m
    powers = n ** np.arange(digits - 1, -1, -1, dtype=np.int64)
    flat = codes[:, None] // powers % n
    return flat.astype(np.int8).reshape(len(codes), n - 1, m)


def batches(n: int, m: int, size: int = 65_536) -> Iterator[Tables]:
    """All models with n states and m actions, ``size`` at a time."""
    for start in range(0, count(n, m), size):
        yield tables(n, m, np.arange(start, min(start + size, count(n, m)), dtype=np.int64))


def survival(batch: Tables) -> NDArray[np.int8]:
    """T (B, n): the most steps to failure, FOREVER where some path never fails.

    A path that survives n - 1 steps visits n states other than fail, hence one of them
    twice, and can go on forever.
    """
    return _steps(batch, np.ones(batch.shape[2], dtype=np.bool_))


def policy_time(batch: Tables) -> NDArray[np.int8]:
    """(B, n): the steps to failure of the policy "always action 0", FOREVER if it never fails."""
    return _steps(batch, np.arange(batch.shape[2]) == 0)


def _steps(batch: Tables, used: NDArray[np.bool_]) -> NDArray[np.int8]:
    models, states, _ = batch.shape
    longest = np.zeros((models, states + 1), dtype=np.int8)
    successors = batch[:, :, used].reshape(models, -1).astype(np.intp)
    for _ in range(states + 1):  # after k sweeps: min(T, k)
        entered = np.take_along_axis(longest, successors, axis=1)
        longest[:, :-1] = 1 + entered.reshape(models, states, int(used.sum())).max(axis=2)
    longest[longest > states] = FOREVER
    return longest


def multiplicities(batch: Tables, k: int) -> int:
    """How many tables with k fail states merge into the models of this batch."""
    fail = batch.shape[1]
    entries = np.bincount((batch == fail).sum(axis=(1, 2)))
    return sum(int(number) * k**j for j, number in enumerate(entries))


def representatives(n: int, m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """One model of each class under renaming the states: numbers, and sizes of the classes."""
    renamings = np.array(
        [(*order, n - 1) for order in permutations(range(n - 1))][1:], dtype=np.int8
    ).reshape(-1, n)
    total = np.int64(count(n, m))
    found = int(_scan(n, m, total, renamings, np.empty(0, np.int64), np.empty(0, np.int64)))
    codes, sizes = np.empty(found, np.int64), np.empty(found, np.int64)
    _scan(n, m, total, renamings, codes, sizes)
    return codes, sizes


@njit(cache=True)
def _scan(n, m, total, renamings, codes, sizes):  # type: ignore[no-untyped-def]  # numba infers
    """Count, and as far as there is room store, the models that no renaming makes smaller.

    Renaming s to r(s) moves next(s, a) to row r(s): the digit at row t becomes
    r(next(r^-1(t), a)). The first digit that differs decides.
    """
    rows = n - 1
    table = np.zeros((rows, m), dtype=np.int8)
    inverse = np.empty_like(renamings)
    for i in range(len(renamings)):
        for s in range(n):
            inverse[i, renamings[i, s]] = s
    found = 0
    for code in range(total):
        if code > 0:  # count up in base n
            position = rows * m - 1
            while table[position // m, position % m] == n - 1:
                table[position // m, position % m] = 0
                position -= 1
            table[position // m, position % m] += 1
        smallest = True
        symmetries = 1
        for i in range(len(renamings)):
            order = 0
            for position in range(rows * m):
                row, action = position // m, position % m
                digit = renamings[i, table[inverse[i, row], action]]
                order = digit - table[row, action]
                if order != 0:
                    break
            if order < 0:
                smallest = False
                break
            if order == 0:
                symmetries += 1
        if smallest:
            if found < len(codes):
                codes[found] = code
                sizes[found] = (len(renamings) + 1) // symmetries
            found += 1
    return found


def side_by_side(batch: Tables) -> SafeMDP:
    """One model that holds all models of a batch, none connected to another.

    State i of model b is state b * n + i, so that whatever is computed for a state is what
    it would be in its own model.
    """
    models, states, actions = batch.shape
    n = states + 1
    successors = np.zeros((models, n, actions), dtype=np.int32)
    successors[:, :-1] = batch
    successors += (n * np.arange(models, dtype=np.int32))[:, None, None]
    fail = np.tile(np.arange(n) == n - 1, models)
    return SafeMDP.deterministic(successors.reshape(models * n, actions), fail)


def distributions(n: int, total: int) -> list[tuple[int, ...]]:
    """All ways to share ``total`` equal parts of probability among n outcomes."""
    if n == 1:
        return [(total,)]
    return [
        (first, *rest)
        for first in range(total, -1, -1)
        for rest in distributions(n - 1, total - first)
    ]
