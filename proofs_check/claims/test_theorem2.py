"""Theorem 2 branch by branch; exactness and tightness of the threshold; its conventions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from dead_ends.paper import (
    boundary_exact,
    corrected_loop,
    executed_actions,
    policy_stays,
    unsafe_allowed,
    unsafe_minimisers,
)
from proofs_check.machinery import oracles
from proofs_check.machinery.cases import Case, Mask, drawn_deterministic, small_cases
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    judge,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.enumerate_models import count
from proofs_check.machinery.implementation import (
    BEST_IS_OF_FIRST_ACTIONS,
    EPSILON_TOO_LARGE,
    EPSILON_TOO_SMALL,
    EVALUATION_IS_BEST,
    HORIZON_TOO_LONG,
    HORIZON_TOO_SHORT,
    LIBRARY,
    MAX_RECOVERY,
    NOT_STRICT,
    NOTHING_ALLOWED,
    RECOVERY_FROM_GATE,
    STOPPED_EARLY,
    STOPPED_EARLY_FROM_ABOVE,
    Discount,
    Implementation,
    Table,
)
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import (
    allowed,
    best,
    boundary_thresholds,
    horizon_thresholds,
    just_above,
    measured,
    of_task,
    thresholds,
)


def leaving_possible(case: Case) -> Mask:
    """bool (count,): some safe state has an unsafe successor, so that there is something to do."""
    return np.asarray(case.boundary >= 0)


def working_thresholds(implementation: Implementation, case: Case) -> list[list[Discount]]:
    """gamma^H_b, and two thresholds further inside (0, gamma^H_b]."""
    exponents = measured(implementation, case).boundary
    further = np.where(exponents >= 0, exponents + 2, exponents)
    inside = [e * 3 / 4 for e in boundary_thresholds(implementation, case)]
    return [
        boundary_thresholds(implementation, case),
        inside,
        thresholds(implementation, case, further),
    ]


def any_proposal(case: Case) -> Mask:
    """Whatever the task policy may propose."""
    return case.model.available


def check_gate(implementation: Implementation, case: Case) -> Finding:
    """{Q^pi < eps} holds no unsafe action, for the critics of the task policy and of the best."""
    wrong = np.zeros(case.model.available.shape, dtype=np.bool_)
    for _, Q in (of_task(implementation, case), best(implementation, case)):
        for epsilon in working_thresholds(implementation, case):
            mask = allowed(implementation, case, Q, epsilon)
            wrong |= unsafe_allowed(case.model, case.safe, mask)
    return finding(case, wrong, leaving_possible(case))


def check_recovery(implementation: Implementation, case: Case) -> Finding:
    """No minimiser of Q* leaves S_safe, whatever the tie-break."""
    _, Q = best(implementation, case)
    greedy = implementation.greedy(Q)
    return finding(case, unsafe_minimisers(case.model, case.safe, greedy), leaving_possible(case))


def closed_loop(implementation: Implementation, case: Case, gate: Table, recovery: Table) -> Mask:
    """bool (S, A): executed actions that leave S_safe, over the working thresholds."""
    wrong = np.zeros(gate.shape, dtype=np.bool_)
    greedy = implementation.greedy(recovery)
    for epsilon in working_thresholds(implementation, case):
        mask = allowed(implementation, case, gate, epsilon)
        wrong |= corrected_loop(case.model, case.safe, any_proposal(case), mask, greedy)
    return wrong


def check_loop(implementation: Implementation, case: Case) -> Finding:
    """DEA-RRL: gate and recovery from Q*; any task policy."""
    _, Q = best(implementation, case)
    _, own = of_task(implementation, case)
    recovery = implementation.recovery_critic(Q, own)
    return finding(case, closed_loop(implementation, case, Q, recovery), leaving_possible(case))


def check_policy_gate(implementation: Implementation, case: Case) -> Finding:
    """A gate on Q^pi of any policy, recovery greedy on Q*."""
    _, Q = best(implementation, case)
    _, own = of_task(implementation, case)
    recovery = implementation.recovery_critic(Q, own)
    return finding(case, closed_loop(implementation, case, own, recovery), leaving_possible(case))


def check_policy_recovery(implementation: Implementation, case: Case) -> Finding:
    """A gate on Q*, recovery greedy on Q^pi."""
    _, Q = best(implementation, case)
    _, own = of_task(implementation, case)
    return finding(case, closed_loop(implementation, case, Q, own), leaving_possible(case))


def check_paths(implementation: Implementation, case: Case) -> Finding:
    """Every path of the corrected agent from a safe start, followed by the oracle."""
    _, Q = best(implementation, case)
    epsilon = boundary_thresholds(implementation, case)
    mask = executed_actions(
        any_proposal(case), allowed(implementation, case, Q, epsilon), implementation.greedy(Q)
    )
    executed = [[int(a) for a in np.flatnonzero(row)] for row in mask]
    region = {int(s) for s in np.flatnonzero(case.safe)}
    inside = oracles.stays_inside(case.model, executed, region)
    return finding(case, np.full(len(case.safe), not inside), leaving_possible(case))


def check_exact(implementation: Implementation, case: Case) -> Finding:
    """Q*(s, a) < eps exactly if next(s, a) is safe, in safe states."""
    _, Q = best(implementation, case)
    wrong = np.zeros(Q.shape, dtype=np.bool_)
    for epsilon in working_thresholds(implementation, case):
        mask = allowed(implementation, case, Q, epsilon)
        wrong |= boundary_exact(case.model, case.safe, mask)
    return finding(case, wrong, leaving_possible(case))


def check_tight(implementation: Implementation, case: Case) -> Finding:
    """Just above gamma^H_b an unsafe action of a safe state passes the gate."""
    _, Q = best(implementation, case)
    above = [just_above(epsilon) for epsilon in boundary_thresholds(implementation, case)]
    leak = unsafe_allowed(case.model, case.safe, allowed(implementation, case, Q, above))
    met = leaving_possible(case)
    return finding(case, met & ~case.any_of(leak), met)


def check_paper_threshold(implementation: Implementation, case: Case) -> Finding:
    """The paper's own eps = gamma^H works as well."""
    _, Q = best(implementation, case)
    mask = allowed(implementation, case, Q, horizon_thresholds(implementation, case))
    return finding(case, boundary_exact(case.model, case.safe, mask), leaving_possible(case))


def check_untouched(implementation: Implementation, case: Case) -> Finding:
    """A task policy that never leaves S_safe by itself is never corrected."""
    _, Q = best(implementation, case)
    mask = allowed(implementation, case, Q, boundary_thresholds(implementation, case))
    stays = ~case.any_of(policy_stays(case.model, case.safe, case.support))
    corrected = case.any_of(case.safe[:, None] & case.support & ~mask)
    return finding(case, stays & corrected, stays & leaving_possible(case))


SOUND = {
    "epsilon one power too large": EPSILON_TOO_LARGE,
    "H off by one": HORIZON_TOO_SHORT,
    "not strict": NOT_STRICT,
    "stopped early": STOPPED_EARLY,
}
REACH = "deterministic, base convention, 0 < eps <= gamma^H_b"
ROWS = (
    Row(
        name="theorem-2-task",
        place="Theorem 2, task branch",
        claim="An action with Q^pi(s, a) < eps leads from S_safe to S_safe, for the critic of "
        "any policy.",
        check=check_gate,
        mutants=SOUND,
        rests_on=REACH,
        kernel=("Theorem2_task",),
    ),
    Row(
        name="theorem-2-recovery",
        place="Theorem 2, recovery branch (not in the paper's proof)",
        claim="Every minimiser of Q* in a safe state leads to S_safe; no tie-breaking rule is "
        "needed.",
        check=check_recovery,
        mutants={
            "max for min": MAX_RECOVERY,
            "recovery from the wrong critic": BEST_IS_OF_FIRST_ACTIONS,
            "stopped early": STOPPED_EARLY,
        },
        rests_on="deterministic, base convention",
        kernel=("Theorem2_recovery",),
    ),
    Row(
        name="theorem-2",
        place="Theorem 2; contribution 3, plug and play",
        claim="From a safe start the corrected agent never leaves S_safe, whatever the task "
        "policy proposes (gate and recovery from Q*).",
        check=check_loop,
        mutants={
            **SOUND,
            "max for min": MAX_RECOVERY,
            "recovery from the wrong critic": RECOVERY_FROM_GATE,
        },
        rests_on=REACH,
        kernel=("Theorem2",),
    ),
    Row(
        name="theorem-2-policy-gate",
        place="Theorem 2 with the critic of the task policy",
        claim="A gate on Q^pi of any policy with recovery greedy on Q* never leaves S_safe.",
        check=check_policy_gate,
        mutants={**SOUND, "recovery from the wrong critic": RECOVERY_FROM_GATE},
        rests_on=REACH,
        kernel=("Theorem2",),
    ),
    Row(
        name="theorem-2-policy-recovery",
        place="Theorem 2 with the recovery policy of RRL",
        claim="A gate on Q* with recovery greedy on Q^pi_task never leaves S_safe.",
        check=check_policy_recovery,
        holds=False,
        mutants={"the policy is the best one": EVALUATION_IS_BEST},
        rests_on=REACH,
        because="The task policy takes a0 everywhere. In the safe state from which it would fail, "
        "its critic values staying by the failure that comes after it, no better than the way "
        "into a dead-end; a minimiser leads there, and the task's blocked proposal calls for it.",
    ),
    Row(
        name="exactness",
        place="Abstract, Figure 1, after Lemma 1 ('optimal boundary')",
        claim="In safe states, Q*(s, a) < eps exactly if the action stays in S_safe: no safe "
        "action is blocked, no unsafe one allowed.",
        check=check_exact,
        mutants={
            **SOUND,
            "nothing allowed": NOTHING_ALLOWED,
            "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS,
            "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
        },
        rests_on=REACH,
        kernel=("Exactness",),
    ),
    Row(
        name="tightness",
        place="Theorem 2, eps_safe = gamma_safe^H",
        claim="gamma^H_b is the largest threshold that works: just above it an unsafe action of a "
        "safe state is allowed.",
        check=check_tight,
        mutants={
            "epsilon one power too small": EPSILON_TOO_SMALL,
            "H one too long": HORIZON_TOO_LONG,
        },
        rests_on="deterministic, base convention; some safe state has an unsafe successor",
        kernel=("Tightness",),
    ),
    Row(
        name="theorem-2-paper-threshold",
        place="Theorem 2, eps_safe = gamma_safe^H",
        claim="The paper's eps = gamma^H is sufficient, and exact.",
        check=check_paper_threshold,
        mutants={
            "epsilon one power too large": EPSILON_TOO_LARGE,
            "H off by one": HORIZON_TOO_SHORT,
        },
        rests_on="deterministic, base convention",
        kernel=("Threshold", "Exactness"),
    ),
    Row(
        name="least-conservative",
        place="Abstract ('minimum limitation on exploration')",
        claim="A task policy that never leaves S_safe by itself is never corrected.",
        check=check_untouched,
        mutants={
            "nothing allowed": NOTHING_ALLOWED,
            "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
        },
        rests_on=REACH,
        kernel=("Exactness",),
    ),
)
PATHS = Row(
    name="theorem-2-paths",
    place="Theorem 2",
    claim="No path of the corrected agent from a safe start leaves S_safe, followed step by step.",
    check=check_paths,
    mutants={"epsilon one power too large": EPSILON_TOO_LARGE, "not strict": NOT_STRICT},
    rests_on=REACH,
    kernel=("Theorem2",),
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_drawn_models = sampled_test((*ROWS, PATHS), drawn_deterministic())
test_wrong_variants = teeth_test(ROWS)
test_counterexamples = counterexample_test(ROWS)


@lru_cache(maxsize=1)
def followed() -> Sequence[Case]:
    """One model of each class with n <= 3, m <= 3 or n = 4, m = 2, one by one."""
    chosen = [case for case in small_cases() if (case.states - 1) * case.model.num_actions <= 6]
    return [
        replace(case.take(i), weight=case.weight[i : i + 1])
        for case in chosen
        for i in range(case.count)
    ]


def test_every_path_of_every_model_with_four_states(record: Recorder) -> None:
    """Every labelled model with n <= 3, m <= 3 or n = 4, m = 2."""
    total = run(PATHS, LIBRARY, iter(followed()))
    assert total.models == sum(count(n, m) for n in (1, 2, 3) for m in (2, 3)) + count(4, 2)
    record(PATHS, Means.EXHAUSTIVE, total)
    judge(PATHS, total)


test_wrong_paths = teeth_test((PATHS,), followed)
