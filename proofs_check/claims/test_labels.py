"""Definition 2 and Assumption 1: labels, survival times, horizons."""

from __future__ import annotations

import numpy as np

from dead_ends.labels.labelling import Label
from dead_ends.paper import assumption_1, definition_2
from proofs_check.machinery.cases import Case, drawn_deterministic, exhaustive_cases, small_cases
from proofs_check.machinery.checks import (
    exhaustive_test,
    judge,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.enumerate_models import count
from proofs_check.machinery.implementation import (
    DEAD_IF_ONE_PATH_FAILS,
    HORIZON_TOO_LONG,
    HORIZON_TOO_SHORT,
    LIBRARY,
    Implementation,
)
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import measured


def check_definition_2(implementation: Implementation, case: Case) -> Finding:
    """The labels are the truth, and as Definition 2 and Equation eq_ssafe say."""
    labelling = implementation.labels(case.model)
    truth = np.select([case.fail, case.dead], [Label.FAIL, Label.DEAD], Label.SAFE)
    wrong = (labelling.labels != truth) | definition_2(
        case.model, labelling.dead, labelling.paper_safe
    )
    return finding(case, wrong, case.dead)


def check_assumption_1(implementation: Implementation, case: Case) -> Finding:
    """T falls along every transition from a dead state; H = max T <= |S_dead|."""
    own = measured(implementation, case)
    longer = own.horizon > case.of_models(case.dead).sum(axis=1)
    wrong = assumption_1(case.model, case.dead, own.survival)
    return finding(case, case.any_of(wrong) | longer, case.dead)


def check_survival_time(implementation: Implementation, case: Case) -> Finding:
    """T is the most steps to failure, whatever is done: no bound below T is one."""
    own = measured(implementation, case)
    return finding(case, own.survival != case.survival, case.dead)


ROWS = (
    Row(
        name="definition-2",
        place="Definition 2, Eq. eq_ssafe",
        claim="S_fail, S_dead, S_safe partition the states; no action of a dead state leads to "
        "S_safe, and every safe state has an action that stays in S_safe.",
        check=check_definition_2,
        mutants={"dead if one path fails": DEAD_IF_ONE_PATH_FAILS},
        rests_on="deterministic",
        kernel=("Partition", "MemorylessDead"),
    ),
    Row(
        name="assumption-1",
        place="Assumption 1",
        claim="Every finite deterministic model has a horizon: the dead region is acyclic and "
        "H <= |S_dead|.",
        check=check_assumption_1,
        mutants={"H off by one": HORIZON_TOO_SHORT, "H one too long": HORIZON_TOO_LONG},
        rests_on="deterministic, finite",
        kernel=("Horizon", "Acyclic"),
    ),
    Row(
        name="survival-time",
        place="Assumption 1",
        claim="T(s) = 1 + max_a T(next(s, a)) is the greatest number of steps to failure over "
        "all policies.",
        check=check_survival_time,
        mutants={"T off by one": HORIZON_TOO_SHORT, "T one too long": HORIZON_TOO_LONG},
        rests_on="deterministic",
        kernel=("SurvivalTime",),
    ),
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_drawn_models = sampled_test(ROWS, drawn_deterministic())
test_wrong_variants = teeth_test(ROWS)


def test_the_bound_on_the_horizon_is_attained() -> None:
    """For every size some model has H = |S_dead| = n - 1: a chain."""
    for case in small_cases():
        if case.states > 1:
            assert case.horizon.max() == case.states - 1


def check_horizons_of_a_model(implementation: Implementation, case: Case) -> Finding:
    """The library's H and H_b, model by model, and H_b <= H."""
    wrong = []
    for index in range(case.count):
        labelling = implementation.labels(case.take(index).model)
        boundary = -1 if labelling.boundary_horizon is None else labelling.boundary_horizon
        wrong.append((labelling.horizon, boundary) != (case.horizon[index], case.boundary[index]))
    return finding(case, np.array(wrong) | (case.boundary > case.horizon), case.boundary >= 0)


BOUNDARY = Row(
    name="boundary-horizon",
    place="Theorem 2",
    claim="H = max T over S_dead; H_b, the greatest T that one action enters from S_safe, "
    "satisfies H_b <= H.",
    check=check_horizons_of_a_model,
    mutants={"H off by one": HORIZON_TOO_SHORT},
    rests_on="deterministic",
    kernel=("Threshold",),
)


def test_horizons_of_every_model_with_four_states(record: Recorder) -> None:
    """Every labelled model with n <= 4, m = 2, one by one."""
    cases = [c for c in exhaustive_cases() if c.states <= 4 and c.model.num_actions == 2]
    total = run(BOUNDARY, LIBRARY, iter(cases))
    assert total.models == sum(count(n, 2) for n in range(1, 5))
    record(BOUNDARY, Means.EXHAUSTIVE, total)
    judge(BOUNDARY, total)


test_wrong_horizons = teeth_test((BOUNDARY,), lambda: small_cases()[:3])
