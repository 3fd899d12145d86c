"""Slips of the text that change what is computed: signs, two meanings of H, > against >=."""

from __future__ import annotations

import numpy as np

from dead_ends.paper import unsafe_allowed, unsafe_minimisers
from proofs_check.machinery.cases import Case
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    large_test,
    teeth_test,
)
from proofs_check.machinery.implementation import (
    EPSILON_TOO_SMALL,
    MAX_RECOVERY,
    TINY_EPSILON,
    Implementation,
)
from proofs_check.machinery.statement import Finding, Row, finding
from proofs_check.machinery.thresholds import allowed, best, horizon_thresholds, thresholds


def check_minimised_objective(implementation: Implementation, case: Case) -> Finding:
    """The recovery policy that minimises J_rec = -E Q*."""
    _, Q = best(implementation, case)
    minimisers = implementation.greedy(np.where(case.model.available, -Q, np.inf))
    wrong = unsafe_minimisers(case.model, case.safe, minimisers)
    return finding(case, wrong, case.boundary >= 0)


def check_task_horizon(implementation: Implementation, case: Case) -> Finding:
    """eps = gamma^H with H = 1, a task horizon that has nothing to do with Assumption 1."""
    _, Q = best(implementation, case)
    one = np.ones(case.count, dtype=np.int64)
    mask = allowed(implementation, case, Q, thresholds(implementation, case, one))
    return finding(case, unsafe_allowed(case.model, case.safe, mask), case.boundary >= 0)


def check_blocking_above(implementation: Implementation, case: Case) -> Finding:
    """The authors' code blocks at Q > eps; with the paper's eps = gamma^H."""
    _, Q = best(implementation, case)
    epsilon = horizon_thresholds(implementation, case)
    edge = case.spread(np.array(epsilon))[:, None]
    mask = allowed(implementation, case, Q, epsilon) | np.asarray(Q == edge, dtype=np.bool_)
    return finding(case, unsafe_allowed(case.model, case.safe, mask), case.boundary >= 0)


ROWS = (
    Row(
        name="erratum-minimise",
        place="DEA-RRL: 'by minimizing ... J_rec'; Algorithm 1 maximises it",
        claim="A recovery policy that minimises J_rec = -E[Q_c] keeps the agent in S_safe.",
        check=check_minimised_objective,
        holds=False,
        mutants={"maximised": MAX_RECOVERY},
        rests_on="deterministic, base convention; J_rec with its minus sign",
        because="J_rec carries a minus sign: minimising it seeks the greatest cost. The recovery "
        "policy steps into fail where it could stay.",
    ),
    Row(
        name="erratum-horizon",
        place="Algorithm 2: 'task horizon H'; Theorem 2: H of Assumption 1",
        claim="eps = gamma^H works with H the task's horizon (here H = 1, one step an episode).",
        check=check_task_horizon,
        holds=False,
        mutants={"a far smaller epsilon": TINY_EPSILON},
        rests_on="deterministic, base convention",
        because="The dead-end lasts longer than the H of the threshold: gamma^T < gamma^H, so "
        "entering it is allowed.",
    ),
    Row(
        name="erratum-strict",
        place="Eq. behavior_correction blocks at Q >= eps; the authors' code at Q > eps",
        claim="With eps = gamma^H, blocking only Q > eps keeps the agent in S_safe.",
        check=check_blocking_above,
        holds=False,
        mutants={"epsilon one power smaller": EPSILON_TOO_SMALL},
        rests_on="deterministic, base convention",
        because="The action into the state that survives longest has Q = gamma^H = eps exactly, "
        "and is let through.",
    ),
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_wrong_variants = teeth_test(ROWS)
test_counterexamples = counterexample_test(ROWS)
