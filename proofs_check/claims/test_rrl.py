"""The running text's claim that RRL too keeps the agent from dead-ends, and its repair."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from dead_ends.paper import leaves
from proofs_check.machinery.cases import (
    Case,
    Mask,
    drawn_deterministic,
    exhaustive_cases,
    small_cases,
)
from proofs_check.machinery.checks import (
    counterexample_test,
    exhaustive_test,
    large_test,
    sampled_test,
    teeth_test,
)
from proofs_check.machinery.counterexamples import minimal_sizes
from proofs_check.machinery.implementation import (
    EPSILON_TOO_LARGE,
    EVALUATION_IS_BEST,
    LIBRARY,
    MAX_RECOVERY,
    NOT_STRICT,
    Discount,
    Implementation,
)
from proofs_check.machinery.statement import Finding, Row, finding, run
from proofs_check.machinery.thresholds import allowed, boundary_thresholds, measured, of_task


def blocked_and_lost(
    implementation: Implementation, case: Case, epsilon: list[Discount]
) -> tuple[Mask, Mask]:
    """(S,) twice: the task's action is blocked in a safe state, and some / all minimisers leave.

    RRL: gate and recovery use the critic of the task policy.
    """
    _, Q = of_task(implementation, case)
    passes = allowed(implementation, case, Q, epsilon)
    greedy = implementation.greedy(Q)
    blocked = (case.support & ~passes).any(axis=1) & case.safe
    leaving = leaves(case.model, case.safe)
    some = blocked & (greedy & leaving).any(axis=1)
    return some, some & ~(greedy & ~leaving).any(axis=1)


def check_every_tie(implementation: Implementation, case: Case) -> Finding:
    """However ties are broken, RRL does not leave S_safe."""
    some, _ = blocked_and_lost(implementation, case, boundary_thresholds(implementation, case))
    return finding(case, some, case.boundary >= 0)


def check_some_tie(implementation: Implementation, case: Case) -> Finding:
    """With a good tie-breaking rule, RRL does not leave S_safe."""
    _, every = blocked_and_lost(implementation, case, boundary_thresholds(implementation, case))
    return finding(case, every, case.boundary >= 0)


def check_small_epsilon(implementation: Implementation, case: Case) -> Finding:
    """A threshold far below gamma^H_b does not help: the gate only blocks more."""
    edge = boundary_thresholds(implementation, case)
    _, every = blocked_and_lost(implementation, case, [e / 1024 for e in edge])
    return finding(case, every, case.boundary >= 0)


def check_repaired(implementation: Implementation, case: Case) -> Finding:
    """RRL is safe where every safe state keeps an allowed action, 0 < eps <= gamma^H_b."""
    _, Q = of_task(implementation, case)
    epsilon = boundary_thresholds(implementation, case)
    passes = allowed(implementation, case, Q, epsilon)
    kept = ~case.any_of(case.safe & ~passes.any(axis=1))
    leaving = leaves(case.model, case.safe)
    executed = passes | (implementation.greedy(Q) & ~passes.all(axis=1, keepdims=True))
    return finding(case, kept & case.any_of(executed & leaving), kept & (case.boundary >= 0))


def check_not_conservative(implementation: Implementation, case: Case) -> Finding:
    """V^pi_task < gamma^(H - 1) on S_safe: no safe state is taken for a dead-end."""
    V, _ = of_task(implementation, case)
    horizon = np.maximum(measured(implementation, case).horizon, 1)
    bound = np.array([implementation.threshold(case.gamma, int(h) - 1) for h in horizon])
    below = np.asarray(case.spread(bound) > V, dtype=np.bool_)
    return finding(case, case.safe & ~below, case.safe)


ROWS = (
    Row(
        name="rrl-every-tie",
        place="After Theorem 2: 'both RRL and DEA-RRL are able to prevent ...'",
        claim="RRL (critic and recovery from Q^pi_task) never leaves S_safe, however ties are "
        "broken.",
        check=check_every_tie,
        holds=False,
        mutants={"recovery and gate from Q*": EVALUATION_IS_BEST},
        rests_on="deterministic, base convention, 0 < eps <= gamma^H_b; pi_task: always a0",
        kernel=("RRL_refuted",),
        because="The task policy takes a0 everywhere. In a safe state its critic values the way "
        "into a dead-end exactly as high as the way that stays safe, since pi_task would fail "
        "just as soon from there. Both are blocked, and a tie decides about the dead-end.",
    ),
    Row(
        name="rrl-some-tie",
        place="After Theorem 2: 'both RRL and DEA-RRL are able to prevent ...'",
        claim="RRL never leaves S_safe, for some way to break ties.",
        check=check_some_tie,
        holds=False,
        mutants={"recovery and gate from Q*": EVALUATION_IS_BEST},
        rests_on="deterministic, base convention, 0 < eps <= gamma^H_b; pi_task: always a0",
        kernel=("RRL_refuted",),
        because="The task policy takes a0 everywhere. One safe state fails at once under it; its "
        "neighbour leads there or into a dead-end that lasts one step longer. RRL's critic "
        "prefers the dead-end, for every gamma and every eps, without any tie.",
    ),
    Row(
        name="rrl-small-epsilon",
        place="Online Training: 'we use a small eps_safe to improve the safety'",
        claim="A small enough eps keeps RRL in S_safe.",
        check=check_small_epsilon,
        holds=False,
        mutants={"recovery and gate from Q*": EVALUATION_IS_BEST},
        rests_on="deterministic, base convention, eps = gamma^H_b / 1024; pi_task: always a0",
        kernel=("RRL_refuted",),
        because="The recovery policy does the damage: the smaller eps, the more often it is "
        "called, and it prefers the dead-end that lasts longer to the safe state from which "
        "pi_task (a0) fails at once.",
    ),
    Row(
        name="rrl-repaired",
        place="After Theorem 2, repaired",
        claim="RRL never leaves S_safe if eps <= gamma^H_b and every safe state keeps an allowed "
        "action, whatever is proposed.",
        check=check_repaired,
        mutants={
            "epsilon one power too large": EPSILON_TOO_LARGE,
            "not strict": NOT_STRICT,
            "max for min": MAX_RECOVERY,
        },
        rests_on="deterministic, base convention",
        kernel=("RRL_repaired",),
    ),
    Row(
        name="rrl-not-conservative",
        place="After Theorem 2: 'it is not ensured that V_c^pi_task(s) < gamma^(H-1)'",
        claim="V^pi_task < gamma^(H-1) on S_safe: RRL takes no safe state for a dead-end. (The "
        "paper says that this is not ensured.)",
        check=check_not_conservative,
        holds=False,
        mutants={"Q* for Q^pi": EVALUATION_IS_BEST},
        rests_on="deterministic, V = discounted cost on entering fail; pi_task: always a0",
        because="The task policy a0 enters fail from a safe state: V^pi_task = 1 there, like "
        "one step before failing in a dead-end.",
    ),
)

test_all_small_models = exhaustive_test(ROWS)
test_six_states = large_test(ROWS)
test_drawn_models = sampled_test(ROWS, drawn_deterministic())
test_wrong_variants = teeth_test(ROWS)
test_counterexamples = counterexample_test(ROWS)


@pytest.mark.parametrize(
    ("name", "sizes"),
    [("rrl-every-tie", {(4, 2), (3, 3)}), ("rrl-some-tie", {(5, 2), (4, 3)})],
)
def test_smallest_sizes(name: str, sizes: set[tuple[int, int]]) -> None:
    """With ties n = 4, m = 2 or n = 3, m = 3; strictly n = 5, m = 2 or n = 4, m = 3."""
    row = next(row for row in ROWS if row.name == name)
    assert minimal_sizes(row, small_cases()) == sizes


@pytest.mark.parametrize("name", ["rrl-every-tie", "rrl-some-tie", "rrl-repaired"])
def test_classes_count_as_much_as_all_labelled_models(name: str) -> None:
    """The numbers of the report, once more without the reduction by symmetry."""
    row = next(row for row in ROWS if row.name == name)
    over = partial(run, row, LIBRARY)
    assert over(iter(exhaustive_cases())) == over(iter(small_cases()))
