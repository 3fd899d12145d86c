"""Theorem 1 in both readings, when its inclusion is strict, when it is vacuous; self-reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache, partial
from itertools import product

import numpy as np

from dead_ends.paper import allowed_inclusion, policy_stays
from dead_ends.safety.policies import Reading
from proofs_check.machinery.cases import (
    Case,
    drawn_deterministic,
    drawn_stochastic,
    small_cases,
    stochastic_cases,
)
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    grid_test,
    judge,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.implementation import (
    BEST_IS_OF_FIRST_ACTIONS,
    BEST_IS_OF_LAST_ACTIONS,
    EPSILON_TOO_LARGE,
    EVALUATION_IS_BEST,
    LIBRARY,
    NOT_STRICT,
    NOTHING_ALLOWED,
    PER_ACTION,
    STOPPED_EARLY,
    STOPPED_EARLY_FROM_ABOVE,
    SWAPPED_CRITICS,
    WORST_CRITIC,
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
    just_above,
    of_task,
)


def levels(case: Case) -> list[Discount]:
    """Every power of gamma that can be a value here, and just above each."""
    powers = [case.gamma**k for k in range(min(case.states, 6) + 1)]
    return [*powers, *(just_above(power) for power in powers), case.gamma * 3 / 4]


def check_inclusion(implementation: Implementation, case: Case) -> Finding:
    """Per action: what Q^pi allows in S_safe, Q* allows, for every threshold."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    wrong = np.zeros(own.shape, dtype=np.bool_)
    met = np.zeros(own.shape, dtype=np.bool_)
    for epsilon in levels(case):
        smaller, larger = (implementation.allowed(Q, epsilon) for Q in (own, star))
        wrong |= allowed_inclusion(smaller, larger, case.safe)
        met |= smaller & case.safe[:, None]
    return finding(case, wrong, met)


def check_strictness(implementation: Implementation, case: Case) -> Finding:
    """Strict exactly if some safe (s, a) has Q*(s, a) < eps <= Q^pi(s, a).

    Per action, a policy set is a product over S_safe of sets of actions; it is empty if one
    factor is.
    """
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    wrong = np.zeros(case.count, dtype=np.bool_)
    met = np.zeros(case.count, dtype=np.bool_)
    for epsilon in levels(case):
        smaller, larger = (implementation.allowed(Q, epsilon) for Q in (own, star))
        empty, empty_star = (
            case.any_of(case.safe & ~mask.any(axis=1)) for mask in (smaller, larger)
        )
        gained = case.any_of(case.safe[:, None] & larger & ~smaller)
        strict = ~empty_star & (empty | gained)
        wrong |= strict != gained
        met |= strict
    return finding(case, wrong, met)


def check_equal(implementation: Implementation, case: Case) -> Finding:
    """Pi^pi = Pi* at eps = gamma^H_b: nothing is gained over RRL's set with a fixed pi_task."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    epsilon = boundary_thresholds(implementation, case)
    smaller, larger = (allowed(implementation, case, Q, epsilon) for Q in (own, star))
    return finding(case, case.safe[:, None] & (larger != smaller))


def check_not_empty(implementation: Implementation, case: Case, critic_of_task: bool) -> Finding:
    """Every safe state keeps an action, at eps = gamma^H_b."""
    _, Q = of_task(implementation, case) if critic_of_task else best(implementation, case)
    kept = allowed(implementation, case, Q, boundary_thresholds(implementation, case))
    return finding(case, case.safe & ~kept.any(axis=1), case.safe)


def check_self_reference(implementation: Implementation, case: Case) -> Finding:
    """pi in Pi^pi <=> pi in Pi* <=> pi never leaves S_safe; per action, 0 < eps <= gamma^H_b."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    stays = ~case.any_of(policy_stays(case.model, case.safe, case.support))
    wrong = np.zeros(case.count, dtype=np.bool_)
    edge = boundary_thresholds(implementation, case)
    for epsilon in (edge, [e * 3 / 4 for e in edge]):
        for Q in (star, own):
            kept = allowed(implementation, case, Q, epsilon)
            member = ~case.any_of(case.safe[:, None] & case.support & ~kept)
            wrong |= member != stays
    return finding(case, wrong, case.boundary >= 0)


def mixtures(case: Case) -> list[Table]:
    """All policies of a single model with m = 2 in quarters of probability; halves if n > 2."""
    parts = 4 if case.states == 2 else 2
    shares = [[Fraction(k, parts), 1 - Fraction(k, parts)] for k in range(parts + 1)]
    rows = [shares if safe else shares[-1:] for safe in case.safe]
    return [np.array(choice, dtype=object) for choice in product(*rows)]


def drawn_mixtures(case: Case) -> list[Table]:
    """The task policy, the uniform one, and one action in every state, for any m."""
    available = case.model.available
    first = available.argmax(axis=1)
    uniform = np.full(available.shape, Fraction(0), dtype=object)
    for state, row in enumerate(available):
        options = np.flatnonzero(row) if row.any() else [0]
        uniform[state, options] = Fraction(1, len(options))
    last = available.shape[1] - 1 - available[:, ::-1].argmax(axis=1)
    return [case.task, uniform, first, np.where(available.any(axis=1), last, 0)]


def check_inclusion_of_members(
    implementation: Implementation, case: Case, reading: Reading
) -> Finding:
    """mu in Pi^pi => mu in Pi*, for a few policies mu; a single model."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    wrong = met = False
    for epsilon in levels(case):
        for policy in drawn_mixtures(case):
            if implementation.member(policy, own, epsilon, case.safe, reading):
                met = True
                wrong |= not implementation.member(policy, star, epsilon, case.safe, reading)
    return Finding(np.array([wrong]), np.array([met]))


def members(implementation: Implementation, case: Case, Q: Table, epsilon: Discount) -> list[bool]:
    """Which of the mixtures lie in the set of a critic, expectation reading."""
    return [
        implementation.member(policy, Q, epsilon, case.safe, Reading.EXPECTATION)
        for policy in mixtures(case)
    ]


def check_strictness_in_expectation(implementation: Implementation, case: Case) -> Finding:
    """Strict exactly if some (s, a) has Q* < eps <= Q^pi, expectation reading, eps = gamma."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    epsilon = case.gamma
    strict = members(implementation, case, own, epsilon) != members(
        implementation, case, star, epsilon
    )
    gained = case.safe[:, None] & (star < epsilon) & (own >= epsilon) & (own < np.inf)
    return Finding(np.array([strict != gained.any()]), np.array([strict]))


def check_self_reference_in_expectation(implementation: Implementation, case: Case) -> Finding:
    """pi in Pi^pi <=> pi in Pi*, expectation reading, eps in (0, gamma^H_b] in fifths."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    (edge,) = boundary_thresholds(implementation, case)
    wrong = False
    for fifth in range(1, 6):
        inside = [
            implementation.member(case.task, Q, edge * fifth / 5, case.safe, Reading.EXPECTATION)
            for Q in (own, star)
        ]
        wrong |= inside[0] != inside[1]
    return Finding(np.array([wrong]), case.boundary >= 0)


def check_members_never_fail(implementation: Implementation, case: Case) -> Finding:
    """A policy in its own set Pi^pi never leaves S_safe, expectation reading."""
    _, own = of_task(implementation, case)
    (edge,) = boundary_thresholds(implementation, case)
    inside = implementation.member(case.task, own, edge, case.safe, Reading.EXPECTATION)
    stays = not policy_stays(case.model, case.safe, case.support).any()
    return Finding(np.array([inside and not stays]), np.array([inside]))


@lru_cache(maxsize=1)
def mixed_cases() -> Sequence[Case]:
    """Every class with n <= 3, m = 2, the task policy in quarters, one case each."""
    cases = []
    for case in small_cases():
        if case.model.num_actions == 2 and 1 < case.states <= 3:
            for index in range(case.count):
                single = replace(
                    case.take(index), gamma=Fraction(1, 2), weight=case.weight[index : index + 1]
                )
                cases += [replace(single, task=policy) for policy in mixtures(single)]
    return tuple(cases)


ANY = "base convention; any eps; a fixed pi_task"
DETERMINISTIC = (
    Row(
        name="theorem-1-strict",
        place="Theorem 1",
        claim="Per action, Pi_c^pi_task is a strict subset of Pi_c^pi_rec* exactly if some safe "
        "(s, a) has Q* < eps <= Q^pi_task.",
        check=check_strictness,
        mutants={"Q of another policy for Q*": BEST_IS_OF_LAST_ACTIONS},
        rests_on=f"deterministic; {ANY}",
    ),
    Row(
        name="theorem-1-equality",
        place="Theorem 1",
        claim="At eps = gamma^H_b the two sets are always equal.",
        check=check_equal,
        holds=False,
        mutants={"Q* for Q^pi": EVALUATION_IS_BEST},
        rests_on="deterministic, base convention, per action; pi_task fixed: always a0",
        because="The task policy a0 fails from the safe state, so Q^pi_task blocks the other "
        "action too where it merely stays; Q* allows it. (This is the gain of Theorem 1.)",
    ),
    Row(
        name="theorem-1-vacuous",
        place="Theorem 1",
        claim="Pi_c^pi_task is never empty for 0 < eps <= gamma^H_b.",
        check=partial(check_not_empty, critic_of_task=True),
        holds=False,
        mutants={"Q* for Q^pi": EVALUATION_IS_BEST},
        rests_on="deterministic, base convention, per action; pi_task fixed: always a0",
        because="The task policy a0 fails within the survival time of the dead-end that it could "
        "enter, whatever is done first: Q^pi_task >= eps for every action of the safe state.",
    ),
    Row(
        name="theorem-1-not-vacuous",
        place="Theorem 1",
        claim="Pi_c^pi_rec* is never empty for 0 < eps <= gamma^H_b.",
        check=partial(check_not_empty, critic_of_task=False),
        mutants={
            "nothing allowed": NOTHING_ALLOWED,
            "max in the critic": WORST_CRITIC,
            "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS,
        },
        rests_on="deterministic, base convention, per action",
        kernel=("Partition", "Exactness"),
    ),
    Row(
        name="self-reference",
        place="Objective of RRL, pi in Pi_c^pi",
        claim="With the objectives as written, RRL's and DEA-RRL's feasible sets are equal: the "
        "policies that stay in S_safe from every safe state.",
        check=check_self_reference,
        mutants={
            "epsilon one power too large": EPSILON_TOO_LARGE,
            "not strict": NOT_STRICT,
            "stopped early": STOPPED_EARLY,
            "max in the critic": WORST_CRITIC,
        },
        rests_on="deterministic, base convention, per action, 0 < eps <= gamma^H_b",
        kernel=("SelfReference",),
    ),
)
BOTH = (
    Row(
        name="theorem-1",
        place="Theorem 1",
        claim="Pi_c^pi_task is contained in Pi_c^pi_rec*, per action.",
        check=check_inclusion,
        mutants={
            "max in the critic": WORST_CRITIC,
            "critics exchanged": SWAPPED_CRITICS,
            "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
        },
        rests_on=ANY,
        kernel=("Theorem1",),
    ),
)
MEMBERS = tuple(
    Row(
        name=f"theorem-1-members-{reading}",
        place="Theorem 1",
        claim=f"A policy in Pi_c^pi_task is in Pi_c^pi_rec*, {reading} reading, stochastic "
        "policies.",
        check=partial(check_inclusion_of_members, reading=reading),
        mutants={"max in the critic": WORST_CRITIC, "critics exchanged": SWAPPED_CRITICS},
        rests_on=ANY,
        kernel=("Theorem1",),
    )
    for reading in Reading
)
MIXED = (
    Row(
        name="theorem-1-strict-expectation",
        place="Theorem 1, Q(s, pi(s)) read as an expectation",
        claim="The inclusion is strict exactly if some safe (s, a) has Q* < eps <= Q^pi_task, "
        "expectation reading.",
        check=check_strictness_in_expectation,
        holds=False,
        mutants={"per action": PER_ACTION},
        rests_on="deterministic, base convention, gamma = eps = 1/2, pi_task in quarters",
        because="State 0 can stay or fail. No single action is gained, but a policy that mixes "
        "some failing into staying has a lower expectation under Q* than under Q^pi_task.",
    ),
    Row(
        name="self-reference-expectation",
        place="Objective of RRL, Q(s, pi(s)) read as an expectation",
        claim="RRL's and DEA-RRL's self-referential feasible sets are equal, expectation reading.",
        check=check_self_reference_in_expectation,
        holds=False,
        mutants={"per action": PER_ACTION},
        rests_on="deterministic, base convention, gamma = 1/2, eps in fifths of gamma^H_b",
        because="A policy that stays or fails by chance: its expectation is below eps under Q* "
        "but not under its own critic.",
    ),
    Row(
        name="members-never-fail-expectation",
        place="Pi_c, Q(s, pi(s)) read as an expectation",
        claim="A policy in its own set Pi_c^pi never leaves S_safe, expectation reading.",
        check=check_members_never_fail,
        holds=False,
        mutants={"per action": PER_ACTION},
        rests_on="deterministic, base convention, gamma = 1/2, eps = gamma^H_b",
        because="A policy that mostly stays and sometimes fails has an expectation below eps, yet "
        "it fails in the end with probability 1: the set must be read per action.",
    ),
)
STOCHASTIC = (
    Row(
        name="theorem-1-strict-stochastic",
        place="Theorem 1 in stochastic models",
        claim="Per action, the inclusion is strict exactly if some (s, a) of S_safe has "
        "Q* < eps <= Q^pi_task, in stochastic models too.",
        check=check_strictness,
        holds=False,
        mutants={"Q* for Q^pi": EVALUATION_IS_BEST},
        rests_on=ANY,
        because="An action is gained in one state, but in another state of S_safe no action at "
        "all is below eps: both sets are empty, and equal.",
    ),
)

test_all_small_models = exhaustive_test(DETERMINISTIC + BOTH)
test_six_states = large_test(DETERMINISTIC + BOTH)
test_drawn_models = sampled_test(DETERMINISTIC + BOTH + MEMBERS, drawn_deterministic())
test_grid = grid_test(BOTH + STOCHASTIC)
test_drawn_stochastic_models = sampled_test(BOTH + MEMBERS, drawn_stochastic())
test_wrong_variants = teeth_test(DETERMINISTIC + BOTH)
test_wrong_members = teeth_test(MEMBERS, lambda: mixed_cases()[::5])
test_wrong_mixtures = teeth_test(MIXED, mixed_cases)
test_wrong_stochastic = teeth_test(STOCHASTIC, stochastic_cases)
test_counterexamples = counterexample_test(DETERMINISTIC)
test_mixed_counterexamples = counterexample_test(MIXED, mixed_cases)
test_stochastic_counterexamples = counterexample_test(STOCHASTIC, stochastic_cases)


def test_mixed_policies_on_every_model_with_three_states(
    record: Recorder,
) -> None:
    """Every class with n <= 3, m = 2; every task policy in quarters."""
    for row in MIXED + MEMBERS:
        total = run(row, LIBRARY, iter(mixed_cases()))
        record(row, Means.EXHAUSTIVE, total)
        judge(row, total)
