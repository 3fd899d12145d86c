"""The convention table: the thresholds that are exact, for three critics and three values."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.paper import boundary_exact, unsafe_allowed
from dead_ends.values.conventions import CriticConvention as Critic
from dead_ends.values.conventions import ValueConvention as Value
from proofs_check.machinery.cases import Case, Mask, drawn_deterministic, small_cases
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    judge,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.implementation import (
    EPSILON_TOO_LARGE,
    EPSILON_TOO_SMALL,
    INTERVAL_TOO_LARGE,
    INTERVAL_TOO_SMALL,
    LIBRARY,
    LOSS_TARGET,
    NOT_STRICT,
    STOPPED_EARLY,
    Discount,
    Implementation,
)
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import allowed, best, horizon_thresholds, just_above

NONE = 99
"""An exponent that no threshold reaches: the interval is empty."""

Exponent = NDArray[np.int64]


def exponent(value: Value, critic: Critic, boundary: Exponent, fail_entered: Mask) -> Exponent:
    """k with (0, gamma^k] the exact thresholds; ``boundary`` is H_b >= 0.

    The table, cell by cell; ``fail_entered``: fail can be entered from a safe state.
    """
    table: dict[tuple[Value, Critic], Any] = {
        (Value.COST_FAIL_1, Critic.NEXT_VALUE): np.maximum(0, boundary - 1),
        (Value.COST_FAIL_1, Critic.LOSS_TARGET): boundary,
        (Value.COST_FAIL_1, Critic.DISCOUNTED_NEXT_VALUE): np.maximum(1, boundary),
        (Value.COST_FAIL_0, Critic.NEXT_VALUE): np.where(fail_entered, NONE, boundary - 1),
        (Value.COST_FAIL_0, Critic.LOSS_TARGET): boundary,
        (Value.COST_FAIL_0, Critic.DISCOUNTED_NEXT_VALUE): np.where(fail_entered, NONE, boundary),
        (Value.TIME, Critic.NEXT_VALUE): boundary,
        (Value.TIME, Critic.LOSS_TARGET): np.where(boundary == 0, 0, boundary + 1),
        (Value.TIME, Critic.DISCOUNTED_NEXT_VALUE): boundary + 1,
    }
    return np.asarray(table[value, critic])


FORMULA = {
    (Value.COST_FAIL_1, Critic.NEXT_VALUE): "(0, gamma^max(0, H_b - 1)]",
    (Value.COST_FAIL_1, Critic.LOSS_TARGET): "(0, gamma^H_b]",
    (Value.COST_FAIL_1, Critic.DISCOUNTED_NEXT_VALUE): "(0, gamma^max(1, H_b)]",
    (Value.COST_FAIL_0, Critic.NEXT_VALUE): "empty if fail is enterable from a safe state, else "
    "(0, gamma^(H_b - 1)]",
    (Value.COST_FAIL_0, Critic.LOSS_TARGET): "(0, gamma^H_b]",
    (Value.COST_FAIL_0, Critic.DISCOUNTED_NEXT_VALUE): "empty if fail is enterable from a safe "
    "state, else (0, gamma^H_b]",
    (Value.TIME, Critic.NEXT_VALUE): "(0, gamma^H_b]",
    (Value.TIME, Critic.LOSS_TARGET): "(0, gamma^(H_b + 1)], or (0, 1] if H_b = 0",
    (Value.TIME, Critic.DISCOUNTED_NEXT_VALUE): "(0, gamma^(H_b + 1)]",
}


def thresholds(case: Case) -> list[tuple[Discount, int, bool]]:
    """(epsilon, k, above): gamma^k, and just above it, for all k that matter."""
    powers = [(case.gamma**k, k) for k in range(min(case.states, 12) + 2)]
    return [(p, k, False) for p, k in powers] + [(just_above(p), k, True) for p, k in powers]


def exact_at(
    implementation: Implementation, case: Case, epsilon: Discount, Q: NDArray[Any]
) -> Mask:
    """bool (count,): the gate Q* < epsilon is exact in this model."""
    mask = implementation.allowed(Q, epsilon)
    return ~case.any_of(boundary_exact(case.model, case.safe, mask))


def check_table(
    implementation: Implementation, case: Case, value: Value, critic: Critic
) -> Finding:
    """The gate is exact at gamma^j, and just above it, exactly if the table says so."""
    _, Q = best(implementation, case, value=value, critic=critic)
    met = case.boundary >= 0
    entered = case.model.available & case.fail[case.model.successors()]
    fail_entered = case.any_of(case.safe[:, None] & entered)
    limit = exponent(value, critic, np.maximum(case.boundary, 0), fail_entered)
    wrong = np.zeros(case.count, dtype=np.bool_)
    for epsilon, k, above in thresholds(case):
        inside = (limit < k) if above else (limit <= k)
        wrong |= met & (exact_at(implementation, case, epsilon, Q) != inside)
        wrong |= ~met & ~exact_at(implementation, case, epsilon, Q)
    return finding(case, wrong, met)


def check_interval(
    implementation: Implementation, case: Case, value: Value, critic: Critic
) -> Finding:
    """The library's interval contains exactly the thresholds that are exact, model by model."""
    _, Q = best(implementation, case, value=value, critic=critic)
    intervals = [
        implementation.interval(case.take(i).model, case.gamma, value=value, critic=critic)
        for i in range(case.count)
    ]
    wrong = np.zeros(case.count, dtype=np.bool_)
    for epsilon, _, _ in thresholds(case):
        inside = np.array([interval.contains(epsilon) for interval in intervals])
        wrong |= exact_at(implementation, case, epsilon, Q) != inside
    return finding(case, wrong, case.boundary >= 0)


def check_convention(
    implementation: Implementation,
    case: Case,
    value: Value,
    critic: Critic,
) -> Mask:
    """(S, A) Unsafe actions that pass eps = gamma^H in another convention."""
    _, Q = best(implementation, case, value=value, critic=critic)
    mask = allowed(implementation, case, Q, horizon_thresholds(implementation, case))
    return unsafe_allowed(case.model, case.safe, mask)


def check_proof_convention(implementation: Implementation, case: Case) -> Finding:
    """Q = gamma V(s') with V(fail) = 1, as in the proof of Theorem 2."""
    wrong = check_convention(
        implementation,
        case,
        Value.COST_FAIL_1,
        Critic.DISCOUNTED_NEXT_VALUE,
    )
    return finding(case, wrong, case.boundary >= 0)


def check_proof_convention_with_dead(implementation: Implementation, case: Case) -> Finding:
    """The same where S_dead is not empty, so that H >= 1."""
    met = case.any_of(case.dead)
    wrong = check_convention(
        implementation,
        case,
        Value.COST_FAIL_1,
        Critic.DISCOUNTED_NEXT_VALUE,
    )
    return finding(case, case.any_of(wrong) & met, met & case.boundary >= 0)


def check_literal(implementation: Implementation, case: Case) -> Finding:
    """Q = V(s') with V(fail) = 0: the equations of the Preliminary as they stand."""
    wrong = check_convention(implementation, case, Value.COST_FAIL_0, Critic.NEXT_VALUE)
    return finding(case, wrong, case.boundary >= 0)


CELLS = tuple((value, critic) for value in Value for critic in Critic)
TABLE = tuple(
    Row(
        name=f"convention-{value}-{critic}",
        place="Eqs. action_cost_function and obj_safe_critic, Lemma 1, proof of Theorem 2",
        claim=f"V: {value}, Q: {critic}: 'allowed' means 'stays safe' exactly for eps in "
        f"{FORMULA[value, critic]}.",
        check=partial(check_table, value=value, critic=critic),
        mutants={"not strict": NOT_STRICT, "stopped early": STOPPED_EARLY},
        rests_on="deterministic",
        kernel=("Exactness", "Tightness")
        if critic is Critic.LOSS_TARGET and value is not Value.TIME
        else (),
    )
    for value, critic in CELLS
)
INTERVALS = tuple(
    Row(
        name=f"interval-{value}-{critic}",
        place="Theorem 2, eps_safe = gamma_safe^H",
        claim=f"V: {value}, Q: {critic}: the toolkit's interval holds exactly the thresholds that "
        "work.",
        check=partial(check_interval, value=value, critic=critic),
        mutants={
            "upper end too large": INTERVAL_TOO_LARGE,
            "upper end too small": INTERVAL_TOO_SMALL,
        },
        rests_on="deterministic",
    )
    for value, critic in CELLS
)

THEOREM_2 = (
    Row(
        name="theorem-2-proof-convention",
        place="Theorem 2, its proof (Q = gamma V(s'), V(fail) = 1)",
        claim="In the convention of its proof, with eps = gamma^H, no allowed action leaves "
        "S_safe.",
        check=check_proof_convention,
        holds=False,
        mutants={
            "target of the loss": LOSS_TARGET,
            "epsilon two powers smaller": EPSILON_TOO_SMALL,
        },
        rests_on="deterministic; V(fail) = 1, Q = gamma V(s')",
        because="There is no dead-end, so H = 0 and eps = 1; the action that enters fail has "
        "Q = gamma V(fail) = gamma < 1 and is allowed.",
    ),
    Row(
        name="theorem-2-proof-convention-repaired",
        place="Theorem 2, its proof (Q = gamma V(s'), V(fail) = 1)",
        claim="In the convention of its proof, with eps = gamma^H, no allowed action leaves "
        "S_safe if there is a dead state.",
        check=check_proof_convention_with_dead,
        mutants={"epsilon one power too large": EPSILON_TOO_LARGE, "not strict": NOT_STRICT},
        rests_on="deterministic; V(fail) = 1, Q = gamma V(s'); S_dead not empty",
    ),
    Row(
        name="theorem-2-literal",
        place="Theorem 2 with Eqs. state_cost_function and action_cost_function",
        claim="By the Preliminary's equations, with eps = gamma^H, no allowed action leaves "
        "S_safe.",
        check=check_literal,
        holds=False,
        mutants={"target of the loss": LOSS_TARGET},
        rests_on="deterministic; V(fail) = 0, Q = V(s')",
        because="Q = V(fail) = 0 for the action that enters fail: the agent is let straight into "
        "the violation.",
    ),
)

test_all_small_models = exhaustive_test(TABLE + THEOREM_2)
test_six_states = large_test(TABLE + THEOREM_2)
test_drawn_models = sampled_test(TABLE + INTERVALS + THEOREM_2, drawn_deterministic())
test_wrong_variants = teeth_test(TABLE + THEOREM_2)
test_counterexamples = counterexample_test(THEOREM_2)
test_wrong_intervals = teeth_test(INTERVALS, lambda: small_cases()[:5])


def test_intervals_of_every_model_with_three_states(record: Recorder) -> None:
    """Every model with n <= 3, m = 2, all nine cells."""
    cases = [case for case in small_cases() if case.states <= 3 and case.model.num_actions == 2]
    for row in INTERVALS:
        total = run(row, LIBRARY, iter(cases))
        record(row, Means.EXHAUSTIVE, total)
        judge(row, total)
