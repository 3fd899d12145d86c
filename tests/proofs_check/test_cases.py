"""Cases: models side by side are what they are alone, and what is known of them is right."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from dead_ends import SafeMDP
from proofs_check.machinery import cases, oracles
from proofs_check.machinery.enumerate_models import batches

F = Fraction


def test_a_batch_and_its_models_agree() -> None:
    case = cases.table_case(next(batches(3, 2)))
    assert case.count == 81
    for index in (0, 5, 40, 80):
        single = case.take(index)
        assert single.count == 1
        assert single.horizon[0] == case.horizon[index]
        assert single.boundary[0] == case.boundary[index]
        horizon, boundary = oracles.horizons(single.model)
        assert single.horizon[0] == horizon
        assert single.boundary[0] == (-1 if boundary is None else boundary)
        assert case.any_of(case.safe)[index] == single.safe.any()


def test_stochastic_models_side_by_side_and_alone() -> None:
    models = list(cases.stochastic_models(3, 2, 2, 0))[100:103]
    task = np.zeros(3, dtype=np.int64)
    singles = [cases.stochastic_case(model, F(1, 2), task) for model in models]
    case = cases.together(singles)
    assert case.count == 3
    for index, single in enumerate(singles):
        alone = case.take(index)
        assert (cases.exact_table(alone.model) == cases.exact_table(single.model)).all()
        assert alone.failing.tolist() == single.failing.tolist()
        assert alone.failing.tolist() == oracles.least_failure_probability(alone.model)


@pytest.mark.parametrize("size", [(2, 1, 4, 0), (2, 2, 4, 0), (3, 1, 4, 0), (3, 2, 4, 1)])
def test_stochastic_counts(size: tuple[int, int, int, int]) -> None:
    models = list(cases.stochastic_models(*size))
    assert len(models) == cases.stochastic_count(*size)
    tables = {tuple(cases.exact_table(model).ravel().tolist()) for model in models}
    assert len(tables) == len(models)


def test_goals_of_the_grid_are_terminal() -> None:
    model = next(cases.stochastic_models(3, 2, 4, 1))
    assert model.terminal.tolist() == [False, True, False]
    assert model.fail.tolist() == [False, False, True]


def test_sets_of_a_case() -> None:
    """0: {1/2 fail, 1/2 goal} at risk; 1 dead without a horizon; 2 dead, T = 1; 3 goal; 4 fail."""
    P = np.full((5, 1, 5), F(0), dtype=object)
    P[0, 0, 3] = P[0, 0, 4] = P[1, 0, 1] = P[1, 0, 4] = F(1, 2)
    P[2, 0, 4] = F(1)
    model = SafeMDP.stochastic(P, np.arange(5) == 4, terminal=np.arange(5) == 3)
    case = cases.stochastic_case(model, F(1, 2), np.zeros(5, dtype=np.int64))
    assert case.safe.tolist() == [True, False, False, True, False]
    assert case.dead.tolist() == [False, True, True, False, False]
    assert case.sure.tolist() == [False, False, True, False, False]
    assert case.horizon.tolist() == [1]


def test_support_of_policies() -> None:
    model = SafeMDP.deterministic(np.array([[0, 1], [1, -1], [0, 0]]), np.arange(3) == 2)
    assert cases.support(model, np.array([1, 0, 0])).tolist() == [
        [False, True],
        [True, False],
        [False, False],
    ]
    mixed = np.array([[F(1, 2), F(1, 2)], [F(1), F(0)], [F(1), F(0)]], dtype=object)
    assert cases.support(model, mixed)[0].all()
