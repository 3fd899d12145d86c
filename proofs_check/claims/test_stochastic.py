"""Stochastic models: what survives of the paper's statements, what does not, what replaces it.

"Dead" is D, the states that fail with probability 1 whatever is done, unless "all paths fail"
(D_sure) is said. S_safe is the paper's: everything that is neither fail nor dead.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from dead_ends.labels.labelling import Label
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.paper import (
    assumption_1,
    boundary_exact,
    definition_2,
    executed_actions,
    leaves,
    lemma_1_safe,
    one_step_bound,
    time_bound,
)
from dead_ends.values.conventions import ValueConvention
from proofs_check.machinery import oracles
from proofs_check.machinery.cases import (
    FOREVER,
    STOCHASTIC_SIZES,
    Case,
    Mask,
    drawn_stochastic,
    stochastic_cases,
    stochastic_count,
)
from proofs_check.machinery.checks import counterexample_test, grid_test, sampled_test, teeth_test
from proofs_check.machinery.implementation import (
    BEST_IS_OF_FIRST_ACTIONS,
    DISCOUNTED_TWICE,
    GAMMA_ONE,
    HORIZON_TOO_LONG,
    HORIZON_TOO_SHORT,
    INTERVAL_TOO_LARGE,
    LABELS_SURE,
    LIBRARY,
    NOT_STRICT,
    NOTHING_EVER_ALLOWED,
    ZERO_VALUES,
    Discount,
    Implementation,
    Table,
)
from proofs_check.machinery.statement import Finding, Row, finding
from proofs_check.machinery.thresholds import best, just_above, of_task, transitions

TIME = ValueConvention.TIME
ZERO: Any = Fraction(0)
ONE: Any = Fraction(1)
EPSILONS = (Fraction(1, 4), Fraction(1, 2), ONE)
STEPS = 4


def check_labels(implementation: Implementation, case: Case) -> Finding:
    """Labels by P_min, by brute force over policies; Definition 2 and eq_ssafe hold for them."""
    labelling = implementation.labels(case.model)
    zero = np.asarray(case.failing == 0, dtype=np.bool_)
    truth = np.select(
        [case.fail, case.dead, zero], [Label.FAIL, Label.DEAD, Label.SAFE], Label.AT_RISK
    )
    wrong = (labelling.labels != truth) | definition_2(
        case.model, labelling.dead, labelling.paper_safe
    )
    return finding(case, wrong, case.dead)


def check_assumption_1(implementation: Implementation, case: Case) -> Finding:
    """Some H bounds the trajectories from D."""
    labelling = implementation.labels(case.model)
    unbounded = labelling.dead & (labelling.survival_time == FOREVER)
    return finding(case, unbounded, case.dead)


def check_assumption_1_sure(implementation: Implementation, case: Case) -> Finding:
    """T bounds the trajectories from the states all of whose paths fail; T <= their number."""
    time = implementation.labels(case.model).survival_time.astype(np.int64)
    sure = (time < FOREVER) & ~case.fail
    wrong = (sure != case.sure) | assumption_1(case.model, case.sure, time).any(axis=1)
    longest = case.of_models(np.where(case.sure, time, 0)).max(axis=1)
    count = case.of_models(case.sure).sum(axis=1)
    return finding(case, case.any_of(wrong) | (longest > count), case.sure)


def check_value_zero(implementation: Implementation, case: Case) -> Finding:
    """Lemma 1, third bullet: V* = 0 on S_safe."""
    V, own = best(implementation, case)[0], of_task(implementation, case)[0]
    return finding(case, lemma_1_safe(own, V, case.safe), case.safe)


def check_separating(implementation: Implementation, case: Case) -> Finding:
    """A threshold that separates S_safe from S_dead: max V* on S_safe < min V* on S_dead."""
    V, _ = best(implementation, case)
    highest = case.of_models(np.where(case.safe, V, -1)).max(axis=1)
    lowest = case.of_models(np.where(case.dead, V, 2)).min(axis=1)
    met = case.any_of(case.safe) & case.any_of(case.dead)
    return finding(case, met & np.asarray(highest >= lowest, dtype=np.bool_), met)


def check_theorem_2(implementation: Implementation, case: Case) -> Finding:
    """From states that can avoid failure for sure the corrected agent never fails, eps = 1/2."""
    _, Q = best(implementation, case)
    zero = np.asarray(case.failing == 0, dtype=np.bool_)
    mask = executed_actions(
        case.model.available,
        implementation.allowed(Q, Fraction(1, 2)),
        implementation.greedy(Q),
    )
    return finding(case, leaves(case.model, zero) & mask, zero)


def check_recovery_keeps_hope(implementation: Implementation, case: Case) -> Finding:
    """Following a minimiser of Q* (gamma < 1), failure is not certain where it need not be."""
    _, Q = best(implementation, case)
    recovery = implementation.greedy(Q).argmax(axis=1)
    risk, _ = implementation.of_policy(case.model, recovery, ONE)
    return finding(case, case.safe & np.asarray(risk == 1, dtype=np.bool_), case.safe)


@lru_cache(maxsize=256)
def greatest_times(case: Case) -> Table:
    """E_max[time to fail] by the oracle, model by model; 0 where failure is not certain."""
    times: list[Fraction] = []
    for index in range(case.count):
        found = oracles.greatest_expected_time(case.take(index).model)
        times += [time if time is not None else ZERO for time in found]
    return np.array(times, dtype=object)


def check_time_bound(implementation: Implementation, case: Case) -> Finding:
    """V = min E gamma^T >= gamma^(E_max[T]) on D."""
    V, _ = best(implementation, case, value=TIME)
    gamma = Fraction(case.gamma)
    return finding(case, time_bound(V, greatest_times(case), gamma, case.dead), case.dead)


def check_one_step(implementation: Implementation, case: Case) -> Finding:
    """P(enter D or fail) <= Q* / gamma^(H_E), Q* = E V(s')."""
    horizon = case.of_models(np.where(case.dead, greatest_times(case), ZERO)).max(axis=1)
    return one_step(implementation, case, case.dead, horizon)


def check_one_step_sure(implementation: Implementation, case: Case) -> Finding:
    """The same for the states all of whose paths fail, H their longest path."""
    horizon = np.array([Fraction(int(h)) for h in case.horizon], dtype=object)
    return one_step(implementation, case, case.sure, horizon)


def one_step(implementation: Implementation, case: Case, dead: Mask, horizon: Table) -> Finding:
    """Where an action of a state that is neither dead nor fail breaks the bound."""
    V, _ = best(implementation, case, value=TIME)
    entering = transitions(case, np.where(dead | case.fail, ONE, ZERO))
    critic = transitions(case, V)
    wrong = np.zeros(entering.shape, dtype=np.bool_)
    at = ~(dead | case.fail)[:, None] & case.model.available
    for each in set(horizon):
        chosen = case.spread(np.asarray(horizon == each, dtype=np.bool_))[:, None]
        wrong |= one_step_bound(entering, critic, Fraction(case.gamma), each, at & chosen)
    return finding(case, wrong, dead)


def least_positive(case: Case, Q: Table) -> list[Fraction]:
    """eps_Z for each model: the least positive Q* in Z; 1 where there is none."""
    at = np.asarray(case.failing == 0, dtype=np.bool_)[:, None] & case.model.available
    positive = np.where(at & np.asarray(Q > 0, dtype=np.bool_), Q, ONE)
    return list(case.of_models(positive).reshape(case.count, -1).min(axis=1))


def check_zero_region(implementation: Implementation, case: Case) -> Finding:
    """For 0 < eps <= eps_Z: allowed exactly if all successors stay in Z, in states of Z."""
    _, Q = best(implementation, case)
    zero = np.asarray(case.failing == 0, dtype=np.bool_)
    edge = least_positive(case, Q)
    wrong = np.zeros(Q.shape, dtype=np.bool_)
    for share in (ONE, Fraction(3, 4), Fraction(1, 100)):
        mask = gate(implementation, case, Q, [e * share for e in edge])
        wrong |= boundary_exact(case.model, zero, mask)
    met = case.any_of(leaves(case.model, zero))
    above = gate(implementation, case, Q, [just_above(e) for e in edge])
    tight = case.any_of(boundary_exact(case.model, zero, above))
    return finding(case, case.any_of(wrong) | (met & ~tight), met)


def gate(
    implementation: Implementation, case: Case, Q: Table, epsilon: Sequence[Discount]
) -> Table:
    """{Q < epsilon}, with a threshold of its own in each model."""
    mask = np.zeros(Q.shape, dtype=np.bool_)
    for each in set(epsilon):
        chosen = case.spread(np.array([e == each for e in epsilon]))
        mask[chosen] = implementation.allowed(Q[chosen], each)
    return mask


def check_interval(implementation: Implementation, case: Case) -> Finding:
    """The toolkit's interval for a stochastic model ends at eps_Z."""
    _, Q = best(LIBRARY, case)
    zero = np.asarray(case.failing == 0, dtype=np.bool_)
    met = case.any_of(leaves(case.model, zero))
    wrong = np.zeros(case.count, dtype=np.bool_)
    for index, edge in enumerate(least_positive(case, Q)):
        interval = implementation.interval(case.take(index).model, Fraction(case.gamma))
        wrong[index] = interval.upper != (edge if met[index] else np.inf)
    return finding(case, wrong, met)


PLACE = "Assumption 1, Lemma 1 and Theorem 2 'uncertainties are ignored'"
DEAD_IS_D = "stochastic; dead: failure has probability 1 whatever is done; gamma = 1/2"
FALSE = (
    Row(
        name="stochastic-assumption-1",
        place="Assumption 1",
        claim="A finite stochastic model has a horizon H for its dead states.",
        check=check_assumption_1,
        holds=False,
        mutants={"dead: all paths fail": LABELS_SURE},
        rests_on=DEAD_IS_D,
        because="The dead state fails with some probability in every step and else stays: failure "
        "is certain, but no number of steps bounds it.",
    ),
    Row(
        name="stochastic-lemma-1-safe",
        place="Lemma 1, third bullet",
        claim="V* = 0 on S_safe in stochastic models.",
        check=check_value_zero,
        holds=False,
        mutants={"values not iterated": ZERO_VALUES},
        rests_on=DEAD_IS_D,
        because="A state may be neither dead nor free of risk: it fails with a probability "
        "between 0 and 1 whatever is done.",
    ),
    Row(
        name="stochastic-separating-threshold",
        place="Lemma 1, Theorem 2",
        claim="Some threshold separates V* on S_safe from V* on S_dead in stochastic models.",
        check=check_separating,
        holds=False,
        mutants={"undiscounted": GAMMA_ONE},
        rests_on=DEAD_IS_D,
        because="The dead state fails late and is discounted; the state at risk fails soon or "
        "never. Its V* is as large or larger, although it may escape.",
    ),
    Row(
        name="stochastic-theorem-2",
        place="Theorem 2",
        claim="From states that can avoid failure for sure, the corrected agent never fails "
        "(gate and recovery from Q*, eps = 1/2).",
        check=check_theorem_2,
        holds=False,
        mutants={"nothing allowed": NOTHING_EVER_ALLOWED},
        rests_on=DEAD_IS_D,
        kernel=("Stochastic_refuted",),
        because="One action fails with probability 1/4 and else stays: its Q* = 1/4 is below eps "
        "each time it is proposed, and an agent that repeats it fails with probability 1. For "
        "every eps there is such a model.",
    ),
    Row(
        name="stochastic-recovery",
        place="Recovery objective, pi_rec*",
        claim="The optimal recovery policy (gamma < 1) never makes failure certain where it can "
        "be avoided with positive probability.",
        check=check_recovery_keeps_hope,
        holds=False,
        mutants={"undiscounted": GAMMA_ONE},
        rests_on=DEAD_IS_D,
        because="Discounting rewards delay: an action that puts certain failure off can have a "
        "lower cost than one that fails at once with some probability and else escapes for good.",
    ),
)
TRUE = (
    Row(
        name="stochastic-definition-2",
        place="Definition 2, Eq. eq_ssafe",
        claim="P_min = 0 and P_min < 1 are properties of the graph: labels found on it agree with "
        "brute force over policies.",
        check=check_labels,
        mutants={"dead: all paths fail": LABELS_SURE},
        rests_on="stochastic; dead: failure has probability 1 whatever is done",
        kernel=("MinFailure_exists", "Qualitative"),
    ),
    Row(
        name="stochastic-assumption-1-sure",
        place="Assumption 1",
        claim="The states all of whose paths fail have a horizon, at most their number.",
        check=check_assumption_1_sure,
        mutants={"H off by one": HORIZON_TOO_SHORT, "H one too long": HORIZON_TOO_LONG},
        rests_on="stochastic, finite; dead: all paths fail",
        kernel=("Horizon",),
    ),
    Row(
        name="stochastic-jensen",
        place="Assumption 1, replaced",
        claim="On S_dead, min E gamma^T >= gamma^(E_max[T]), T the time to fail.",
        check=check_time_bound,
        mutants={"discounted twice": DISCOUNTED_TWICE, "values not iterated": ZERO_VALUES},
        rests_on="stochastic; Jensen's inequality",
    ),
    Row(
        name="stochastic-one-step",
        place="Theorem 2, one step",
        claim="P(enter S_dead or S_fail | s, a) <= Q*(s, a) / gamma^H_E, Q* = E V(s'), V = min E "
        "gamma^T, H_E = max E_max[T] over S_dead.",
        check=check_one_step,
        mutants={"discounted twice": DISCOUNTED_TWICE, "values not iterated": ZERO_VALUES},
        rests_on="stochastic; dead: failure has probability 1 whatever is done",
    ),
    Row(
        name="stochastic-one-step-sure",
        place="Theorem 2, one step",
        claim="P(enter S_dead or S_fail | s, a) <= Q*(s, a) / gamma^H, H the longest path to fail "
        "from a state all of whose paths fail.",
        check=check_one_step_sure,
        mutants={"discounted twice": DISCOUNTED_TWICE, "values not iterated": ZERO_VALUES},
        rests_on="stochastic; dead: all paths fail; V = min E gamma^T",
        kernel=("OneStep",),
    ),
    Row(
        name="stochastic-zero-region",
        place="Theorem 2, exactness on Z = {P_min = 0}",
        claim="In Z, with 0 < eps <= eps_Z, an action is allowed exactly if all its successors "
        "lie in Z.",
        check=check_zero_region,
        mutants={
            "not strict": NOT_STRICT,
            "Q of one policy for Q*": BEST_IS_OF_FIRST_ACTIONS,
        },
        rests_on="stochastic, base convention; eps_Z: the least positive Q* in Z",
        kernel=("ZeroSet",),
    ),
    Row(
        name="stochastic-interval",
        place="Theorem 2, eps_safe in stochastic models",
        claim="The toolkit's interval for a stochastic model is (0, eps_Z].",
        check=check_interval,
        mutants={"upper end too large": INTERVAL_TOO_LARGE},
        rests_on="stochastic, base convention",
    ),
)

test_grid = grid_test(FALSE + TRUE)
test_drawn_models = sampled_test(TRUE, drawn_stochastic())
test_wrong_variants = teeth_test(FALSE + TRUE, stochastic_cases)
test_counterexamples = counterexample_test(FALSE, stochastic_cases)


def test_the_grid_is_complete() -> None:
    """As many models as multisets of distributions to the power of the states."""
    total = sum(case.count for case in stochastic_cases())
    assert total == sum(stochastic_count(*size) for size in STOCHASTIC_SIZES)


def test_known_models_in_which_recovery_chooses_certain_failure() -> None:
    """gamma = 0.99: {0.1 fail, 0.9 goal; 0.001 fail, 0.999 again}, with a goal."""
    P = np.full((3, 2, 3), ZERO, dtype=object)
    P[0, 0] = [0, Fraction(9, 10), Fraction(1, 10)]
    P[0, 1] = [Fraction(999, 1000), 0, Fraction(1, 1000)]
    model = SafeMDP.stochastic(P, np.arange(3) == 2, terminal=np.arange(3) == 1)
    _, Q = LIBRARY.best(model, Fraction(99, 100))
    assert LIBRARY.greedy(Q)[0].tolist() == [False, True]
    assert oracles.least_failure_probability(model)[0] == Fraction(1, 10)
    assert oracles.failure_probability(model, [1, 0, 0])[0] == 1
