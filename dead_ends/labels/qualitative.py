"""Graph analysis of stochastic models: who surely fails, who almost surely, who never need.

For a state s let P_min(s) be the least probability, over all policies, of ever reaching fail.
Three sets are decided on the graph of the transitions with positive probability alone; no
probability is added or compared, so rounding cannot touch them:

* Z = {P_min = 0} is the greatest set of states, none of them fail, in each of which some
  action has all its successors in Z. (Such an action may be repeated for ever. Conversely, a
  policy that never fails only visits states with P_min = 0, so these states form such a set.)
* D = {P_min = 1} without fail is the set of states from which no path reaches Z, whatever
  the choices along it. (With a path, follow it with positive probability and stay in Z.
  Without one: a policy that fails with probability < 1 may be taken memoryless, the model
  being finite; its Markov chain then has a closed class without fail that is reached with
  positive probability; the class lies in Z, and the way there is a path.)
* D_sure, a subset of D, holds the states all of whose paths fail; on it the survival time T,
  the longest path, is finite (:func:`dead_ends.labels.retrograde.survival_times`).

The remaining states are at risk: 0 < P_min < 1. The paper's S_dead (Definition 2) is D, its
S_safe is Z together with the states at risk. If all probabilities are 0 or 1, Z is S_safe and
D = D_sure = S_dead.

The cost is linear in the transitions. Both searches go backwards and share one index of the
predecessors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.labelling import Label
from dead_ends.labels.retrograde import compiled
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["qualitative_labels"]

Indices = NDArray[np.int32]
Mask = NDArray[np.bool_]
Offsets = NDArray[Any]
"""int32 or int64: row numbers of a sparse kernel, or where its rows start."""


def qualitative_labels(model: SafeMDP) -> NDArray[np.uint8]:
    """The label of every state of a stochastic (or any other) model, from its graph.

    Returns:
        uint8 (S,) of :class:`Label`: FAIL, SAFE where P_min = 0, DEAD where P_min = 1,
        AT_RISK elsewhere.
    """
    kernel = model.transitions()
    choices = np.empty(kernel.nnz, dtype=_width(kernel.shape[0]))
    starts = _predecessors(kernel.indices, kernel.indptr, model.num_states, choices)
    available = np.diff(kernel.indptr) > 0
    p_min_zero = _p_min_zero(starts, choices, available, model.num_actions, model.fail)
    p_min_below_one = _reaching(starts, choices, p_min_zero, model.num_actions)
    labels = np.full(model.num_states, Label.DEAD, dtype=np.uint8)
    labels[p_min_below_one] = Label.AT_RISK
    labels[p_min_zero] = Label.SAFE
    labels[model.fail] = Label.FAIL
    return labels


def _width(num_choices: int) -> type[np.integer[Any]]:
    """The integers that number choices: four bytes for all but the largest models, else eight."""
    return np.int32 if num_choices <= np.iinfo(np.int32).max else np.int64


@compiled
def _predecessors(
    indices: Indices, indptr: Offsets, num_states: int, choices: Offsets
) -> NDArray[np.int64]:
    """Fill ``choices``: choices[starts[t]:starts[t + 1]] are the rows s*A + a that may lead to t.

    Returns ``starts``.
    """
    starts = np.zeros(num_states + 1, dtype=np.int64)
    for successor in indices:
        starts[successor + 1] += 1
    for state in range(num_states):
        starts[state + 1] += starts[state]
    free = starts[:-1].copy()
    for choice in range(len(indptr) - 1):
        for place in range(indptr[choice], indptr[choice + 1]):
            successor = indices[place]
            choices[free[successor]] = choice
            free[successor] += 1
    return starts


@compiled
def _p_min_zero(
    starts: NDArray[np.int64],
    choices: Offsets,
    available: Mask,
    num_actions: int,
    fail: Mask,
) -> Mask:
    """bool (S,): Z, by removing fail, then choices that may leave Z, then states without any."""
    num_states = len(fail)
    remaining = available.copy()
    left = np.zeros(num_states, dtype=np.int32)
    for choice in range(len(available)):
        left[choice // num_actions] += available[choice]
    inside = ~fail
    stack = np.empty(num_states, dtype=np.int32)
    size = 0
    for state in range(num_states):
        if fail[state]:
            stack[size] = state
            size += 1
    while size > 0:
        size -= 1
        removed = stack[size]
        for place in range(starts[removed], starts[removed + 1]):
            choice = choices[place]
            if remaining[choice]:
                remaining[choice] = False
                state = int(choice) // num_actions
                left[state] -= 1
                if left[state] == 0:
                    inside[state] = False
                    stack[size] = state
                    size += 1
    return inside


@compiled
def _reaching(starts: NDArray[np.int64], choices: Offsets, target: Mask, num_actions: int) -> Mask:
    """bool (S,): the states with a path to the target; fail states have no successors."""
    reaching = target.copy()
    stack = np.empty(len(target), dtype=np.int32)
    size = 0
    for state in range(len(target)):
        if target[state]:
            stack[size] = state
            size += 1
    while size > 0:
        size -= 1
        reached = stack[size]
        for place in range(starts[reached], starts[reached + 1]):
            state = int(choices[place]) // num_actions
            if not reaching[state]:
                reaching[state] = True
                stack[size] = state
                size += 1
    return reaching
