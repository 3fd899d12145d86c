"""Labels and survival times beside Storm and QuantEcon: ``python -m benchmarks.labels``.

From a successor table in memory to the label and the survival time of every state. All tools
get the same models, in one run, on one core; their answers are compared on every state.
Writes ``results/labels.json``; ``python -m benchmarks.draw`` makes the figures.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy import sparse

from benchmarks import models, peers
from benchmarks.measure import best_time, extra_memory, save
from benchmarks.models import Table
from dead_ends import INFINITE, Label, SafeMDP, classify
from dead_ends.labels.labelling import Labelling

QUANTECON_MAX_HORIZON = 1_000
"""Its sweeps cost S * A each: beyond, minutes a model."""


def ours(table: Table) -> tuple[dict[str, Any], Labelling]:
    """Validation and labels, with the memory that the labelling took."""
    build, model = best_time(lambda: SafeMDP.deterministic(table.next_state, table.fail))
    solve, labelling = best_time(lambda: classify(model))
    memory = extra_memory(lambda: classify(model)) / model.num_states
    return {
        "ours_build": build,
        "ours_solve": solve,
        "ours_bytes_per_state": memory,
    }, labelling


def storm(table: Table, expected: Labelling, folder: Path) -> dict[str, Any]:
    """Storm's times; every label and survival time must be ours."""
    num_states, num_actions = table.next_state.shape
    target = np.where(table.fail[:, None], np.arange(num_states)[:, None], table.next_state)
    kernel = sparse.csr_array(
        (np.ones(target.size), target.ravel(), np.arange(target.size + 1)),
        shape=(target.size, num_states),
    )
    file = folder / "model.umb"
    write, _ = best_time(lambda: peers.write_umb(file, kernel, num_actions, table.fail), 1)
    repeats = 3 if num_states <= 10**6 else 1
    build, model = best_time(lambda: peers.storm_model(file), repeats)
    labels, (zero, one) = best_time(lambda: peers.storm_labels(model), repeats)
    solve, result = best_time(lambda: peers.storm_times(model), repeats)
    agree(np.array_equal(peers.mask(zero, num_states), expected.safe), "Storm: P_min = 0")
    agree(np.array_equal(peers.mask(one, num_states), ~expected.safe), "Storm: P_min = 1")
    time = peers.times(result)
    finite = np.isfinite(time)
    agree(np.array_equal(finite, ~expected.safe), "Storm: finite times")
    agree(np.array_equal(time[finite], expected.survival_time[finite]), "Storm: times")
    file.unlink()
    return {"storm_write": write, "storm_build": build, "storm_labels": labels, "storm_T": solve}


def quantecon(table: Table, expected: Labelling) -> dict[str, Any]:
    """QuantEcon's times; with beta**H >= 1/3 its labels must be ours, its V our beta**(T-1)."""
    assert expected.horizon is not None
    if expected.horizon > QUANTECON_MAX_HORIZON:
        return {}
    beta = 1 - 1 / max(100, expected.horizon)
    build, model = best_time(lambda: peers.quantecon_model(table.next_state, table.fail, beta), 1)
    solve, cost = best_time(lambda: peers.quantecon_cost(model), 1)
    time = expected.survival_time
    dead = expected.dead
    agree(np.array_equal(cost > beta**expected.horizon / 2, dead), "QuantEcon: dead states")
    agree(
        bool(np.allclose(cost[dead], beta ** (time[dead] - 1.0), rtol=0, atol=1e-3)),
        "QuantEcon: values",
    )
    return {"quantecon_build": build, "quantecon_V": solve, "quantecon_beta": beta}


SMALL = (np.array([[1], [1]], dtype=np.int32), np.array([False, True]))


def agree(same: bool, what: str) -> None:
    """Two tools give the same answer, or there is no result."""
    if not same:
        raise SystemExit(f"answers differ: {what}")


def measure(table: Table, *, with_quantecon: bool, folder: Path) -> dict[str, Any]:
    """One row: a model, our times and theirs, in seconds."""
    row, labelling = ours(table)
    row |= storm(table, labelling, folder)
    if with_quantecon:
        row |= quantecon(table, labelling)
    facts = {
        "family": table.name,
        "states": len(table.fail),
        "actions": table.next_state.shape[1],
        "dead": labelling.count(Label.DEAD),
        "fail": labelling.count(Label.FAIL),
        "H": labelling.horizon,
        "H_b": labelling.boundary_horizon,
        "greatest_T": int(labelling.survival_time[labelling.survival_time < INFINITE].max()),
    }
    total = row["ours_build"] + row["ours_solve"]
    facts["storm_ratio"] = (row["storm_build"] + row["storm_T"]) / total
    if "quantecon_V" in row:
        facts["quantecon_ratio"] = (row["quantecon_build"] + row["quantecon_V"]) / total
    return facts | row


def tables(largest: int) -> list[tuple[Table, bool]]:
    """The models, and whether QuantEcon gets them too."""
    sizes = [size for size in (10**4, 10**5, 10**6, 10**7) if size <= largest]
    grown = [(family(size), True) for size in sizes for family in (models.brake, models.grid)]
    mixed = [
        (models.renumbered(family(size)), False)
        for size in sizes
        for family in (models.brake, models.grid)
    ]
    corridors = [
        (models.corridor(200_000, horizon), True) for horizon in (10, 10**2, 10**3, 10**4, 10**5)
    ]
    return grown + mixed + corridors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.labels")
    parser.add_argument("--largest", type=float, default=1e7, help="most states (default 1e7)")
    largest = int(parser.parse_args().largest)
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    started = perf_counter()
    warm_up()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for table, with_quantecon in tables(largest):
            row = measure(table, with_quantecon=with_quantecon, folder=Path(folder))
            rows.append(row)
            print(line(row), flush=True)
    print(save("labels", {"largest": largest}, rows, perf_counter() - started))


def warm_up() -> None:
    """Compile, so that no row pays for it."""
    classify(SafeMDP.deterministic(*SMALL))
    peers.quantecon_cost(peers.quantecon_model(*SMALL, 0.9))


def line(row: dict[str, Any]) -> str:
    """A row for the terminal."""
    storm_total = row["storm_build"] + row["storm_T"]
    text = (
        f"{row['family']:>24} {row['states']:>10,} states, H {row['H']:>6}: "
        f"ours {row['ours_build'] + row['ours_solve']:.4f} s, "
        f"{row['ours_bytes_per_state']:.1f} bytes a state; "
        f"Storm {storm_total:.3f} s, {row['storm_ratio']:.0f} times"
    )
    if "quantecon_V" in row:
        total = row["quantecon_build"] + row["quantecon_V"]
        text += f"; QuantEcon {total:.3f} s, {row['quantecon_ratio']:.0f} times"
    return text


if __name__ == "__main__":
    main()
