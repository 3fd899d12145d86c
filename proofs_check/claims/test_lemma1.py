"""Lemma 1, its three bullets, and where V* is positive."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.paper import lemma_1_dead, lemma_1_fail, lemma_1_safe, positive_exactly
from dead_ends.values.conventions import ValueConvention
from proofs_check.machinery.cases import Case, drawn_deterministic
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.implementation import (
    BEST_IS_OF_FIRST_ACTIONS,
    COST_ON_ENTERING,
    DISCOUNTED_TIME,
    FAIL_IS_ONE,
    HORIZON_TOO_SHORT,
    LITERAL_CRITIC,
    STOPPED_EARLY,
    STOPPED_EARLY_FROM_ABOVE,
    WORST_CRITIC,
    Implementation,
)
from proofs_check.machinery.statement import Finding, Row, finding
from proofs_check.machinery.thresholds import best, measured, of_task

TIME = ValueConvention.TIME


def powers(case: Case, exponents: NDArray[np.int64]) -> NDArray[Any]:
    """gamma^exponent for each state of each model."""
    table: NDArray[Any] = np.array([case.gamma ** int(e) for e in exponents], dtype=object)
    return case.spread(table)


def check_fail_literally(implementation: Implementation, case: Case) -> Finding:
    """V^pi(fail) = 1, with V^pi the paper's expected cost from there on."""
    V, _ = of_task(implementation, case)
    return finding(case, lemma_1_fail(V, case.fail))


def check_fail_is_harmless(implementation: Implementation, case: Case) -> Finding:
    """Under the loss target, V(fail) does not matter: c = 1 removes it from Q."""
    same = np.ones(case.count, dtype=np.bool_)
    for solve in (best, of_task):
        _, zero = solve(implementation, case)
        _, one = solve(implementation, case, value=ValueConvention.COST_FAIL_1)
        same &= ~case.any_of(np.asarray(zero != one, dtype=np.bool_))
    return finding(case, ~same)


def check_dead(implementation: Implementation, case: Case) -> Finding:
    """V^pi >= V* >= gamma^(H - 1), with equality for the last where T = H."""
    V_task, V_best = of_task(implementation, case)[0], best(implementation, case)[0]
    own = measured(implementation, case)
    bound = powers(case, np.maximum(own.horizon, 1) - 1)
    attained = case.dead & (case.survival == case.spread(case.horizon))
    wrong = lemma_1_dead(V_task, V_best, case.dead, bound)
    return finding(case, wrong | (attained & (V_best != bound)), case.dead)


def check_dead_discounted_time(implementation: Implementation, case: Case) -> Finding:
    """The same bound for V = E gamma^T: it misses one power."""
    V_task, V_best = (
        of_task(implementation, case, value=TIME)[0],
        best(implementation, case, value=TIME)[0],
    )
    bound = powers(case, np.maximum(case.horizon, 1) - 1)
    return finding(case, lemma_1_dead(V_task, V_best, case.dead, bound), case.dead)


def check_dead_discounted_time_repaired(implementation: Implementation, case: Case) -> Finding:
    """V = E gamma^T >= gamma^H."""
    own = measured(implementation, case)
    V_task, V_best = (
        of_task(implementation, case, value=TIME)[0],
        best(implementation, case, value=TIME)[0],
    )
    wrong = lemma_1_dead(V_task, V_best, case.dead, powers(case, own.horizon))
    attained = case.dead & (case.survival == case.spread(case.horizon))
    loose = attained & (V_best != powers(case, own.horizon))
    return finding(case, wrong | loose, case.dead)


def check_safe(implementation: Implementation, case: Case) -> Finding:
    """V^pi >= V* = 0 on S_safe."""
    V_task, V_best = of_task(implementation, case)[0], best(implementation, case)[0]
    return finding(case, lemma_1_safe(V_task, V_best, case.safe), case.safe)


def check_positive(implementation: Implementation, case: Case) -> Finding:
    """V* > 0 exactly on S_dead, and on S_fail too where V(fail) = 1."""
    zero = positive_exactly(best(implementation, case)[0], case.dead)
    one = positive_exactly(
        best(implementation, case, value=ValueConvention.COST_FAIL_1)[0], case.dead | case.fail
    )
    return finding(case, zero | one, case.dead)


ROWS = (
    Row(
        name="lemma-1-fail",
        place="Lemma 1, first bullet",
        claim="V^pi(s) = V*(s) = 1 for s in S_fail, V as the paper defines it.",
        check=check_fail_literally,
        holds=False,
        mutants={"V(fail) set to 1": FAIL_IS_ONE, "discounted time": DISCOUNTED_TIME},
        rests_on="Eq. state_cost_function: no cost is incurred after the episode's end",
        kernel=("Lemma1_bullet1",),
        because="The episode has ended in fail: no transition follows, so the sum of costs from "
        "there on is 0, not 1.",
    ),
    Row(
        name="lemma-1-fail-harmless",
        place="Lemma 1, first bullet",
        claim="With the target c + (1 - c) gamma V(s') of the loss, Q does not depend on whether "
        "V(fail) is 0 or 1.",
        check=check_fail_is_harmless,
        mutants={"Q = E V(s')": LITERAL_CRITIC},
    ),
    Row(
        name="lemma-1-dead",
        place="Lemma 1, second bullet",
        claim="V^pi(s) >= V*(s) >= gamma^(H-1) for s in S_dead, attained where T(s) = H.",
        check=check_dead,
        mutants={
            "H off by one": HORIZON_TOO_SHORT,
            "stopped early": STOPPED_EARLY,
            "max for min": WORST_CRITIC,
        },
        rests_on="V = discounted cost on entering fail",
        kernel=("Lemma1_bullet2",),
    ),
    Row(
        name="lemma-1-dead-time",
        place="Lemma 1, second bullet; proof of Theorem 2",
        claim="V*(s) >= gamma^(H-1) for s in S_dead also if V = E gamma^T.",
        check=check_dead_discounted_time,
        holds=False,
        mutants={"cost on entering": COST_ON_ENTERING},
        rests_on="V = E gamma^(time to fail)",
        because="One step before failing V = gamma, but H = 1 and gamma^(H-1) = 1.",
    ),
    Row(
        name="lemma-1-dead-time-repaired",
        place="Lemma 1, second bullet",
        claim="V^pi(s) >= V*(s) >= gamma^H for s in S_dead if V = E gamma^T, attained where "
        "T(s) = H.",
        check=check_dead_discounted_time_repaired,
        mutants={"H off by one": HORIZON_TOO_SHORT, "cost on entering": COST_ON_ENTERING},
        rests_on="V = E gamma^(time to fail)",
        kernel=("Lemma1_bullet2",),
    ),
    Row(
        name="lemma-1-safe",
        place="Lemma 1, third bullet",
        claim="V^pi(s) >= V*(s) = 0 for s in S_safe.",
        check=check_safe,
        mutants={"max for min": WORST_CRITIC, "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS},
        kernel=("Lemma1_bullet3",),
    ),
    Row(
        name="positive-exactly",
        place="Figure 1, Lemma 1",
        claim="V* > 0 exactly on S_dead if V(fail) = 0, exactly on S_dead and S_fail if "
        "V(fail) = 1.",
        check=check_positive,
        mutants={
            "max for min": WORST_CRITIC,
            "stopped early from above": STOPPED_EARLY_FROM_ABOVE,
        },
        kernel=("Positive_value",),
    ),
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_drawn_models = sampled_test(ROWS, drawn_deterministic())
test_wrong_variants = teeth_test(ROWS)
test_counterexamples = counterexample_test(ROWS)
