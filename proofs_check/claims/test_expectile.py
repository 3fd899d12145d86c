"""What the paper trains: an expectile critic. Its gate is sound, the rest of Q* is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import strategies as st

from dead_ends.io.npz import load_npz
from dead_ends.paper import leaves, unsafe_allowed, unsafe_minimisers
from proofs_check.machinery import oracles, strategies
from proofs_check.machinery.cases import (
    Case,
    class_case,
    deterministic_case,
    longest_times,
    small_cases,
)
from proofs_check.machinery.checks import counterexample_test, judge, sampled_test, teeth_test
from proofs_check.machinery.counterexamples import paths
from proofs_check.machinery.implementation import (
    EPSILON_TOO_LARGE,
    EXPECTILE_FROM_BEST,
    EXPECTILE_UPSIDE_DOWN,
    LIBRARY,
    NOT_STRICT,
    WORST_CRITIC,
    Implementation,
)
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import allowed, best, boundary_thresholds, of_task

TAUS = (Fraction(1, 10), Fraction(3, 10), Fraction(1, 2), Fraction(9, 10))
TAU = Fraction(3, 10)
"""The paper's."""


def check_fixed_point(implementation: Implementation, case: Case) -> Finding:
    """V(s) is the tau-expectile of Q(s, .) under the data, and Q is the target of V."""
    wrong = np.zeros(case.model.num_states, dtype=np.bool_)
    for tau in TAUS:
        V, Q = implementation.expectile(case.model, case.task, tau, case.gamma)
        target = np.where(case.fail, 1, case.gamma * V)[case.model.successors()]
        off = case.model.available & np.asarray(target != Q, dtype=np.bool_)
        for state in np.flatnonzero(~case.fail):
            fits = oracles.is_expectile(list(Q[state]), list(case.task[state]), tau, V[state])
            wrong[state] |= not fits or off[state].any()
    return finding(case, wrong)


def check_between(implementation: Implementation, case: Case) -> Finding:
    """Q* <= Q_tau, increasing in tau, equal to the data's own critic at 1/2."""
    _, star = best(implementation, case)
    _, own = of_task(implementation, case)
    tables = [implementation.expectile(case.model, case.task, tau, case.gamma)[1] for tau in TAUS]
    wrong = np.asarray(tables[TAUS.index(Fraction(1, 2))] != own, dtype=np.bool_)
    for lower, upper in pairwise([star, *tables]):
        wrong |= np.asarray(lower > upper, dtype=np.bool_)
    return finding(case, case.model.available & wrong)


def check_gate(implementation: Implementation, case: Case) -> Finding:
    """No unsafe action passes the gate on Q_tau, eps = gamma^H_b."""
    wrong = np.zeros(case.model.available.shape, dtype=np.bool_)
    epsilon = boundary_thresholds(implementation, case)
    for tau in TAUS:
        _, Q = implementation.expectile(case.model, case.task, tau, case.gamma)
        mask = allowed(implementation, case, Q, epsilon)
        wrong |= unsafe_allowed(case.model, case.safe, mask)
    return finding(case, wrong, case.boundary >= 0)


def check_exact(implementation: Implementation, case: Case) -> Finding:
    """The gate on Q_tau blocks no safe action, tau = 0.3, eps = gamma^H_b."""
    _, Q = implementation.expectile(case.model, case.task, TAU, case.gamma)
    mask = allowed(implementation, case, Q, boundary_thresholds(implementation, case))
    stays = case.safe[:, None] & case.model.available & ~leaves(case.model, case.safe)
    return finding(case, stays & ~mask, case.boundary >= 0)


def check_recovery(implementation: Implementation, case: Case) -> Finding:
    """Greedy recovery on Q_tau stays in S_safe, tau = 0.3."""
    _, Q = implementation.expectile(case.model, case.task, TAU, case.gamma)
    greedy = implementation.greedy(Q)
    return finding(case, unsafe_minimisers(case.model, case.safe, greedy), case.boundary >= 0)


def with_data(case: Case, gamma: float | Fraction, share: Fraction) -> Case:
    """The same models; the data take a0 with this share and a1 with the rest."""
    data = np.full((case.model.num_states, 2), share, dtype=object)
    data[:, 1] = 1 - share
    return replace(case, gamma=gamma, task=data)


@lru_cache(maxsize=1)
def uniform_data() -> Sequence[Case]:
    """Every class with n <= 3, m = 2; half of the data take a0, half a1."""
    return tuple(
        with_data(case, Fraction(1, 2), Fraction(1, 2))
        for case in small_cases()
        if case.model.num_actions == 2 and case.states <= 3
    )


@lru_cache(maxsize=1)
def skewed_data() -> Sequence[Case]:
    """Every class with n <= 5, m = 2; three quarters of the data on a0, gamma = 0.9 in floats."""
    return tuple(with_data(class_case(n, 2), 0.9, Fraction(3, 4)) for n in (2, 3, 4, 5))


@st.composite
def drawn_data(draw: st.DrawFn) -> Case:
    """A drawn deterministic model with a data policy."""
    model = draw(strategies.deterministic_models(max_states=5))
    data = draw(strategies.stochastic_policies(model))
    return deterministic_case(model, draw(strategies.discounts()), data, longest_times(model))


PLACE = "Offline Pretrain, Eqs. v_loss and q_loss"
SOUND = (
    Row(
        name="expectile-fixed-point",
        place=PLACE,
        claim="Q_tau is the fixed point: V(s) is the tau-expectile of Q(s, .) under the data, Q "
        "the target.",
        check=check_fixed_point,
        mutants={"1 - tau for tau": EXPECTILE_UPSIDE_DOWN, "Q* for Q_tau": EXPECTILE_FROM_BEST},
        rests_on="deterministic, base convention; tau in {0.1, 0.3, 0.5, 0.9}",
    ),
    Row(
        name="expectile-above",
        place=PLACE,
        claim="Q* <= Q_tau; Q_tau grows with tau and is the data policy's critic at tau = 1/2.",
        check=check_between,
        mutants={"1 - tau for tau": EXPECTILE_UPSIDE_DOWN, "max in the critic": WORST_CRITIC},
        rests_on="deterministic, base convention; tau in {0.1, 0.3, 0.5, 0.9}",
    ),
    Row(
        name="expectile-gate",
        place=PLACE,
        claim="The gate on Q_tau lets no unsafe action through for eps <= gamma^H_b.",
        check=check_gate,
        mutants={"epsilon one power too large": EPSILON_TOO_LARGE, "not strict": NOT_STRICT},
        rests_on="deterministic, base convention; tau in {0.1, 0.3, 0.5, 0.9}",
        kernel=("Expectile",),
    ),
)
LOST = (
    Row(
        name="expectile-exact",
        place=PLACE,
        claim="The gate on Q_tau blocks no safe action (tau = 0.3, eps = gamma^H_b).",
        check=check_exact,
        holds=False,
        mutants={"Q* for Q_tau": EXPECTILE_FROM_BEST},
        rests_on="deterministic, base convention; gamma = 0.9, three quarters of the data on a0",
        because="Three quarters of the data take a0, which fails from one safe state. V is a mean "
        "over the data's actions, weighted towards the better one, and not their minimum: it is "
        "so large in that safe state that the action which stays there is blocked.",
    ),
    Row(
        name="expectile-recovery",
        place=PLACE,
        claim="Greedy recovery on Q_tau stays in S_safe (tau = 0.3).",
        check=check_recovery,
        holds=False,
        mutants={"Q* for Q_tau": EXPECTILE_FROM_BEST},
        rests_on="deterministic, base convention; gamma = 0.9, three quarters of the data on a0",
        because="Three quarters of the data take a0, which fails from one safe state. Its V is "
        "then above that of a dead-end that lasts two steps, and the neighbour's greedy recovery "
        "prefers the dead-end to the safe state.",
    ),
)

test_drawn_models = sampled_test(SOUND, drawn_data())
test_wrong_variants = teeth_test(SOUND, uniform_data)
test_wrong_gate_and_recovery = teeth_test(LOST, skewed_data)
test_counterexamples = counterexample_test(LOST, skewed_data)


def test_uniform_data_on_every_model_with_three_states(record: Recorder) -> None:
    """Every model with n <= 3, m = 2, exactly."""
    for row in SOUND:
        total = run(row, LIBRARY, iter(uniform_data()))
        record(row, Means.EXHAUSTIVE, total)
        judge(row, total)


def test_skewed_data_on_every_model_with_five_states(record: Recorder) -> None:
    """Every model with n <= 5, m = 2, in floats."""
    for row in LOST:
        total = run(row, LIBRARY, iter(skewed_data()))
        record(row, Means.EXHAUSTIVE, total)
        judge(row, total)


@pytest.mark.parametrize("row", LOST, ids=[row.name for row in LOST])
def test_the_drawn_counterexamples_hold_exactly(row: Row) -> None:
    """The models that the search in floats found, once more in Fractions."""
    model = load_npz(paths(row)[0])
    task = np.zeros(model.num_states, dtype=np.int64)
    single = deterministic_case(model, Fraction(9, 10), task, longest_times(model))
    exact = with_data(single, Fraction(9, 10), Fraction(3, 4))
    assert row.check(LIBRARY, exact).violated.all()
