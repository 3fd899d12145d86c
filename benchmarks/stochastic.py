"""Labels of stochastic models beside Storm: ``python -m benchmarks.stochastic``.

From the sparse kernel in memory to P_min(F fail) = 0, = 1, or between, for every state: the
graph analysis of both tools on the same models in one run, compared on every state. Writes
``results/stochastic.json``.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy import sparse

from benchmarks import models, peers
from benchmarks.labels import agree
from benchmarks.measure import best_time, extra_memory, save
from benchmarks.models import Kernel
from dead_ends import Label, SafeMDP, classify


def kernels(largest: int) -> Iterator[Kernel]:
    """Slippery brakes and grids, in order and renumbered at random, and models without order."""
    for size in (size for size in (10**3, 10**4, 10**5, 10**6) if size <= largest):
        for family in (models.brake, models.grid):
            table = family(size)
            yield models.slippery(table)
            yield models.slippery(models.renumbered(table))
        yield models.scattered(size)


def small_kernels(count: int) -> Iterator[Kernel]:
    """Random models of 2 to 12 states, where every kind of graph turns up."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        num_states = int(rng.integers(2, 13))
        tables = rng.integers(0, num_states, (num_states, 2, 2), dtype=np.int32)
        tables[rng.random(num_states) < 0.5, 1] = tables[0, 0]
        yield models.mixture("small", tables, rng.random(num_states) < 0.3)


def storm_input(model: SafeMDP) -> sparse.csr_array:
    """The kernel with self-loops in the fail states, as Storm wants every state to move."""
    kernel = model.transitions()
    loops = np.flatnonzero(model.fail)
    rows = loops * model.num_actions
    shape = kernel.shape
    return sparse.csr_array(
        kernel + sparse.csr_array((np.ones(len(loops)), (rows, loops)), shape=shape)
    )


def compare(model: SafeMDP, storm: Any) -> None:
    """Every label is the same."""
    labelling = classify(model)
    zero, one = peers.storm_labels(storm)
    lost = labelling.dead | labelling.fail
    agree(np.array_equal(peers.mask(zero, model.num_states), labelling.safe), "P_min = 0")
    agree(np.array_equal(peers.mask(one, model.num_states), lost), "P_min = 1")


def in_storm(model: SafeMDP, file: Path) -> Any:
    """The model in Storm, by way of a file."""
    peers.write_umb(file, storm_input(model), model.num_actions, model.fail)
    return peers.storm_model(file)


def measure(kernel: Kernel, file: Path) -> dict[str, Any]:
    """One row: a model, our times and Storm's, in seconds."""
    build, model = best_time(lambda: SafeMDP.stochastic(kernel.P, kernel.fail))
    solve, labelling = best_time(lambda: classify(model))
    memory = extra_memory(lambda: classify(model))
    compare(model, in_storm(model, file))
    storm_build, storm = best_time(lambda: peers.storm_model(file))
    storm_labels, _ = best_time(lambda: peers.storm_labels(storm))
    return {
        "family": kernel.name,
        "states": model.num_states,
        "transitions": int(model.transitions().nnz),
        "counts": {label.name: labelling.count(label) for label in Label},
        "ours_build": build,
        "ours_solve": solve,
        "ours_bytes_per_state": memory / model.num_states,
        "storm_build": storm_build,
        "storm_labels": storm_labels,
        "labels_ratio": storm_labels / solve,
        "total_ratio": (storm_build + storm_labels) / (build + solve),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.stochastic")
    parser.add_argument("--largest", type=float, default=1e6, help="most states (default 1e6)")
    parser.add_argument("--small", type=int, default=300, help="random small models compared")
    arguments = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    started = perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.umb"
        for kernel in small_kernels(arguments.small):
            model = SafeMDP.stochastic(kernel.P, kernel.fail)
            compare(model, in_storm(model, file))
        print(f"{arguments.small} small models: every label agrees", flush=True)
        rows = []
        for kernel in kernels(int(arguments.largest)):
            row = measure(kernel, file)
            rows.append(row)
            print(line(row), flush=True)
    config = {"largest": int(arguments.largest), "small_models": arguments.small}
    print(save("stochastic", config, rows, perf_counter() - started))


def line(row: dict[str, Any]) -> str:
    """A row for the terminal."""
    return (
        f"{row['family']:>33} {row['states']:>9,} states, {row['transitions']:>9,} transitions: "
        f"ours {row['ours_build']:.4f} + {row['ours_solve']:.4f} s, "
        f"Storm {row['storm_build']:.4f} + {row['storm_labels']:.4f} s; "
        f"labels {row['labels_ratio']:.1f} times, in all {row['total_ratio']:.1f} times"
    )


if __name__ == "__main__":
    main()
