"""Gridworlds from text maps: walls, lava, ice, one-way cells, goals.

    .  floor                        #  wall (so is everything outside the map)
    S  start (a floor cell)         G  goal: terminal
    L  lava: a violation            ~  ice
    < > ^ v  a one-way cell, a current: whatever the agent does, it is carried one cell that way

The four actions move one cell; a move into a wall stays. A move that enters ice goes on in
its direction until it leaves the ice or hits a wall. With slip probability p an action goes
to its left or right instead, p/2 each; currents do not slip.

Lava alone makes no dead-ends but floor that it encloses on all four sides: elsewhere the
agent can walk to and fro, or into a wall, for ever. Dead-ends need a current that ends in
lava (its cells die one after another, T counts them) or ice whose every way out does.
FrozenLake and MiniGrid's lava maps have neither.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from dead_ends.envs.transition_rows import Row, probability, safe_mdp_from_rows
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = ["ACTIONS", "CURRENTS", "DEFAULT_MAP", "gridworld", "parse_map"]

ACTIONS = ("left", "down", "right", "up")
"""In Gymnasium's order; the neighbours of an action in it are its sideways slips."""

DIRECTIONS = ((0, -1), (1, 0), (0, 1), (-1, 0))
CURRENTS = {"<": 0, "v": 1, ">": 2, "^": 3}
"""The action that each current forces."""

SYMBOLS = ".#SGL~<>^v"

DEFAULT_MAP = """
####################
#S.................#
#....~~~~~~~~~~....#
#>>>>..>>>>>>>>>>>L#
#>>>>..>>>>>^>>>>>L#
#>>>>..>>>>>>>>>>>L#
#....~~~~~~~~~~....#
#......##.......~~~#
#..LL..##..~~~..~~~#
#......##..~L~..~~G#
####################
"""

Cell = tuple[int, int]


def gridworld(text: str | Sequence[str] = DEFAULT_MAP, slip: float | Fraction = 0) -> SafeMDP:
    """The safe MDP of a text map; its states are the cells that are not walls, row by row.

    Without slip the model is deterministic. A slip given as a Fraction makes it exact (for
    maps of some hundred cells). The reward is 1 for reaching a goal. If there are several
    starts, one is drawn uniformly.

    Raises:
        ValueError: naming the row and column of what is wrong with the map (both counted
            from 0), or a slip outside [0, 1].
    """
    slip_probability = probability("slip", slip)
    grid = parse_map(text)
    cells = [cell for cell, symbol in grid.items() if symbol != "#"]
    number = {cell: state for state, cell in enumerate(cells)}
    symbols = np.array([grid[cell] for cell in cells])
    goal = symbols == "G"
    return safe_mdp_from_rows(
        [[_row(grid, number, cell, a, slip_probability) for a in range(4)] for cell in cells],
        symbols == "L",
        terminal=goal,
        exact=isinstance(slip, Fraction),
        entry_reward=lambda state: float(goal[state]),
        initial=symbols == "S",
        state_names=[f"row {row}, column {column}" for row, column in cells],
        action_names=ACTIONS,
        geometry=_geometry(grid, cells),
    )


def parse_map(text: str | Sequence[str]) -> dict[Cell, str]:
    """The symbol of each cell (row, column) of a map, row by row; see :func:`gridworld`."""
    lines = inspect.cleandoc(text).splitlines() if isinstance(text, str) else list(text)
    if not lines or not lines[0]:
        raise ValueError("the map is empty")
    for row, line in enumerate(lines):
        if len(line) != len(lines[0]):
            raise ValueError(
                f"row {row} of the map has {len(line)} cells, but row 0 has {len(lines[0])}"
            )
    grid = {
        (row, column): symbol
        for row, line in enumerate(lines)
        for column, symbol in enumerate(line)
    }
    for (row, column), symbol in grid.items():
        if symbol not in SYMBOLS:
            raise ValueError(
                f"row {row}, column {column} of the map: unknown cell {symbol!r}; "
                f"known are {' '.join(SYMBOLS)}"
            )
    if "S" not in grid.values():
        raise ValueError("the map has no start S")
    return grid


def _row(
    grid: dict[Cell, str], number: dict[Cell, int], cell: Cell, action: int, slip: Fraction
) -> Row:
    """P(. | cell, action)."""
    symbol = grid[cell]
    if symbol in "LG":
        return {}
    if symbol in CURRENTS:
        return {number[_move(grid, cell, CURRENTS[symbol])]: Fraction(1)}
    row: dict[int, Fraction] = {}
    for turn, p in ((0, 1 - slip), (1, slip / 2), (-1, slip / 2)):
        successor = number[_move(grid, cell, (action + turn) % 4)]
        row[successor] = row.get(successor, Fraction(0)) + p
    return row


def _move(grid: dict[Cell, str], cell: Cell, direction: int) -> Cell:
    """One cell in a direction, and on over ice."""
    down, right = DIRECTIONS[direction]
    while True:
        ahead = (cell[0] + down, cell[1] + right)
        if grid.get(ahead, "#") == "#":
            return cell
        cell = ahead
        if grid[cell] != "~":
            return cell


def _geometry(grid: dict[Cell, str], cells: list[Cell]) -> Geometry:
    return Geometry(
        cell=np.array([(column, row) for row, column in cells], dtype=np.int32),
        y_down=True,
        walls=tuple((column, row) for (row, column), symbol in grid.items() if symbol == "#"),
        arrows=tuple((float(right), float(-down)) for down, right in DIRECTIONS),
    )
