"""Thresholds, gates and critics of an implementation, for all models of a case at once."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proofs_check.machinery.cases import Case, Mask
from proofs_check.machinery.implementation import Discount, Implementation, Table, Tables

TINY = Fraction(1, 10**9)


def measured(implementation: Implementation, case: Case) -> Case:
    """The case with the survival times, hence H and H_b, that the implementation finds."""
    time = implementation.labels(case.model).survival_time.astype(np.int64)
    return replace(case, survival=time)


def thresholds(
    implementation: Implementation, case: Case, exponents: NDArray[np.int64]
) -> list[Discount]:
    """gamma^exponent for each model; where the exponent is -1 (no H_b) any, so 1."""
    return [
        implementation.threshold(case.gamma, int(exponent)) if exponent >= 0 else case.gamma**0
        for exponent in exponents
    ]


def boundary_thresholds(implementation: Implementation, case: Case) -> list[Discount]:
    """gamma^H_b for each model, H_b as the implementation finds it."""
    return thresholds(implementation, case, measured(implementation, case).boundary)


def horizon_thresholds(implementation: Implementation, case: Case) -> list[Discount]:
    """The paper's gamma^H for each model, H as the implementation finds it."""
    return thresholds(implementation, case, measured(implementation, case).horizon)


def just_above(epsilon: Discount) -> Discount:
    """The next float, or a billionth more."""
    if isinstance(epsilon, Fraction):
        return epsilon * (1 + TINY)
    return float(np.nextafter(epsilon, np.inf))


def allowed(implementation: Implementation, case: Case, Q: Table, epsilon: list[Discount]) -> Mask:
    """bool (S, A): {Q < epsilon}, with a threshold of its own in each model."""
    values = np.array(epsilon, dtype=object)
    mask = np.zeros(Q.shape, dtype=np.bool_)
    for each in set(epsilon):
        chosen = case.spread(np.asarray(values == each, dtype=np.bool_))
        mask[chosen] = implementation.allowed(Q, each)[chosen]
    return mask


def best(implementation: Implementation, case: Case, **convention: Any) -> Tables:
    """V*, Q*."""
    return implementation.best(case.model, case.gamma, **convention)


def of_task(implementation: Implementation, case: Case, **convention: Any) -> Tables:
    """V^pi, Q^pi of the task policy."""
    return implementation.of_policy(case.model, case.task, case.gamma, **convention)


@lru_cache(maxsize=256)
def entries(case: Case) -> tuple[Table, Table, Table]:
    """The transitions as (row s * A + a, successor, probability)."""
    kernel = case.model.transitions()
    rows = np.repeat(np.arange(kernel.shape[0]), np.diff(kernel.indptr))
    return rows, kernel.indices, np.array(case.model.exact_probabilities(), dtype=object)


def transitions(case: Case, values: Table) -> Table:
    """(S, A) E values(s'), exactly; 0 where the action is not available."""
    rows, successors, probabilities = entries(case)
    flat = np.full(case.model.available.size, Fraction(0), dtype=object)
    np.add.at(flat, rows, probabilities * values[successors])
    return flat.reshape(case.model.available.shape)
