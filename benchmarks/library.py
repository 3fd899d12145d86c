"""Published models beside Storm: ``python -m benchmarks.library``.

Models in the PRISM language as they are published: those that stormpy brings as examples (several
are of the Quantitative Verification Benchmark Set), or a file of yours, from that set or not:

    python -m benchmarks.library --file consensus.2.prism --fail-label finished --constants K=2

Every state's label is compared with Storm's states of P_min(F fail) = 0 and = 1, and our bounds
of P_min with Storm's values, of relative precision 1e-6. The examples write
``results/library.json``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import stormpy
import stormpy.environments
import stormpy.examples.files

from benchmarks import peers
from benchmarks.labels import agree
from benchmarks.measure import best_time, save
from dead_ends import Label, SafeMDP, classify, load_model, value_iteration

PRECISION = 1e-6
"""Of Storm's values, relative."""


@dataclass(frozen=True)
class Example:
    """A model in the PRISM language, and which of its labels is the failure."""

    path: str
    fail_label: str
    constants: str = ""

    @property
    def name(self) -> str:
        """The file's name, the failure and the constants."""
        return ", ".join(filter(None, (Path(self.path).stem, self.fail_label, self.constants)))


def examples() -> Iterator[Example]:
    """Models of stormpy; those of the benchmark set are consensus (coin), firewire and brp."""
    files = stormpy.examples.files
    for label in ("agree", "finished", "all_coins_equal_1"):
        yield Example(files.prism_mdp_coin_2_2, label)
    for delay in (3, 36):
        yield Example(files.prism_mdp_firewire, "elected", f"delay={delay},fast=0.5")
    yield Example(files.prism_dtmc_brp, "target")
    yield Example(files.prism_dtmc_die, "one")
    yield Example(files.prism_mdp_maze, "goal")
    yield Example(files.prism_mdp_slipgrid, "target")


def storm_model(example: Example) -> Any:
    """The same model, built by Storm with the same numbers of states."""
    program = stormpy.parse_prism_program(example.path)
    program, _ = stormpy.io.instantiate_constants(program, example.constants)
    options = stormpy.BuilderOptions()
    options.set_build_all_labels(True)  # a model built for one question may be smaller
    return stormpy.build_model(program, options=options)


def compare(model: SafeMDP, storm: Any, label: str) -> float:
    """Every label is the same, and every value lies in our bounds; the widest of these."""
    (question,) = stormpy.parse_properties(f'Pmin=? [F "{label}"]')
    labelling = classify(model)
    zero, one = stormpy.analysis.compute_prob01_states(storm, question)
    lost = labelling.dead | labelling.fail
    agree(np.array_equal(peers.mask(zero, model.num_states), labelling.safe), "P_min = 0")
    agree(np.array_equal(peers.mask(one, model.num_states), lost), "P_min = 1")
    values = value_iteration(model, 1.0)
    theirs = peers.times(
        stormpy.model_checking(storm, question, environment=stormpy.environments.sound())
    )
    lower, upper = (np.where(model.fail, 1.0, V) for V in (values.V_lower, values.V_upper))
    above = theirs >= lower * (1 - PRECISION) - PRECISION
    agree(bool((above & (theirs <= upper * (1 + PRECISION) + PRECISION)).all()), "P_min")
    return float((upper - lower).max())


def measure(example: Example) -> dict[str, Any]:
    """One row: sizes, labels, the width of our bounds, and seconds to label."""
    model = load_model(
        example.path, fail_label=example.fail_label, constants=example.constants or None
    )
    width = compare(model, storm_model(example), example.fail_label)
    seconds, labelling = best_time(lambda: classify(model))
    return {
        "model": example.name,
        "states": model.num_states,
        "transitions": int(model.transitions().nnz),
        "counts": {label.name: labelling.count(label) for label in Label},
        "widest_bound": width,
        "ours_solve": seconds,
    }


def line(row: dict[str, Any]) -> str:
    """A row of the table in the README."""
    counts = row["counts"]
    labels = " / ".join(f"{counts[name]:,}" for name in ("FAIL", "DEAD", "AT_RISK", "SAFE"))
    sizes = f"{row['states']:,} | {row['transitions']:,}"
    return f"| {row['model']} | {sizes} | {labels} | {row['widest_bound']:.1g} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.library")
    parser.add_argument("--file", help="a PRISM-language model instead of the examples")
    parser.add_argument("--fail-label", default="fail", help="its label of the fail states")
    parser.add_argument("--constants", default="", help="its constants, such as N=4,K=2")
    arguments = parser.parse_args()
    if arguments.file is not None:
        print(line(measure(Example(arguments.file, arguments.fail_label, arguments.constants))))
        return
    started = perf_counter()
    rows = [measure(example) for example in examples()]
    print("\n".join(map(line, rows)))
    print(save("library", {"precision": PRECISION}, rows, perf_counter() - started))


if __name__ == "__main__":
    main()
