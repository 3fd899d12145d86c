"""The Preliminary: its own set of safe policies, and the remark about gamma_safe = 1."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.values.conventions import CriticConvention
from proofs_check.machinery import oracles
from proofs_check.machinery.cases import Case, drawn_deterministic, drawn_stochastic
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.implementation import (
    EPSILON_TOO_LARGE,
    LITERAL_CRITIC,
    LOSS_TARGET,
    NOT_STRICT,
    Implementation,
)
from proofs_check.machinery.statement import Finding, Row, finding
from proofs_check.machinery.thresholds import of_task


def check_own_set(implementation: Implementation, case: Case) -> Finding:
    """No policy has V^pi < 1 on all of S if there is a dead state: one step before fail V = 1."""
    V, _ = of_task(implementation, case)
    below = implementation.allowed(V[:, None], implementation.threshold(case.gamma, 0))[:, 0]
    return finding(case, ~case.any_of(~below) & case.any_of(case.dead), case.dead)


def failing_under_task(case: Case) -> NDArray[Any]:
    """(S,) P(ever fail) under the task policy, by following it or by the oracle."""
    if case.task.ndim == 1 and case.model.is_deterministic:
        successor = case.model.successors()[np.arange(case.model.num_states), case.task]
        failing = case.fail.copy()
        for _ in range(case.states):
            failing |= failing[successor] & ~case.fail
        return failing.astype(np.int64)
    return np.array(oracles.failure_probability(case.model, case.task), dtype=object)


def check_failure_probability(
    implementation: Implementation, case: Case, critic: CriticConvention
) -> Finding:
    """Q^pi(s, a) at gamma = 1 is the probability of failing after taking a in s."""
    one = replace(case, gamma=Fraction(1) if isinstance(case.gamma, Fraction) else 1.0)
    _, Q = of_task(implementation, one, critic=critic)
    failing = failing_under_task(case)
    if case.model.is_deterministic:
        truth = failing[case.model.successors()]
    else:
        truth = np.array(oracles.expectation(case.model, list(failing)), dtype=object)
    wrong = case.model.available & np.asarray(truth != Q, dtype=np.bool_)
    return finding(case, wrong, np.asarray(failing > 0, dtype=np.bool_) & ~case.fail)


def check_literal(implementation: Implementation, case: Case) -> Finding:
    """With Q = E V(s') and V(fail) = 0, as Equations (2) and (3) say."""
    return check_failure_probability(implementation, case, CriticConvention.NEXT_VALUE)


def check_target(implementation: Implementation, case: Case) -> Finding:
    """With the target of the loss."""
    return check_failure_probability(implementation, case, CriticConvention.LOSS_TARGET)


DETERMINISTIC = (
    Row(
        name="preliminary-set-empty",
        place="Preliminary, Pi_c = {V_c^pi < eps on S}",
        claim="The Preliminary's own policy set is empty as soon as there is a dead state, for "
        "every eps <= 1.",
        check=check_own_set,
        mutants={"not strict": NOT_STRICT, "epsilon one power too large": EPSILON_TOO_LARGE},
        rests_on="V = discounted cost on entering fail",
    ),
    Row(
        name="gamma-one-literal",
        place="Remark after Definition 1",
        claim="At gamma_safe = 1, Q_c^pi is the probability of failing, by the paper's equations.",
        check=check_literal,
        holds=False,
        mutants={"target of the loss": LOSS_TARGET},
        rests_on="Eqs. state_cost_function and action_cost_function as they stand",
        because="The action that enters fail has Q = V(fail) = 0, although it fails with "
        "certainty: the cost of the transition itself is not part of Q = E V(s').",
    ),
)
BOTH = (
    Row(
        name="gamma-one-target",
        place="Remark after Definition 1",
        claim="At gamma_safe = 1 the critic with the target of the loss is the probability of "
        "failing (least fixed point).",
        check=check_target,
        mutants={"Q = E V(s')": LITERAL_CRITIC},
    ),
)

test_all_small_models = exhaustive_test(DETERMINISTIC + BOTH)
test_six_states = large_test(DETERMINISTIC + BOTH)
test_drawn_models = sampled_test(DETERMINISTIC + BOTH, drawn_deterministic())
test_drawn_stochastic_models = sampled_test(BOTH, drawn_stochastic())
test_wrong_variants = teeth_test(DETERMINISTIC + BOTH)
test_counterexamples = counterexample_test(DETERMINISTIC)
