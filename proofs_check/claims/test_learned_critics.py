"""How wrong a learned critic may be: the margins of the gate and of the recovery policy."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from dead_ends.paper import boundary_exact, leaves, unsafe_minimisers
from proofs_check.machinery.cases import FOREVER, Case, drawn_deterministic
from proofs_check.machinery.checks import exhaustive_test, large_test, sampled_test, teeth_test
from proofs_check.machinery.implementation import (
    BEST_IS_OF_FIRST_ACTIONS,
    EPSILON_TOO_LARGE,
    EPSILON_TOO_SMALL,
    MAX_RECOVERY,
    NOT_STRICT,
    STOPPED_EARLY_FROM_ABOVE,
    WORST_CRITIC,
    Implementation,
    Table,
)
from proofs_check.machinery.statement import Finding, Row, finding
from proofs_check.machinery.thresholds import allowed, best, boundary_thresholds, just_above

EIGHTHS = (0, 1, 3, 4, 5)
"""delta as eighths of gamma^H_b; the margin of the recovery policy is 4."""


def misjudged(case: Case, Q: Table, delta: Table) -> Table:
    """The worst critic within delta of Q: safe actions look bad, unsafe ones good."""
    sign = np.where(leaves(case.model, case.safe), -1, 1)
    return np.asarray(Q + sign * case.spread(delta)[:, None])


def errors(implementation: Implementation, case: Case, eighths: int) -> tuple[Table, Table]:
    """gamma^H_b and delta for each model."""
    edge = np.array(boundary_thresholds(implementation, case))
    return edge, edge * eighths / 8


def check_gate(implementation: Implementation, case: Case) -> Finding:
    """Exact for every critic within delta if delta < eps <= gamma^H_b - delta."""
    _, Q = best(implementation, case)
    wrong = np.zeros(Q.shape, dtype=np.bool_)
    for eighths in EIGHTHS:
        edge, delta = errors(implementation, case, eighths)
        for epsilon in (edge - delta, [just_above(d) for d in delta], edge / 2):
            works = np.asarray((delta < epsilon) & (epsilon <= edge - delta), dtype=np.bool_)
            mask = allowed(implementation, case, misjudged(case, Q, delta), list(epsilon))
            inexact = boundary_exact(case.model, case.safe, mask)
            wrong |= inexact & case.spread(works)[:, None]
    return finding(case, wrong, case.boundary >= 0)


def check_gate_needed(implementation: Implementation, case: Case) -> Finding:
    """Some critic within delta is misled if eps <= delta or eps > gamma^H_b - delta."""
    _, Q = best(implementation, case)
    met = case.boundary >= 0
    wrong = np.zeros(case.count, dtype=np.bool_)
    for eighths in EIGHTHS[1:]:
        edge, delta = errors(implementation, case, eighths)
        for epsilon in (delta, [just_above(e) for e in edge - delta]):
            mask = allowed(implementation, case, misjudged(case, Q, delta), list(epsilon))
            wrong |= met & ~case.any_of(boundary_exact(case.model, case.safe, mask))
    return finding(case, wrong, met)


def check_recovery(implementation: Implementation, case: Case) -> Finding:
    """Greedy recovery is safe for every critic within delta exactly if 2 delta < gamma^H_b."""
    _, Q = best(implementation, case)
    met = case.boundary >= 0
    wrong = np.zeros(case.count, dtype=np.bool_)
    for eighths in EIGHTHS:
        _, delta = errors(implementation, case, eighths)
        greedy = implementation.greedy(misjudged(case, Q, delta))
        unsafe = case.any_of(unsafe_minimisers(case.model, case.safe, greedy))
        wrong |= unsafe != (2 * eighths >= 8)
    return finding(case, wrong & met, met)


def check_residual(implementation: Implementation, case: Case) -> Finding:
    """|Qhat - Q*| <= r / (1 - gamma), r the greatest Bellman residual of Qhat."""
    _, Q = best(implementation, case)
    successors, available = case.model.successors(), case.model.available
    one: Any = Fraction(1) if isinstance(case.gamma, Fraction) else 1.0
    entered = case.survival[successors]
    powers = {t: case.gamma ** int(t) if t < FOREVER else 0 * one for t in np.unique(entered)}
    exact = np.array([powers[t] for t in entered.ravel()]).reshape(entered.shape)
    states, actions = np.indices(entered.shape)
    noise = (5 * states % 7 + 3 * actions) % 5 - 2
    learned = np.where(available, exact + noise * one / 64, np.inf)
    target = np.where(case.fail[successors], one, case.gamma * learned.min(axis=1)[successors])
    residual, difference = (
        abs(np.where(available, learned, 0 * one) - np.where(available, other, 0 * one))
        for other in (target, Q)
    )
    worst = case.of_models(residual).reshape(case.count, -1).max(axis=1)
    bound = case.spread(worst / (1 - case.gamma))[:, None]
    return finding(case, np.asarray(difference > bound, dtype=np.bool_), case.boundary >= 0)


PLACE = "Online Training: epistemic uncertainty; implied by Theorem 2"
ROWS = (
    Row(
        name="learned-gate",
        place=PLACE,
        claim="If |Qhat - Q*| <= delta, the gate on Qhat is exact for delta < eps <= gamma^H_b - "
        "delta (eps = gamma^H_b / 2 if 2 delta < gamma^H_b).",
        check=check_gate,
        mutants={
            "epsilon one power too large": EPSILON_TOO_LARGE,
            "not strict": NOT_STRICT,
            "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS,
        },
        rests_on="deterministic, base convention; the worst critic within delta",
        kernel=("Learned",),
    ),
    Row(
        name="learned-gate-needed",
        place=PLACE,
        claim="Outside delta < eps <= gamma^H_b - delta the gate of some critic within delta is "
        "not exact.",
        check=check_gate_needed,
        mutants={"epsilon one power too small": EPSILON_TOO_SMALL},
        rests_on="deterministic, base convention; some safe state has an unsafe successor",
        kernel=("Learned",),
    ),
    Row(
        name="learned-recovery",
        place=PLACE,
        claim="Greedy recovery is safe for every critic within delta of Q* exactly if "
        "2 delta < gamma^H_b, whatever eps.",
        check=check_recovery,
        mutants={
            "epsilon one power too large": EPSILON_TOO_LARGE,
            "epsilon one power too small": EPSILON_TOO_SMALL,
            "max for min": MAX_RECOVERY,
        },
        rests_on="deterministic, base convention; 'only if' where a safe state has an unsafe "
        "successor",
        kernel=("Learned",),
    ),
    Row(
        name="learned-residual",
        place=PLACE,
        claim="A Bellman residual of at most r gives |Qhat - Q*| <= r / (1 - gamma).",
        check=check_residual,
        mutants={
            "max in the critic": WORST_CRITIC,
            "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
        },
        rests_on="deterministic, base convention; one pattern of errors",
    ),
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_drawn_models = sampled_test(ROWS, drawn_deterministic())
test_wrong_variants = teeth_test(ROWS)


def test_the_allowed_residual_is_largest_at_one_gamma() -> None:
    """gamma^H_b (1 - gamma) / 2 over gamma in (0, 1) peaks at gamma = H_b / (H_b + 1)."""

    def allowed_residual(h: int, gamma: Fraction) -> Fraction:
        return gamma**h * (1 - gamma) / 2

    grid = [Fraction(k, 1_000) for k in range(1, 1_000)]
    for h in range(1, 30):
        peak = partial(allowed_residual, h)
        best_gamma = Fraction(h, h + 1)
        assert all(peak(gamma) < peak(best_gamma) for gamma in grid if gamma != best_gamma)
