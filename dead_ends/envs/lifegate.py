"""LifeGate (Fatemi et al., 2021, "Medical Dead-ends and Learning to Identify High-Risk
States and Treatments"): a grid on which a sick agent drifts towards death.

A 10 x 10 map, y downward, start (2, 9). Recovery: (5..7, 0), reward 1, terminal. Death: the
column x = 9 and (8, 0), reward -1, the violation. Barriers: (0..4, 0) and (1..4, 5). In the
dead-end cells x = 5..8, y = 5..9 the action is ignored: the agent moves right with
probability ``push``, else it stays. Elsewhere the action is replaced by a move right with
probability ``death_drag``. Blocked moves stay put.

With 0 < push < 1 the dead-end cells may be survived for any number of steps, so Assumption 1
of the paper does not hold; with push = 1 and death_drag = 0 the model is deterministic.
In the dead-end cells V_c*(x) = (push g / (1 - (1 - push) g))^(9 - x) / g, g = gamma_safe.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from dead_ends.envs.transition_rows import Row, probability, safe_mdp_from_rows
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = ["ACTIONS", "START", "lifegate"]

ACTIONS = ("no-op", "up", "down", "left", "right")
START = (2, 9)

SIZE = 10
MOVES = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
RIGHT = ACTIONS.index("right")
BARRIERS = {(x, 0) for x in range(5)} | {(x, 5) for x in range(1, 5)}
RECOVERY = {(x, 0) for x in range(5, 8)}
DEATH = {(9, y) for y in range(SIZE)} | {(8, 0)}
DEAD_ENDS = {(x, y) for x in range(5, 9) for y in range(5, SIZE)}

Cell = tuple[int, int]


def lifegate(death_drag: float | Fraction = 0.4, push: float | Fraction = 0.7) -> SafeMDP:
    """LifeGate as a safe MDP: 91 states, the cells (x, y) that are no barriers, row by row.

    The probabilities are kept exactly (a float is read as its shortest decimal). Rewards
    are the expected ones: 1 on recovery, -1 on death.

    Raises:
        ValueError: if a parameter does not lie in [0, 1].
    """
    drag = probability("death_drag", death_drag)
    push = probability("push", push)
    cells = [(x, y) for y in range(SIZE) for x in range(SIZE) if (x, y) not in BARRIERS]
    number = {cell: state for state, cell in enumerate(cells)}
    return safe_mdp_from_rows(
        [[_row(number, cell, action, drag, push) for action in range(5)] for cell in cells],
        np.array([cell in DEATH for cell in cells]),
        terminal=np.array([cell in RECOVERY for cell in cells]),
        exact=True,
        entry_reward=lambda state: float(cells[state] in RECOVERY) - float(cells[state] in DEATH),
        initial=number[START],
        state_names=[f"x {x}, y {y}" for x, y in cells],
        action_names=ACTIONS,
        geometry=Geometry(
            cell=np.array(cells, dtype=np.int32),
            x_label="x",
            y_label="y",
            y_down=True,
            walls=tuple(sorted(BARRIERS)),
            arrows=tuple((float(dx), float(-dy)) for dx, dy in MOVES),
        ),
    )


def _row(number: dict[Cell, int], cell: Cell, action: int, drag: Fraction, push: Fraction) -> Row:
    """P(. | cell, action)."""
    if cell in DEAD_ENDS:
        intended, right = cell, push
    else:
        intended, right = _move(number, cell, action), drag
    row = {number[intended]: 1 - right}
    forced = number[_move(number, cell, RIGHT)]
    row[forced] = row.get(forced, Fraction(0)) + right
    return row


def _move(number: dict[Cell, int], cell: Cell, action: int) -> Cell:
    dx, dy = MOVES[action]
    moved = (cell[0] + dx, cell[1] + dy)
    return moved if moved in number else cell
