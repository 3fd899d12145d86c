"""The witnesses of stochastic models: two breadth-first searches against the transitions.

Both take the kernel by columns (CSC): ``choices[starts[t]:starts[t + 1]]`` are the choices
s*A + a that may lead to state t.

This module imports numba, so it is imported when a model is first certified.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.retrograde import compiled

__all__ = ["danger_ranks", "escapes"]

Indices = NDArray[Any]
Mask = NDArray[np.bool_]


@compiled
def danger_ranks(
    starts: Indices, choices: Indices, available: Mask, fail: Mask
) -> NDArray[np.int32]:
    """int32 (S,): rank(s) = 1 + max over actions of the least rank of a successor.

    Fail has rank 0; states that may avoid fail for ever, which have no such rank, get 0 too.
    States enter the queue by increasing rank: when an action's first successor is settled it
    is the lowest one, and the action settled last decides the state.
    """
    num_states, num_actions = available.shape
    rank = np.zeros(num_states, dtype=np.int32)
    pending = available.copy()
    left = np.zeros(num_states, dtype=np.int64)
    queue = np.empty(num_states, dtype=np.int64)
    head = tail = 0
    for state in range(num_states):
        for action in range(num_actions):
            left[state] += available[state, action]
        if fail[state]:
            queue[tail] = state
            tail += 1
    while head < tail:
        settled = queue[head]
        head += 1
        for place in range(starts[settled], starts[settled + 1]):
            state, action = divmod(choices[place], num_actions)
            if pending[state, action]:
                pending[state, action] = False
                left[state] -= 1
                if left[state] == 0:
                    rank[state] = rank[settled] + 1
                    queue[tail] = state
                    tail += 1
    return rank


@compiled
def escapes(
    starts: Indices, choices: Indices, safe: Mask, num_actions: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """int32 (S,), (S,): the least number of steps to a safe state, and an action that makes one.

    0 and -1 on safe states and where none can be reached.
    """
    num_states = len(safe)
    escape = np.zeros(num_states, dtype=np.int32)
    action = np.full(num_states, -1, dtype=np.int32)
    queue = np.empty(num_states, dtype=np.int64)
    head = tail = 0
    for state in range(num_states):
        if safe[state]:
            queue[tail] = state
            tail += 1
    while head < tail:
        reached = queue[head]
        head += 1
        for place in range(starts[reached], starts[reached + 1]):
            state = choices[place] // num_actions
            if not safe[state] and action[state] < 0:
                escape[state] = escape[reached] + 1
                action[state] = choices[place] % num_actions
                queue[tail] = state
                tail += 1
    return escape, action
