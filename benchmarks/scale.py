"""How large a model fits: ``python -m benchmarks.scale [--largest 1e9]``.

Tables in memory and memory-mapped, a table of more than 2**31 entries, and models given by
compiled functions, at two bytes a state. Where two ways meet, their answers are compared on
every state. Writes ``results/scale.json``.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.labels import agree
from benchmarks.measure import best_time, extra_memory, save
from dead_ends import INFINITE, SafeMDP, classify
from dead_ends.labels.implicit import SURVIVES, _entered, _start, _sweep, classify_implicit
from dead_ends.labels.retrograde import compiled

FREE, WALL, LAVA, FORCED = 0, 1, 2, 3
"""What a cell of the map is; FORCED + m: every move is move m (up, down, left, right)."""


def grid_functions(side: int) -> tuple[Any, Any]:
    """Four moves on a square map; a wall or the edge stops the move; lava fails.

    The side is a constant for the compiler, so that dividing by it is cheap.
    """

    @njit
    def successor(state: int, action: int, cells: NDArray[np.uint8]) -> int:
        if cells[state] >= FORCED:
            action = int(cells[state]) - FORCED
        row = state // side
        column = state - row * side
        row += (action == 1) - (action == 0)
        column += (action == 3) - (action == 2)
        if row < 0 or row >= side or column < 0 or column >= side:
            return state
        ahead = row * side + column
        return state if cells[ahead] == WALL else ahead

    @njit
    def fail(state: int, cells: NDArray[np.uint8]) -> bool:
        return bool(cells[state] == LAVA)

    return successor, fail


def brake_functions(speeds: int, crash: int) -> tuple[Any, Any]:
    """The brake of :mod:`benchmarks.models`, by its formula."""

    @njit
    def successor(state: int, action: int) -> int:
        distance = state // speeds
        speed = min(max(state - distance * speeds + action - 2, 0), speeds - 1)
        return crash if distance < speed else (distance - speed) * speeds + speed

    @njit
    def fail(state: int) -> bool:
        return state == crash

    return successor, fail


@compiled
def grid_cells(side: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A map of 10% walls, 3% lava, and blocks of 16 x 16 cells, a tenth of which force a move."""
    cells = np.empty(side * side, dtype=np.uint8)
    blocks = rng.integers(0, 40, (side // 16 + 1, side // 16 + 1))
    for row in range(side):
        for column in range(side):
            draw = rng.random()
            kind = WALL if draw < 0.1 else LAVA if draw < 0.13 else FREE
            block = blocks[row // 16, column // 16]
            if kind == FREE and block < 4:
                kind = FORCED + block
            cells[row * side + column] = kind
    return cells


@compiled
def tabulate(
    successor: Callable[..., int], data: tuple[Any, ...], num_states: int, num_actions: int
) -> NDArray[np.int32]:
    """The table of a successor function."""
    table = np.empty((num_states, num_actions), dtype=np.int32)
    for state in range(num_states):
        for action in range(num_actions):
            table[state, action] = successor(state, action, *data)
    return table


@compiled
def behind(state: int, _action: int) -> int:
    """A corridor: every action leads one state down, and 0 fails."""
    return max(state - 1, 0)


def same_times(table_time: NDArray[np.int32], implicit_time: NDArray[np.uint16]) -> bool:
    """Whether both ways of counting agree on every state."""
    chunk = 1 << 24
    return all(
        np.array_equal(
            np.where((t := table_time[i : i + chunk]) == INFINITE, SURVIVES, t),
            implicit_time[i : i + chunk],
        )
        for i in range(0, len(table_time), chunk)
    )


def grid_rows(size: int, *, table: bool, folder: Path) -> list[dict[str, Any]]:
    """A grid on the fly and, if asked, as a table in memory and in a file."""
    side = round(size**0.5)
    cells = grid_cells(side, np.random.default_rng(0))
    successor, fail = grid_functions(side)
    rows = [implicit_row("grid", successor, fail, side * side, 4, (cells,))]
    time = rows[0].pop("survival_time")
    if table:
        next_state = tabulate(successor, (cells,), side * side, 4)
        rows.append(table_row("grid", next_state, cells == LAVA, time))
        file = folder / "table.npy"
        np.save(file, next_state)
        del next_state
        mapped = np.load(file, mmap_mode="r")
        rows.append(table_row("grid, memory-mapped", mapped, cells == LAVA, time))
        file.unlink()
    return rows


def brake_row(size: int) -> dict[str, Any]:
    """The brake on the fly."""
    speeds = round((3.84 * size) ** (1 / 3))
    crash = size // speeds * speeds
    successor, fail = brake_functions(speeds, crash)
    row = implicit_row("brake", successor, fail, crash + 1, 5, ())
    del row["survival_time"]
    return row


def implicit_row(
    family: str,
    successor: Any,
    fail: Any,
    num_states: int,
    num_actions: int,
    data: tuple[Any, ...],
) -> dict[str, Any]:
    """One row of a model on the fly; the kernels are compiled before the clock starts."""
    empty = np.empty(0, dtype=np.uint16)
    _start(fail, data, empty, 0, 0)
    _sweep(successor, num_actions, data, empty, 0, 0, True)
    _entered(successor, num_actions, data, empty, 0, 0)
    seconds, result = best_time(
        lambda: classify_implicit(successor, fail, num_states, num_actions, data=data), 1
    )
    memory = result.survival_time.nbytes
    return {
        "family": f"{family}, on the fly",
        "states": num_states,
        "actions": num_actions,
        "H": result.horizon,
        "H_b": result.boundary_horizon,
        "sweeps": result.sweeps,
        "seconds": seconds,
        "bytes_per_state": memory / num_states,
        "survival_time": result.survival_time,
    }


def table_row(
    family: str,
    next_state: NDArray[np.int32],
    fail: NDArray[np.bool_],
    expected: NDArray[np.uint16] | None,
) -> dict[str, Any]:
    """One row of a model with a table, validated and solved; compared with the other way."""
    build, model = best_time(lambda: SafeMDP.deterministic(next_state, fail), 1)
    agree(np.shares_memory(model.next_state, next_state), "the table is adopted, not copied")
    seconds, result = best_time(lambda: classify(model), 1)
    if expected is not None:
        agree(same_times(result.survival_time, expected), "the table and the function")
    del result
    return {
        "family": f"{family}, table",
        "states": model.num_states,
        "actions": model.num_actions,
        "build": build,
        "seconds": seconds,
        "bytes_per_state": extra_memory(lambda: classify(model)) / model.num_states,
    }


def wide_row() -> dict[str, Any]:
    """A table of 2.2e9 entries, so that places in it exceed 32 bits: one long corridor."""
    num_states = 22_000_000
    table = tabulate(behind, (), num_states, 100)
    fail = np.arange(num_states) == 0
    row = table_row("corridor, 100 actions", table, fail, None)
    time = classify(SafeMDP.deterministic(table, fail)).survival_time
    agree(np.array_equal(time, np.arange(num_states)), "the corridor's closed form")
    return row | {"H": int(time[-1])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.scale")
    parser.add_argument("--largest", type=float, default=1e9, help="most states (default 1e9)")
    largest = int(parser.parse_args().largest)
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    started = perf_counter()
    classify(SafeMDP.deterministic(np.array([[0]], dtype=np.int32), np.array([False])))
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for size in (size for size in (10**7, 10**8, 10**9) if size <= largest):
            found = grid_rows(size, table=size <= 10**8, folder=Path(folder))
            found.append(brake_row(size))
            for row in found:
                print(row, flush=True)
            rows += found
    if largest >= 10**8:
        rows.append(wide_row())
        print(rows[-1], flush=True)
    print(save("scale", {"largest": largest}, rows, perf_counter() - started))


if __name__ == "__main__":
    main()
