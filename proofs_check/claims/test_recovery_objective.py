"""The recovery objective is the optimal Bellman equation; how policy iteration reaches it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache

import numpy as np

from dead_ends.paper import bellman_equation
from proofs_check.machinery import oracles
from proofs_check.machinery.cases import (
    Case,
    drawn_deterministic,
    drawn_stochastic,
    exhaustive_cases,
    small_cases,
)
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
    GAMMA_HALF,
    LIBRARY,
    LITERAL_CRITIC,
    MAX_RECOVERY,
    STOPPED_EARLY,
    STOPPED_EARLY_FROM_ABOVE,
    WORST_CRITIC,
    Implementation,
    Table,
)
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import best, of_task


def check_bellman(implementation: Implementation, case: Case) -> Finding:
    """V* solves the Bellman equation, no policy is better, and the greedy policy attains it."""
    V, Q = best(implementation, case)
    greedy = implementation.greedy(Q).argmax(axis=1)
    attained, _ = implementation.of_policy(case.model, greedy, case.gamma)
    task, _ = of_task(implementation, case)
    wrong = bellman_equation(V, Q, case.fail) | (attained != V) | (task < V)
    return finding(case, np.asarray(wrong, dtype=np.bool_), np.asarray(task > V, dtype=np.bool_))


def check_minimum(implementation: Implementation, case: Case) -> Finding:
    """V*(s) is the least V^pi(s) over all policies, by trying all of them, model by model."""
    wrong = np.zeros(case.count, dtype=np.bool_)
    for index in range(case.count):
        single = case.take(index)
        gamma = Fraction(single.gamma)
        V, Q = implementation.best(single.model, gamma)
        truth = oracles.optimal_entry_cost(single.model, gamma)
        targets = np.array(oracles.loss_target(single.model, truth, gamma), dtype=object)
        wrong[index] = (np.asarray(V) != truth).any() or (np.asarray(Q) != targets).any()
    return finding(case, wrong)


def improved(implementation: Implementation, case: Case) -> Table:
    """Policy iteration from the task policy; a minimiser that is in use is kept."""
    policy = case.task
    for _ in range(case.states * case.model.num_actions + 1):
        _, Q = implementation.of_policy(case.model, policy, case.gamma)
        greedy = implementation.greedy(Q)
        kept = greedy[np.arange(len(policy)), policy]
        if (kept | case.fail).all():
            return Q
        policy = np.where(kept, policy, greedy.argmax(axis=1))
    return Q


def check_policy_iteration(implementation: Implementation, case: Case) -> Finding:
    """It ends at Q*, from every deterministic policy."""
    _, Q = best(implementation, case)
    wrong = case.model.available & np.asarray(improved(implementation, case) != Q, dtype=np.bool_)
    return finding(case, wrong)


def check_policy_iteration_at_one(implementation: Implementation, case: Case) -> Finding:
    """The same at gamma = 1."""
    return check_policy_iteration(
        implementation,
        replace(case, gamma=Fraction(1) if isinstance(case.gamma, Fraction) else 1.0),
    )


def check_bootstrap_on_minimum(implementation: Implementation, case: Case) -> Finding:
    """Q* is the fixed point of c + (1 - c) gamma min_a' Q(s', a'), RRL (MSDP)'s target."""
    _, Q = best(implementation, case)
    least = np.where(case.fail, 0, Q.min(axis=1))
    successors = case.model.successors()
    target = np.where(case.fail[successors], 1, case.gamma * least[successors])
    return finding(case, case.model.available & np.asarray(target != Q, dtype=np.bool_))


BOTH = (
    Row(
        name="bellman-optimal",
        place="Recovery objective, 'equivalent to solving the optimal Bellman equation'",
        claim="The critic of the best recovery policy solves V = min_a Q; no policy does better, "
        "in any state; some policy attains it.",
        check=check_bellman,
        mutants={
            "max for min": MAX_RECOVERY,
            "max in the critic": WORST_CRITIC,
            "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS,
            "stopped early": STOPPED_EARLY,
            "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
        },
        kernel=("Value_exists", "Optimal_exists"),
    ),
)
ITERATION = (
    Row(
        name="policy-iteration",
        place="Recovery objective, J_rec with Q^pi_rec",
        claim="Evaluating pi_rec and making it greedy in turn reaches Q* from every start, for "
        "gamma_safe < 1.",
        check=check_policy_iteration,
        mutants={"max for min": MAX_RECOVERY, "stopped early": STOPPED_EARLY},
    ),
    Row(
        name="policy-iteration-gamma-one",
        place="Recovery objective at gamma_safe = 1",
        claim="Evaluating pi_rec and making it greedy in turn reaches Q* at gamma_safe = 1 too.",
        check=check_policy_iteration_at_one,
        holds=False,
        mutants={"gamma = 1/2": GAMMA_HALF},
        because="The recovery policy starts with the action that fails. The other action stays, "
        "but as the policy is to fail in the next step, it too is valued 1: a tie, and the "
        "policy is kept.",
    ),
    Row(
        name="rrl-msdp",
        place="Experiments, RRL (MSDP)",
        claim="Bootstrapping on min_a' Q gives the critic of DEA-RRL.",
        check=check_bootstrap_on_minimum,
        mutants={"Q = E V(s')": LITERAL_CRITIC, "Q of one policy": BEST_IS_OF_FIRST_ACTIONS},
        rests_on="RRL (MSDP) read as the target c + (1 - c) gamma min_a' Q(s', a')",
    ),
)
MINIMUM = Row(
    name="best-of-all-policies",
    place="Recovery objective, pi_rec*",
    claim="V* and Q* are the least over all policies.",
    check=check_minimum,
    mutants={
        "max in the critic": WORST_CRITIC,
        "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS,
        "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
    },
    rests_on="base convention; policies tried one by one",
    kernel=("Optimal_exists",),
)

test_all_small_models = exhaustive_test(BOTH + ITERATION)
test_six_states = large_test(BOTH + ITERATION)
test_drawn_models = sampled_test(BOTH, drawn_deterministic())
test_drawn_deterministic_policies = sampled_test(ITERATION, drawn_deterministic(False))
test_drawn_stochastic_models = sampled_test((*BOTH, MINIMUM), drawn_stochastic())
test_wrong_variants = teeth_test(BOTH + ITERATION)
test_counterexamples = counterexample_test(ITERATION)


@lru_cache(maxsize=1)
def three_states() -> Sequence[Case]:
    """Every model with n <= 3, m <= 3."""
    return tuple(case for case in exhaustive_cases() if case.states <= 3)


def test_every_policy_of_every_model_with_three_states(record: Recorder) -> None:
    """Brute force over policies on every labelled model with n <= 3."""
    total = run(MINIMUM, LIBRARY, iter(three_states()))
    assert total.models == sum(count(n, m) for n in (1, 2, 3) for m in (2, 3))
    record(MINIMUM, Means.EXHAUSTIVE, total)
    judge(MINIMUM, total)


test_wrong_minima = teeth_test((MINIMUM,), lambda: small_cases()[:6])
