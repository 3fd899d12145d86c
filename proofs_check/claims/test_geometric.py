"""What replaces Theorem 2 in stochastic models: a bound on surviving N steps.

X = P_min(ever fail), undiscounted. The gate lets an action pass if E X(s') < eps, the recovery
policy minimises E X(s'). Then P(no failure in N steps) >= (1 - X(s0)) (1 - eps)^N, whatever the
task policy proposes.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.paper import executed_actions, survival_bound
from dead_ends.values.conventions import ValueConvention
from proofs_check.machinery.cases import Case, drawn_stochastic, stochastic_case, stochastic_cases
from proofs_check.machinery.checks import counterexample_test, grid_test, sampled_test, teeth_test
from proofs_check.machinery.implementation import (
    CONVERGED,
    EVALUATION_IS_BEST,
    GAMMA_ONE,
    LIBRARY,
    MAX_RECOVERY,
    RECOVERY_FROM_GATE,
    UNDERESTIMATED,
    Implementation,
    Table,
)
from proofs_check.machinery.statement import Finding, Row, finding
from proofs_check.machinery.thresholds import TINY, best, of_task, transitions

ZERO: Any = Fraction(0)
ONE: Any = Fraction(1)
EPSILONS = (Fraction(1, 4), Fraction(1, 2), Fraction(1))
STEPS = 4


def undiscounted(implementation: Implementation, case: Case) -> tuple[Table, Table]:
    """X = P_min(ever fail), 1 on fail states, and E X(s') (inf: not available)."""
    one = replace(case, gamma=ONE)
    X, _ = best(implementation, one, value=ValueConvention.COST_FAIL_1)
    return X, np.where(case.model.available, transitions(case, X), np.inf)


def surviving(case: Case, executed: Table, steps: int) -> list[Table]:
    """For N = 0, ..., steps the least P(no failure in N steps), whatever is proposed.

    The proposals may depend on the past; against a fixed number of steps the worst of the
    executed actions depends on the state and the steps left alone.
    """
    alive = [np.where(case.fail, ZERO, ONE)]
    for _ in range(steps):
        chance = np.where(executed, transitions(case, alive[-1]), 2 * ONE)
        alive.append(np.where(case.fail, ZERO, chance.min(axis=1)))
    return alive


def check_geometric(implementation: Implementation, case: Case) -> Finding:
    """P(no failure in N steps) >= (1 - X) (1 - eps)^N, gate E X < eps, recovery greedy on E X."""
    X, critic = undiscounted(implementation, case)
    discounted = best(implementation, case)[1]
    greedy = implementation.greedy(implementation.recovery_critic(critic, discounted))
    wrong = np.zeros(len(X), dtype=np.bool_)
    for epsilon in EPSILONS:
        mask = executed_actions(
            case.model.available, implementation.allowed(critic, epsilon), greedy
        )
        for steps, alive in enumerate(surviving(case, mask, STEPS)):
            wrong |= survival_bound(alive, X, epsilon, steps)
            if steps:
                sharp = (1 - epsilon) ** (steps - 1) * np.minimum(1 - X, ONE - epsilon)
                wrong |= np.asarray(alive < sharp, dtype=np.bool_) & ~case.fail
    return finding(case, wrong, case.safe)


def check_geometric_policy(implementation: Implementation, case: Case) -> Finding:
    """The same with X^pi, the task policy's own risk, and recovery pi itself."""
    one = replace(case, gamma=ONE)
    X, _ = of_task(implementation, one, value=ValueConvention.COST_FAIL_1)
    critic = np.where(case.model.available, transitions(case, X), np.inf)
    wrong = np.zeros(len(X), dtype=np.bool_)
    for epsilon in EPSILONS:
        mask = executed_actions(
            case.model.available, implementation.allowed(critic, epsilon), case.support
        )
        for steps, alive in enumerate(surviving(case, mask, STEPS)):
            wrong |= survival_bound(alive, X, epsilon, steps)
    return finding(case, wrong, case.safe)


def check_geometric_discounted_recovery(implementation: Implementation, case: Case) -> Finding:
    """The geometric bound with recovery greedy on the discounted Q*."""
    X, critic = undiscounted(implementation, case)
    _, Q = best(implementation, case)
    return bounded(implementation, case, X, critic, implementation.greedy(Q))


def check_geometric_underestimated(implementation: Implementation, case: Case) -> Finding:
    """The geometric bound with X from two sweeps of value iteration from below."""
    X = implementation.swept(case.model, 2)
    critic = np.where(case.model.available, transitions(case, X), np.inf)
    return bounded(implementation, case, X, critic, implementation.greedy(critic))


def bounded(
    implementation: Implementation, case: Case, X: Table, critic: Table, recovery: Table
) -> Finding:
    """Where the geometric bound fails, over several thresholds and numbers of steps."""
    wrong = np.zeros(len(X), dtype=np.bool_)
    for epsilon in EPSILONS:
        passes = implementation.allowed(critic, epsilon)
        mask = executed_actions(case.model.available, passes, recovery)
        for steps, alive in enumerate(surviving(case, mask, STEPS)):
            wrong |= survival_bound(alive, X, epsilon, steps)
    return finding(case, wrong, case.safe)


FALSE = (
    Row(
        name="geometric-discounted-recovery",
        place="Theorem 2, stochastic replacement",
        claim="The geometric bound holds with recovery greedy on the discounted Q*.",
        check=check_geometric_discounted_recovery,
        holds=False,
        mutants={"undiscounted": GAMMA_ONE},
        rests_on="stochastic; gamma = 1/2 for the recovery policy",
        because="The discounted recovery policy prefers certain but late failure to a risk that "
        "ends well with positive probability.",
    ),
    Row(
        name="geometric-underestimated",
        place="Theorem 2, stochastic replacement",
        claim="The geometric bound holds with X from value iteration from below, stopped after "
        "two sweeps.",
        check=check_geometric_underestimated,
        holds=False,
        mutants={"converged": CONVERGED},
        rests_on="stochastic; undiscounted",
        because="Too small an X promises (1 - X), more than any agent can keep, from a state that "
        "is bound to fail, only not yet within two steps.",
    ),
)
TRUE = (
    Row(
        name="geometric-bound",
        place="Theorem 2, stochastic replacement",
        claim="Gate E X(s') < eps, recovery greedy on E X, X = P_min(fail): P(no failure in N "
        "steps) >= (1 - X(s0)) (1 - eps)^N, and >= (1 - eps)^(N-1) min(1 - X(s0), 1 - eps).",
        check=check_geometric,
        mutants={
            "max for min": MAX_RECOVERY,
            "recovery from the wrong critic": RECOVERY_FROM_GATE,
            "stopped early": UNDERESTIMATED,
        },
        rests_on="stochastic; undiscounted; any proposals, depending on the past; N <= 4",
        kernel=("Geometric",),
    ),
    Row(
        name="geometric-bound-policy",
        place="RRL in stochastic models",
        claim="The geometric bound with X^pi of any policy pi and recovery pi itself.",
        check=check_geometric_policy,
        mutants={"X of the best policy": EVALUATION_IS_BEST},
        rests_on="stochastic; undiscounted; any proposals, depending on the past; N <= 4",
    ),
)

test_grid = grid_test(FALSE + TRUE)
test_drawn_models = sampled_test(TRUE, drawn_stochastic())
test_wrong_variants = teeth_test(FALSE + TRUE, stochastic_cases)
test_counterexamples = counterexample_test(FALSE, stochastic_cases)


@pytest.mark.parametrize("epsilon", [ONE, Fraction(1, 2), Fraction(1, 100), TINY])
def test_theorem_2_fails_for_every_epsilon(epsilon: Fraction) -> None:
    """n = 2, m = 2, s: {p -> fail, 1 - p -> s; stay} with p < eps survives (1 - p)^N only.

    As p tends to eps this is the geometric bound: it is tight where X = 0.
    """
    p = epsilon * (1 - TINY)
    case = two_states(p)
    X, critic = undiscounted(LIBRARY, case)
    assert list(X) == [0, 1]
    mask = executed_actions(
        case.model.available, LIBRARY.allowed(critic, epsilon), LIBRARY.greedy(critic)
    )
    assert mask[0].all()
    for steps, alive in enumerate(surviving(case, mask, 4)):
        assert alive[0] == (1 - p) ** steps


def two_states(p: Fraction) -> Case:
    """s: {p -> fail, 1 - p -> s; stay}."""
    P = np.full((2, 2, 2), ZERO, dtype=object)
    P[0, 0] = [1 - p, p]
    P[0, 1, 0] = ONE
    model = SafeMDP.stochastic(P, np.array([False, True]))
    return stochastic_case(model, Fraction(1, 2), np.zeros(2, dtype=np.int64))
