"""Small models written down row by row: P(. | s, a) as a dict of exact probabilities.

Probabilities are added as Fractions, where a float is read as its shortest decimal (0.1 is
1/10), so that no rounding enters the model's definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["Row", "probability", "safe_mdp_from_rows"]

Row = Mapping[int, Fraction]


def probability(name: str, value: float | Fraction) -> Fraction:
    """A parameter as an exact probability.

    Raises:
        ValueError: if it does not lie in [0, 1].
    """
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must lie in 0 to 1, not {value}")
    return value if isinstance(value, Fraction) else Fraction(repr(float(value)))


def safe_mdp_from_rows(
    rows: Sequence[Sequence[Row]],
    fail: NDArray[np.bool_],
    *,
    terminal: NDArray[np.bool_],
    exact: bool,
    entry_reward: Callable[[int], float],
    **attributes: Any,
) -> SafeMDP:
    """The model whose row ``rows[s][a]`` maps each successor to its probability.

    Rows of fail and terminal states may be empty. If every other row has one successor,
    the model is deterministic.

    Args:
        rows: S rows of A mappings.
        fail, terminal: bool (S,).
        exact: keep the Fractions in the model; S * A * S of them while it is built.
        entry_reward: the reward for entering a state; rewards are its expectation.
        attributes: initial, names and geometry, as :class:`SafeMDP` takes them.
    """
    num_states, num_actions = len(fail), len(rows[0])
    moves = [
        (state, action, successor, p)
        for state in np.flatnonzero(~(fail | terminal)).tolist()
        for action, row in enumerate(rows[state])
        for successor, p in row.items()
        if p
    ]
    rewards = np.zeros((num_states, num_actions))
    for state, action, successor, p in moves:
        rewards[state, action] += float(p) * entry_reward(successor)
    attributes |= {"terminal": terminal, "rewards": rewards}
    if all(p == 1 for _, _, _, p in moves):
        table = np.full((num_states, num_actions), -1, dtype=np.int32)
        for state, action, successor, _ in moves:
            table[state, action] = successor
        return SafeMDP.deterministic(table, fail, **attributes)
    build = _dense if exact else _sparse
    return SafeMDP.stochastic(build(moves, num_states, num_actions), fail, **attributes)


Moves = Iterable[tuple[int, int, int, Fraction]]


def _dense(moves: Moves, num_states: int, num_actions: int) -> NDArray[np.object_]:
    P = np.full((num_states, num_actions, num_states), Fraction(0), dtype=object)
    for state, action, successor, p in moves:
        P[state, action, successor] = p
    return P


def _sparse(moves: Moves, num_states: int, num_actions: int) -> sparse.csr_array[np.float64]:
    entries = [(float(p), state * num_actions + action, succ) for state, action, succ, p in moves]
    data, row, column = (np.array(part) for part in zip(*entries, strict=True))
    shape = (num_states * num_actions, num_states)
    return sparse.csr_array(sparse.coo_array((data, (row, column)), shape=shape))
