"""The strategies: what they build is valid, and the interesting cases are met."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from proofs_check.machinery import oracles, strategies
from proofs_check.machinery.cases import (
    FOREVER,
    Case,
    drawn_deterministic,
    drawn_stochastic,
    longest_times,
)

EXAMPLES = settings(max_examples=300, derandomize=True, database=None, deadline=None)


def met(cases: st.SearchStrategy[Case], *, deterministic: bool) -> Counter[str]:
    """How many of 300 drawn cases show each feature."""
    seen: Counter[str] = Counter()

    @given(cases)
    @EXAMPLES
    def look(case: Case) -> None:
        model = case.model
        features = {
            "a dead state": case.dead.any(),
            "a safe state": case.safe.any(),
            "no safe state": not case.safe.any(),
            "H >= 3": case.horizon.max() >= 3,
            "a stochastic policy": case.task.ndim == 2 and (case.task[~case.fail] < 1).any(),
            "an action that is not available": not model.available[~case.fail].all(),
            "a goal": model.terminal.any(),
            "several fail states": case.fail.sum() > 1,
            "at risk": ((case.failing > 0) & (case.failing < 1)).any(),
            "dead without a horizon": (case.dead & (case.survival == FOREVER)).any(),
        }
        if deterministic:
            features |= {
                "H_b = 0": case.boundary.max() == 0,
                "H_b >= 2": case.boundary.max() >= 2,
                "H_b < H": 0 <= case.boundary.max() < case.horizon.max(),
                "no unsafe successor": case.safe.any() and case.boundary.max() < 0,
            }
        else:
            values = np.array(oracles.optimal_entry_cost(model, Fraction(9, 10)))
            Q = np.array(oracles.loss_target(model, list(values), Fraction(9, 10)))[~case.fail]
            gap = Q.max(axis=1) - Q.min(axis=1)
            features["almost a tie"] = ((gap > 0) & (gap < 1e-6)).any()
        seen.update(name for name, shown in features.items() if shown)

    look()
    return seen


def test_drawn_deterministic_cases_are_interesting() -> None:
    seen = met(drawn_deterministic(), deterministic=True)
    for feature in (
        "a dead state",
        "a safe state",
        "no safe state",
        "H >= 3",
        "a stochastic policy",
        "an action that is not available",
        "a goal",
        "several fail states",
        "H_b = 0",
        "H_b >= 2",
        "H_b < H",
        "no unsafe successor",
    ):
        assert seen[feature] >= 10, f"{feature}: met {seen[feature]} times in 300"


def test_drawn_stochastic_cases_are_interesting() -> None:
    seen = met(drawn_stochastic(), deterministic=False)
    for feature in (
        "a dead state",
        "a safe state",
        "no safe state",
        "at risk",
        "dead without a horizon",
        "a stochastic policy",
        "almost a tie",
    ):
        assert seen[feature] >= 10, f"{feature}: met {seen[feature]} times in 300"


@given(strategies.deterministic_models(max_states=5))
@EXAMPLES
def test_longest_times_agree_with_the_oracle(model) -> None:
    times = [None if t == FOREVER else t for t in longest_times(model)]
    assert times == oracles.survival_times(model)


@given(st.data())
@EXAMPLES
def test_policies_are_policies_of_the_model(data: st.DataObject) -> None:
    model = data.draw(strategies.deterministic_models() | strategies.stochastic_models())
    policy = data.draw(strategies.policies(model))
    acting = ~model.fail
    if policy.ndim == 1:
        assert model.available[np.flatnonzero(acting), policy[acting]].all()
    else:
        assert (policy.sum(axis=1) == 1).all()
        assert ((policy[acting] > 0) <= model.available[acting]).all()


@given(strategies.around(Fraction(2, 3)))
@EXAMPLES
def test_around_a_critical_value(epsilon: Fraction) -> None:
    assert abs(epsilon - Fraction(2, 3)) in (0, Fraction(2, 3) * strategies.TINY)


def test_long_corridors_are_drawn() -> None:
    """T = n - 1 for some model: the longest that there is."""
    longest = 0

    @given(strategies.deterministic_models(max_states=7))
    @EXAMPLES
    def look(model) -> None:
        nonlocal longest
        times = longest_times(model)
        longest = max(longest, int(times[times < FOREVER].max()))

    look()
    assert longest >= 5
