"""A row of the report: a statement of the paper, and how it is checked.

A check receives the implementation that it judges and a case, and says in which models of the
case the statement's premise is met and in which the statement fails. The same function serves
all means: every small model, drawn models, and wrong variants of the implementation, which it
must reject.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from proofs_check.machinery.cases import Case, Mask
from proofs_check.machinery.implementation import Implementation


@dataclass(frozen=True, eq=False)
class Finding:
    """What a check says about the models of a case, both bool (count,).

    Attributes:
        violated: the statement fails in this model.
        met: its premise is met, so that the check was not vacuous.
    """

    violated: Mask
    met: Mask


Check = Callable[[Implementation, Case], Finding]


def finding(case: Case, violated: Mask, met: Mask | None = None) -> Finding:
    """From masks of states (S,), pairs (S, A), or models (count,); ``met`` None: all models."""
    everywhere = np.ones(case.count, dtype=np.bool_)
    return Finding(
        violated=_per_model(case, violated),
        met=everywhere if met is None else _per_model(case, met),
    )


def _per_model(case: Case, mask: Mask) -> Mask:
    return mask if mask.shape == (case.count,) and case.states > 1 else case.any_of(mask)


@dataclass(frozen=True, eq=False)
class Row:
    """One statement.

    Attributes:
        name: short, unique, also the name of its counterexample's files.
        place: where the paper says it.
        claim: the statement that is checked, in one sentence.
        check: the check.
        holds: what the tests insist on. The verdict of the report is not taken from here but
            from what the checks found.
        mutants: wrong variants of the implementation that turn the check's result around.
        rests_on: conventions and reductions under which the claim is meant.
        kernel: the names of its theorems in the kernel-checked part.
        because: for a refuted claim, its smallest counterexample in a sentence.
    """

    name: str
    place: str
    claim: str
    check: Check
    holds: bool = True
    mutants: Mapping[str, Implementation] = field(default_factory=dict)
    rests_on: str = "base convention"
    kernel: tuple[str, ...] = ()
    because: str = ""


@dataclass(frozen=True)
class Tally:
    """Labelled models checked, those that met the premise, those that broke the claim."""

    models: int = 0
    met: int = 0
    violated: int = 0

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.models + other.models, self.met + other.met, self.violated + other.violated
        )


def tally(weight: NDArray[np.int64], result: Finding) -> Tally:
    """The numbers of one case."""
    return Tally(
        models=int(weight.sum()),
        met=int(weight[result.met].sum()),
        violated=int(weight[result.violated].sum()),
    )


def run(row: Row, implementation: Implementation, cases: Iterator[Case]) -> Tally:
    """A row's check over many cases."""
    total = Tally()
    for case in cases:
        total += tally(case.weight, row.check(implementation, case))
    return total
