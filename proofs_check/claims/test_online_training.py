"""Online training: a fixed correction is part of the environment; thresholds in floats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from dead_ends.model.safe_mdp import SafeMDP
from proofs_check.claims.test_theorem2 import check_exact
from proofs_check.machinery.cases import (
    Case,
    deterministic_case,
    drawn_deterministic,
    longest_times,
)
from proofs_check.machinery.checks import (
    exhaustive_test,
    judge,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.implementation import (
    CORRECTED_MODEL_UNCHANGED,
    LIBRARY,
    NOT_CORRECTED,
    NOT_STRICT,
    REPEATED_PRODUCTS,
    Implementation,
)
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import best, of_task


def check_corrected_model(implementation: Implementation, case: Case) -> Finding:
    """V of the task policy in the corrected model = V of the corrected policy in the model."""
    wrong = np.zeros(case.model.num_states, dtype=np.bool_)
    changed = np.zeros(case.model.num_states, dtype=np.bool_)
    for _, Q in (best(implementation, case), of_task(implementation, case)):
        recovery = implementation.greedy(Q).argmax(axis=1)
        for epsilon in (case.gamma**0, case.gamma, case.gamma**2):
            loop = implementation.corrected(case.model, Q, epsilon, recovery)
            executed = implementation.correct(case.task, Q, epsilon, recovery)
            inside, _ = implementation.of_policy(loop, case.task, case.gamma)
            outside, _ = implementation.of_policy(case.model, executed, case.gamma)
            wrong |= np.asarray(inside != outside, dtype=np.bool_)
            blocked = case.support & ~implementation.allowed(Q, epsilon)
            changed |= blocked.any(axis=1)
    return finding(case, wrong, changed)


ROWS = (
    Row(
        name="corrected-model",
        place="Online Training: 'view behavior correction as part of the environment'",
        claim="A fixed correction makes another stationary model: the task policy is worth there "
        "what the corrected policy is worth in the original one.",
        check=check_corrected_model,
        mutants={
            "policy not corrected": NOT_CORRECTED,
            "model not corrected": CORRECTED_MODEL_UNCHANGED,
        },
        rests_on="base convention; critics Q* and Q^pi, eps = 1, gamma, gamma^2",
    ),
)
FLOATS = Row(
    name="exactness-floats",
    place="Theorem 2, eps_safe = gamma_safe^H",
    claim="In floating point too the gate at eps = gamma**H_b is exact, since equal survival "
    "times give equal floats.",
    check=check_exact,
    mutants={"powers by repeated products": REPEATED_PRODUCTS, "not strict": NOT_STRICT},
    rests_on="deterministic, base convention; float64; corridors of up to 30 steps",
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_drawn_models = sampled_test(ROWS, drawn_deterministic())
test_wrong_variants = teeth_test(ROWS)


def corridor(length: int) -> SafeMDP:
    """0: {stay, enter}; then ``length`` states in a row, and fail."""
    n = length + 2
    table = np.minimum(np.arange(n) + 1, n - 1)[:, None].repeat(2, axis=1)
    table[0, 0] = 0
    return SafeMDP.deterministic(table, np.arange(n) == n - 1)


@lru_cache(maxsize=1)
def corridors() -> Sequence[Case]:
    """Corridors of 1 to 30 steps, for gammas of two decimals."""
    cases = []
    for length in range(1, 31):
        model = corridor(length)
        task = np.zeros(model.num_states, dtype=np.int64)
        case = deterministic_case(model, 0.5, task, longest_times(model))
        cases += [replace(case, gamma=percent / 100) for percent in (30, 55, 70, 83, 90, 97, 99)]
    return tuple(cases)


test_wrong_floats = teeth_test((FLOATS,), corridors)


def test_corridors_in_floats(record: Recorder) -> None:
    """210 corridors; which pairs a product rounds differently depends on the processor."""
    total = run(FLOATS, LIBRARY, iter(corridors()))
    record(FLOATS, Means.INSTANCE, total)
    judge(FLOATS, total)
