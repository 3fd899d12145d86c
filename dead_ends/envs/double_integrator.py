"""A double integrator between two walls, enclosed exactly.

A point with position x and velocity v in a corridor of length L; in each time step the
control u in {-1, 0, 1} is held. With time in steps, velocity in units of the change that one
step makes (a dt) and position in units of a dt**2,

    x' = x + v + u/2,    v' = v + u;    violation: x < 0, x >= L, v < -V or v >= V

at the ends of the steps. Cells are squares of width 1/k. Everything is a multiple of 1/(2k),
so the successors of a cell are found in integers: nothing is rounded.

The true safe set is known: with P(v) = n v - n**2 / 2, n = floor(v + 1/2), how far braking
lets it go on, and L, V >= 2, a point of the box is safe <=> x + P(v) < L if v >= 0,
x - P(-v) >= 0 if v < 0. (Braking hardest ends at |v| <= 1/2, from where it can go to and fro.)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dead_ends.envs.bracket import Bracket, Grid, bracket
from dead_ends.model.safe_mdp import Geometry

__all__ = ["double_integrator"]

CONTROLS = ("left", "coast", "right")


def double_integrator(
    length: int = 20,
    max_speed: int = 6,
    resolution: int = 4,
    *,
    acceleration: float = 1.0,
    time_step: float = 1.0,
) -> Bracket:
    """The models that enclose the double integrator's safe set.

    Args:
        length: L, in units of acceleration * time_step**2; at least 2.
        max_speed: V, in units of acceleration * time_step; at least 2.
        resolution: k, the cells in each unit.
        acceleration, time_step: the units of the coordinates, in m/s² and s.

    Raises:
        ValueError: for a size below its least, or a unit that is not positive and finite.
    """
    for name, value, least in (
        ("length", length, 2),
        ("max_speed", max_speed, 2),
        ("resolution", resolution, 1),
    ):
        if value < least:
            raise ValueError(f"{name} must be at least {least}, not {value}")
    for name, size in (("acceleration", acceleration), ("time_step", time_step)):
        if not 0 < size < math.inf:
            raise ValueError(f"{name} must be positive and finite, not {size}")
    speed_unit = acceleration * time_step
    unit = np.array([speed_unit * time_step, speed_unit])
    lower, width = np.array([0, -max_speed]) * unit, unit / resolution
    grid = Grid(
        lower=tuple(lower.tolist()),
        width=tuple(width.tolist()),
        shape=(length * resolution, 2 * max_speed * resolution),
    )
    return bracket(grid, _successors(grid, max_speed, resolution), CONTROLS, _geometry(grid))


def _successors(grid: Grid, max_speed: int, resolution: int) -> NDArray[np.int32]:
    """int32 (cells, 3, 3): the cells that a cell's points reach; half-open, so exact.

    With x in [i, i + 1) / k and v in [j, j + 1) / k, x' covers ((2 i + 2 j + u k) / 2k,
    (2 i + 2 j + u k + 4) / 2k), two cells or, if u k is odd, three.
    """
    position, row = (column[:, None, None] for column in grid.indices().T)
    control = np.array([-1, 0, 1])[:, None]
    velocity = row - max_speed * resolution  # j
    twice_first = 2 * (position + velocity) + control * resolution
    target = twice_first // 2 + np.arange(3)
    reached = 2 * target < twice_first + 4
    target_row = row + control * resolution
    positions, rows = grid.shape
    inside = (target >= 0) & (target < positions) & (target_row >= 0) & (target_row < rows)
    cell = np.where(inside, target * rows + target_row, grid.num_cells)
    return np.where(reached, cell, -1).astype(np.int32)


def _geometry(grid: Grid) -> Geometry:
    return Geometry(
        cell=np.append(grid.indices(), [[-1, -1]], axis=0).astype(np.int32),
        x_label="position [m]",
        y_label="velocity [m/s]",
        origin=(grid.lower[0] + grid.width[0] / 2, grid.lower[1] + grid.width[1] / 2),
        step=(grid.width[0], grid.width[1]),
        arrows=((-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)),
    )
