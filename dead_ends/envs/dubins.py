"""A Dubins car in a walled square with a round pillar, enclosed by interval arithmetic.

The car drives at a constant speed: it can turn, but not stop. Lengths are in units of what it
drives in a time step. In each step it follows an arc that turns its heading h by u delta,
u in {-1, 0, 1}; with c(u) = sin(u delta / 2) / (u delta / 2), c(0) = 1, the arc's chord,

    x' = x + c(u) cos(h + u delta / 2),   y' = y + c(u) sin(h + u delta / 2),   h' = h + u delta.

Violation, at the ends of the steps: outside [0, L] x [0, L], or nearer than r to its centre.

Headings are cut into n cells, and delta is m of them, so the heading's cell is exact. Positions
are enclosed: the image of the whole cell lies in a box, rounded outward by far more than the
floating-point errors made; all closed cells that meet the box are successors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dead_ends.envs.bracket import Bracket, Grid, bracket
from dead_ends.model.safe_mdp import Geometry

__all__ = ["dubins"]

CONTROLS = ("right", "straight", "left")

OUTWARD = 1e-12
"""Outward rounding, relative to L: thousands of times the error of the few operations."""

Floats = NDArray[np.float64]
Range = tuple[Floats, Floats]
"""Lower and upper bounds."""


def dubins(
    length: int = 8,
    resolution: int = 4,
    headings: int = 32,
    turn: int = 5,
    pillar_radius: float = 1.0,
    *,
    drawn_heading: int = 0,
) -> Bracket:
    """The models that enclose the Dubins car's safe set.

    Args:
        length: L, the side of the square, in steps.
        resolution: position cells in the length of a step.
        headings: n, cells of the heading; even. Cell 0 begins at the direction of x.
        turn: m, how many of them the heading turns in a step; at least 1, below n / 2.
        pillar_radius: r, in steps; 0: no pillar.
        drawn_heading: the heading whose cells the geometry shows.

    Raises:
        ValueError: for a parameter out of its range.
    """
    _check(length, resolution, headings, turn, pillar_radius, drawn_heading)
    width = 1 / resolution
    grid = Grid(
        lower=(0.0, 0.0, 0.0),
        width=(width, width, 2 * np.pi / headings),
        shape=(length * resolution, length * resolution, headings),
    )
    nearest, farthest = _centre_distances(length, resolution)
    shape = (*grid.shape[:2], headings)
    return bracket(
        grid,
        _successors(grid, length, turn),
        CONTROLS,
        _geometry(grid, drawn_heading),
        touches_fail=np.broadcast_to(
            (nearest < pillar_radius + OUTWARD * length)[:, :, None] & (pillar_radius > 0), shape
        ).ravel(),
        inside_fail=np.broadcast_to(
            (farthest < pillar_radius - OUTWARD * length)[:, :, None], shape
        ).ravel(),
    )


def _check(
    length: int, resolution: int, headings: int, turn: int, pillar_radius: float, drawn: int
) -> None:
    for name, value in (("length", length), ("resolution", resolution)):
        if value < 1:
            raise ValueError(f"{name} must be at least 1, not {value}")
    if headings < 4 or headings % 2:
        raise ValueError(f"headings must be even and at least 4, not {headings}")
    if not 1 <= turn < headings / 2:
        raise ValueError(f"turn must be at least 1 and below headings / 2, not {turn}")
    if not 0 <= pillar_radius < np.inf:
        raise ValueError(f"pillar_radius must be finite and at least 0, not {pillar_radius}")
    if not 0 <= drawn < headings:
        raise ValueError(f"drawn_heading must lie in 0 to {headings - 1}, not {drawn}")


def _successors(grid: Grid, length: int, turn: int) -> NDArray[np.int32]:
    """int32 (cells, 3, K): the cells that meet the enclosing box, then "outside"."""
    positions, _, headings = grid.shape
    control = np.array([-1, 0, 1])
    half_turn = turn * np.pi / headings
    chord = np.where(control == 0, 1.0, np.sin(half_turn) / half_turn)
    # In units of pi / n the middle heading of the arc covers [middle, middle + 2].
    middle = 2 * np.arange(headings)[:, None] + control * turn
    across = [
        _cells_met(_scaled(_cosine(middle - shift, headings), chord), positions, length)
        for shift in (0, headings // 2)  # sin h = cos(h - pi / 2)
    ]
    (x, x_leaves), (y, y_leaves) = across  # (positions, headings, 3, ...)
    target = (np.arange(headings)[:, None] + control * turn) % headings
    x, y = x[:, None, ..., :, None], y[None, ..., None, :]
    cell = np.where(
        (x >= 0) & (y >= 0), (x * positions + y) * headings + target[..., None, None], -1
    )
    leaves = x_leaves[:, None] | y_leaves[None]
    outside = np.where(leaves, grid.num_cells, -1)
    cells = cell.reshape(grid.num_cells, len(control), -1)
    return np.concatenate((cells, outside.reshape(grid.num_cells, len(control), 1)), axis=2).astype(
        np.int32
    )


def _cosine(first: NDArray[np.int64], headings: int) -> Range:
    """Bounds of cos over [first, first + 2] * pi / headings, up to rounding.

    Whether the interval holds a maximum (a multiple of 2 n) or a minimum is decided in integers.
    """
    ends = np.cos(np.stack((first, first + 2)) * (np.pi / headings))
    has_maximum = -first % (2 * headings) <= 2
    has_minimum = (headings - first) % (2 * headings) <= 2
    return (
        np.where(has_minimum, -1.0, ends.min(axis=0)),
        np.where(has_maximum, 1.0, ends.max(axis=0)),
    )


def _scaled(bounds: Range, chord: Floats) -> Range:
    return bounds[0] * chord, bounds[1] * chord


def _cells_met(
    displacement: Range, positions: int, length: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The position cells reached along one axis, and whether the walls may be passed.

    Returns:
        int (positions, headings, 3, K), -1 for none; bool (positions, headings, 3).
    """
    edges = np.linspace(0, length, positions + 1)
    low = edges[:-1, None, None] + displacement[0] - OUTWARD * length
    high = edges[1:, None, None] + displacement[1] + OUTWARD * length
    first = np.searchsorted(edges[1:], low, side="left")
    last = np.searchsorted(edges[:-1], high, side="right") - 1
    most = int((last - first).max()) + 1
    met = first[..., None] + np.arange(most)
    return np.where(met <= last[..., None], met, -1), (low < 0) | (high > length)


def _centre_distances(length: int, resolution: int) -> Range:
    """(positions, positions), the least and greatest distance of a cell from the centre."""
    edges = np.linspace(0, length, length * resolution + 1) - length / 2
    low, high = edges[:-1], edges[1:]
    nearest = np.maximum(np.maximum(low, -high), 0)
    farthest = np.maximum(high, -low)
    return (
        np.hypot(nearest[:, None], nearest[None]),
        np.hypot(farthest[:, None], farthest[None]),
    )


def _geometry(grid: Grid, drawn_heading: int) -> Geometry:
    indices = grid.indices()
    drawn = np.where(indices[:, 2:] == drawn_heading, indices[:, :2], -1)
    half = grid.width[0] / 2
    return Geometry(
        cell=np.append(drawn, [[-1, -1]], axis=0).astype(np.int32),
        x_label="x [steps]",
        y_label="y [steps]",
        origin=(half, half),
        step=(grid.width[0], grid.width[1]),
    )
