"""Two finite models that enclose a continuous safe set.

A continuous state space is cut into cells. For each cell and control, ``successors`` are all
cells that some point of the cell may reach (and perhaps more). Two readings of them enclose
the set of points from which a violation can be avoided for ever:

    inner   which of the successors comes is chance: safe <=> P_min(F fail) = 0. Every
            point of an inner-safe cell is safe.
    outer   which of them comes is the agent's choice, an action of its own. No point of a
            cell outside the outer safe set is safe.

The proof is a line each: an inner-safe cell has a control whose successors are all inner
safe, and the run of each of its points stays in such cells; the run of a safe point visits
cells that the outer agent may choose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = ["Bracket", "Grid", "bracket"]


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of a box, numbered with the last coordinate fastest.

    Attributes:
        lower: the least corner of the box.
        width: a cell's width in each coordinate.
        shape: the number of cells in each coordinate.
    """

    lower: tuple[float, ...]
    width: tuple[float, ...]
    shape: tuple[int, ...]

    @property
    def num_cells(self) -> int:
        """The number of cells; it is also the number of the state "outside"."""
        return int(np.prod(self.shape))

    def indices(self) -> NDArray[np.int64]:
        """int (cells, D): the place of each cell in each coordinate."""
        return np.indices(self.shape).reshape(len(self.shape), -1).T

    def corners(self) -> NDArray[np.float64]:
        """(cells, D): each cell's least corner; it extends by ``width``."""
        offsets: NDArray[np.float64] = self.indices() * np.array(self.width)
        return self.lower + offsets

    def centres(self) -> NDArray[np.float64]:
        """(cells, D): the coordinates of each cell's centre."""
        return self.corners() + np.array(self.width) / 2

    def cell_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """The cell of each point (..., D); ``num_cells`` for points outside the box."""
        index = np.floor((points - np.array(self.lower)) / np.array(self.width)).astype(np.int64)
        inside = ((index >= 0) & (index < np.array(self.shape))).all(axis=-1)
        flat = np.ravel_multi_index(
            tuple(np.moveaxis(index, -1, 0)), self.shape, mode="clip"
        ).astype(np.int64)
        return np.where(inside, flat, self.num_cells)


@dataclass(frozen=True, eq=False)
class Bracket:
    """The two models over the same states: the grid's cells, then "outside", which fails.

    Attributes:
        inner: one action a control; stochastic. The probabilities mean nothing, only
            which of them are positive.
        outer: one action for each control and successor; deterministic.
        grid: the cells' coordinates.
    """

    inner: SafeMDP
    outer: SafeMDP
    grid: Grid


def bracket(
    grid: Grid,
    successors: NDArray[np.int32],
    controls: Sequence[str],
    geometry: Geometry,
    *,
    touches_fail: NDArray[np.bool_] | None = None,
    inside_fail: NDArray[np.bool_] | None = None,
) -> Bracket:
    """The enclosing models of a system whose cells' successors are known.

    Args:
        grid: the cells.
        successors: int32 (cells, controls, K): all that may follow, -1 for none,
            ``grid.num_cells`` for "outside".
        controls: their names.
        geometry: where the states (with "outside") are drawn.
        touches_fail, inside_fail: bool (cells,): some, all points of the cell are
            violations. None: no cell.
    """
    no_cell = np.zeros(grid.num_cells, dtype=np.bool_)
    inner_fail = np.append(no_cell if touches_fail is None else touches_fail, True)
    outer_fail = np.append(no_cell if inside_fail is None else inside_fail, True)
    choices = successors.shape[2]
    outside = np.full((1, *successors.shape[1:]), -1, dtype=np.int32)
    table = np.concatenate((successors, outside))
    return Bracket(
        inner=SafeMDP.stochastic(
            _uniform(table), inner_fail, action_names=controls, geometry=geometry
        ),
        outer=SafeMDP.deterministic(
            table.reshape(len(table), -1),
            outer_fail,
            action_names=[f"{name}, outcome {k}" for name in controls for k in range(choices)],
            geometry=replace(geometry, arrows=None),
        ),
        grid=grid,
    )


def _uniform(table: NDArray[np.int32]) -> sparse.csr_array[np.float64]:
    """CSR (S*A, S): each successor of a row with the same probability."""
    num_states, num_actions, _ = table.shape
    rows = table.reshape(num_states * num_actions, -1)
    counts = (rows >= 0).sum(axis=1)
    indptr = np.concatenate(([0], np.cumsum(counts)))
    data = np.repeat(1 / np.maximum(counts, 1), counts)
    return sparse.csr_array((data, rows[rows >= 0], indptr), shape=(len(rows), num_states))
