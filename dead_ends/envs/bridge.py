"""Bridge (Fatemi et al., 2019, "Dead-ends and Secure Exploration in Reinforcement
Learning"): a narrow bridge, and a fall that takes some steps to end.

The agent starts at cell 0 of a bridge with ``length`` cells. "forward" succeeds, or falls
with probability ``fall_probability``; "backward" always succeeds; "jump" falls. The last cell
gives the reward 100 and is terminal. A falling agent hits the ground, the violation (reward
-1), on the K-th step after the fall, K = 2 or 3 with the same probability, whatever it does:
H = 3.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from dead_ends.envs.transition_rows import Row, probability, safe_mdp_from_rows
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = ["ACTIONS", "bridge"]

ACTIONS = ("forward", "backward", "jump")

FALL = 3
"""The most steps that a fall takes."""

CERTAIN = Fraction(1)


def bridge(length: int = 9, fall_probability: float | Fraction = 0.01) -> SafeMDP:
    """Bridge as a safe MDP: the cells of the bridge, three falling states, the ground.

    State i < length is cell i; then come "falling, k steps left" for k = 3, 2, 1, and the
    ground. The probabilities are kept exactly (a float is read as its shortest decimal).

    Raises:
        ValueError: if the length is below 2 or the probability not in [0, 1].
    """
    if length < 2:
        raise ValueError(f"length must be at least 2, not {length}")
    fall = probability("fall_probability", fall_probability)
    ground = length + FALL
    states = np.arange(ground + 1)
    return safe_mdp_from_rows(
        [_cell_rows(cell, length, fall) for cell in range(length)]
        + [[{state + 1: CERTAIN}] * len(ACTIONS) for state in range(length, ground)]
        + [[{}] * len(ACTIONS)],
        states == ground,
        terminal=states == length - 1,
        exact=True,
        entry_reward=lambda state: {length - 1: 100.0, ground: -1.0}.get(state, 0.0),
        initial=0,
        state_names=[
            *(f"cell {cell}" for cell in range(length)),
            *(f"falling, {left} steps left" for left in range(FALL, 0, -1)),
            "ground",
        ],
        action_names=ACTIONS,
        geometry=_geometry(length),
    )


def _cell_rows(cell: int, length: int, fall: Fraction) -> list[Row]:
    """P(. | cell, .); a fall that takes K steps begins K steps above the ground."""
    ground = length + FALL
    falling = {ground - 3: Fraction(1, 2), ground - 2: Fraction(1, 2)}
    forward = {min(cell + 1, length - 1): 1 - fall} | {
        state: fall * p for state, p in falling.items()
    }
    return [forward, {max(cell - 1, 0): CERTAIN}, falling]


def _geometry(length: int) -> Geometry:
    """The bridge from left to right, the fall below its middle."""
    cells = [(cell, 0) for cell in range(length)]
    cells += [(length // 2, depth) for depth in range(1, FALL + 2)]
    return Geometry(
        cell=np.array(cells, dtype=np.int32),
        x_label="cell",
        y_label="depth",
        y_down=True,
        arrows=((1.0, 0.0), (-1.0, 0.0), (0.0, -1.0)),
    )
