"""The models that the benchmarks measure: families that grow to any size.

Built with numpy, straight into arrays: nothing here is measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


@dataclass(frozen=True, eq=False)
class Table:
    """A deterministic model as arrays: ``next_state`` int32 (S, A) and ``fail`` bool (S,)."""

    name: str
    next_state: NDArray[np.int32]
    fail: NDArray[np.bool_]


def brake(num_states: int) -> Table:
    """A car before a wall: distance x speed, accelerations -2 to 2; about a third is dead.

    The speed changes first, then the car moves; the last state is the crash. A car at speed v
    needs about v**2 / 4 cells to stop, so with V speeds and V**2 / 3.84 distances the share of
    dead states does not depend on the size, and H grows as V / 2.
    """
    speeds = max(3, round((3.84 * num_states) ** (1 / 3)))
    distances = max(2, num_states // speeds)
    crash = distances * speeds
    distance = np.repeat(np.arange(distances, dtype=np.int32), speeds)
    speed = np.tile(np.arange(speeds, dtype=np.int32), distances)
    next_state = np.empty((crash + 1, 5), dtype=np.int32)
    for action, acceleration in enumerate((-2, -1, 0, 1, 2)):
        later = np.clip(speed + acceleration, 0, speeds - 1)
        ahead = distance - later
        next_state[:crash, action] = np.where(ahead < 0, crash, ahead * speeds + later)
    next_state[crash] = crash
    fail = np.zeros(crash + 1, dtype=np.bool_)
    fail[crash] = True
    return Table("brake", next_state, fail)


def grid(num_states: int, seed: int = 0) -> Table:
    """A square map: four moves, 10% walls, 3% lava, and blocks of cells that force a move.

    In a forced cell every move goes the way of its block, so that lava at the block's edge
    makes whole stretches of it dead. Walls are states that nobody enters; bumping stays.
    """
    rng = np.random.default_rng(seed)
    side = max(4, round(num_states**0.5))
    draw = rng.random((side, side))
    wall, lava = draw < 0.1, (draw >= 0.1) & (draw < 0.13)
    blocks = -(-side // 16)
    forced = np.kron(rng.random((blocks, blocks)) < 0.1, np.ones((16, 16), dtype=np.bool_))
    way = np.kron(rng.integers(0, 4, (blocks, blocks)), np.ones((16, 16), dtype=np.int64))
    cell = np.arange(side * side, dtype=np.int32).reshape(side, side)
    moves = np.empty((4, side, side), dtype=np.int32)
    for action, (down, right) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
        ahead = np.pad(cell, 1, mode="edge")[
            1 + down : 1 + down + side, 1 + right : 1 + right + side
        ]
        moves[action] = np.where(wall.ravel()[ahead], cell, ahead)
    row, column = np.indices((side, side), sparse=True)
    one_way = moves[way[:side, :side], row, column]
    moves = np.where(forced[:side, :side] & (one_way != cell), one_way, moves)
    next_state = np.ascontiguousarray(moves.reshape(4, -1).T)
    return Table("grid", next_state, lava.ravel() & ~wall.ravel())


def corridor(num_states: int, horizon: int) -> Table:
    """Half the states lie in corridors of ``horizon`` cells that end in fail.

    From the other half one may enter the mouth of a corridor or stay. Two actions.
    """
    corridors = max(1, num_states // 2 // horizon)
    cells = np.arange(corridors * horizon, dtype=np.int32)
    fail_state = len(cells)
    ahead = np.where(cells % horizon == 0, fail_state, cells - 1).astype(np.int32)
    mouths = np.arange(corridors, dtype=np.int32) * horizon + horizon - 1
    outside = np.arange(fail_state + 1, max(fail_state + 2, num_states), dtype=np.int32)
    next_state = np.empty((outside[-1] + 1, 2), dtype=np.int32)
    next_state[:fail_state] = ahead[:, None]
    next_state[fail_state] = fail_state
    next_state[outside, 0] = mouths[np.arange(len(outside)) % corridors]
    next_state[outside, 1] = outside
    fail = np.zeros(len(next_state), dtype=np.bool_)
    fail[fail_state] = True
    return Table("corridor", next_state, fail)


def renumbered(table: Table, seed: int = 0) -> Table:
    """The same model, its states numbered at random."""
    new = np.random.default_rng(seed).permutation(len(table.fail)).astype(np.int32)
    old = np.empty_like(new)
    old[new] = np.arange(len(new), dtype=np.int32)
    next_state = new[table.next_state[old]]
    return Table(f"{table.name}, random numbers", next_state, table.fail[old])


@dataclass(frozen=True, eq=False)
class Kernel:
    """A stochastic model as arrays: CSR (S*A, S), row s*A + a, and ``fail`` bool (S,)."""

    name: str
    P: sparse.csr_array[np.float64]
    fail: NDArray[np.bool_]


def mixture(name: str, tables: NDArray[np.int32], fail: NDArray[np.bool_]) -> Kernel:
    """An action leads to each of its K ``tables[:, :, k]``, int32 (S, A, K), equally likely."""
    num_states, num_actions, outcomes = tables.shape
    rows = num_states * num_actions
    P = sparse.csr_array(
        (
            np.full(rows * outcomes, 1 / outcomes),
            tables.reshape(-1),
            np.arange(0, rows * outcomes + 1, outcomes),
        ),
        shape=(rows, num_states),
    )
    P.sum_duplicates()
    return Kernel(name, P, fail)


def slippery(table: Table) -> Kernel:
    """One time in two another action is executed: the next one of the table."""
    tables = np.stack((table.next_state, np.roll(table.next_state, 1, axis=1)), axis=2)
    return mixture(f"slippery {table.name}", tables, table.fail)


def scattered(num_states: int, seed: int = 0) -> Kernel:
    """Two actions with two successors each, at random; one state in twenty fails.

    Of the others 70% only meet states of their own kind with higher numbers, or fail: they are
    dead. The rest go anywhere, but for one in a thousand that stay where they are: these are
    safe, and most that can reach them at risk.
    """
    rng = np.random.default_rng(seed)
    tables = rng.integers(0, num_states, (num_states, 2, 2), dtype=np.int32)
    kind = rng.random(num_states)
    doomed = rng.random(num_states) < 0.7
    fail = kind < 0.05
    fates = np.sort(np.flatnonzero(doomed | fail)).astype(np.int32)
    after = np.searchsorted(fates, np.flatnonzero(doomed), side="right")
    steps = rng.integers(0, 50, (len(after), 2, 2))
    last = np.flatnonzero(fail)[-1]
    ahead = fates[np.minimum(after[:, None, None] + steps, len(fates) - 1)]
    tables[doomed] = np.where(ahead > last, last, ahead)
    stays = np.flatnonzero((kind > 0.999) & ~doomed)
    tables[stays] = stays[:, None, None]
    return mixture("scattered", tables, fail)
