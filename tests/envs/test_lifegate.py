"""LifeGate against published and closed-form values, with an independent solver."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from dead_ends import SafeMDP, classify, value_iteration
from dead_ends.envs.lifegate import ACTIONS, START, lifegate


def cells(model: SafeMDP) -> list[tuple[int, int]]:
    """(x, y) of each state."""
    assert model.geometry is not None
    return [(int(x), int(y)) for x, y in model.geometry.cell]


def reach_by_linear_program(
    model: SafeMDP, target: NDArray[np.bool_], avoid: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The greatest probability of reaching ``target``: the least v >= P v, P(s, target) added.

    ``avoid`` states are absorbing and worth 0.
    """
    going = ~(target | avoid)
    kernel = model.transitions().toarray()
    here = np.repeat(np.eye(model.num_states), model.num_actions, axis=0)
    rows = np.repeat(going, model.num_actions)
    result = linprog(
        np.ones(model.num_states),
        A_ub=(kernel - here)[rows],
        b_ub=-(kernel @ target)[rows],
        bounds=[(0.0, float(limit)) for limit in going],
    )
    assert result.x is not None
    return result.x


def test_counts() -> None:
    model = lifegate()
    assert model.num_states == 91
    assert model.fail.sum() == 11
    assert model.terminal.sum() == 3
    assert model.action_names == ACTIONS
    labelling = classify(model)
    assert {cell for cell, dead in zip(cells(model), labelling.dead, strict=True) if dead} == {
        (x, y) for x in range(5, 9) for y in range(5, 10)
    }
    assert labelling.dead.sum() == 20
    assert labelling.horizon is None  # a dead agent may stay for any number of steps


@pytest.mark.parametrize(
    ("death_drag", "death", "discounted_death", "recovery"),
    [
        (0.0, 0.0, 0.0, 1.0),
        (0.2, 0.017547, 0.015780, 0.980575),
        (0.25, 0.043640, 0.038706, 0.951693),
        (0.4, 0.334663, 0.282762, 0.636687),
    ],
)
def test_values_at_the_start(
    death_drag: float, death: float, discounted_death: float, recovery: float
) -> None:
    """The least probability of death, the same discounted, the greatest of recovery."""
    model = lifegate(death_drag)
    start = cells(model).index(START)
    assert model.initial is not None
    assert model.initial[start] == 1
    for gamma_safe, expected in ((1.0, death), (0.99, discounted_death)):
        values = value_iteration(model, gamma_safe, tolerance=1e-10)
        assert values.V[start] == pytest.approx(expected, abs=5e-7)
    reached = reach_by_linear_program(model, model.terminal, model.fail)
    assert reached[start] == pytest.approx(recovery, abs=5e-7)


@pytest.mark.parametrize(("death_drag", "push"), [(0.4, 0.7), (0.0, 0.3), (0.2, 1.0)])
def test_dead_end_columns_have_the_closed_form(death_drag: float, push: float) -> None:
    """V_c* = (push g / (1 - (1 - push) g))^(9 - x) / g."""
    model = lifegate(death_drag, push)
    V = value_iteration(model, 0.99, tolerance=1e-12).V
    for (x, _), value, dead in zip(cells(model), V, classify(model).dead, strict=True):
        if dead:
            column = push * 0.99 / (1 - (1 - push) * 0.99)
            assert value == pytest.approx(column ** (9 - x) / 0.99, abs=1e-10)


def test_published_values_of_the_dead_end_columns() -> None:
    model = lifegate()
    V = value_iteration(model, 0.99, tolerance=1e-12).V
    found = [round(V[cells(model).index((x, 7))], 4) for x in range(5, 9)]
    assert found == [0.9538, 0.9676, 0.9816, 0.9957]


def test_certain_push_without_drag_is_deterministic() -> None:
    model = lifegate(death_drag=0, push=1)
    assert model.is_deterministic
    labelling = classify(model)
    assert labelling.horizon == 4
    for (x, _), time, dead in zip(
        cells(model), labelling.survival_time, labelling.dead, strict=True
    ):
        if dead:
            assert time == 9 - x


def rows(model: SafeMDP, cell: tuple[int, int]) -> list[dict[tuple[int, int], Fraction]]:
    kernel, exact = model.transitions(), model.exact_probabilities()
    where = cells(model)
    first = where.index(cell) * 5
    return [
        {
            where[kernel.indices[entry]]: exact[entry]
            for entry in range(kernel.indptr[row], kernel.indptr[row + 1])
        }
        for row in range(first, first + 5)
    ]


def test_drag_replaces_the_action() -> None:
    rest, drag = Fraction(6, 10), Fraction(4, 10)
    no_op, up, down, left, right = rows(lifegate(), (2, 8))
    assert no_op == {(2, 8): rest, (3, 8): drag}
    assert up == {(2, 7): rest, (3, 8): drag}
    assert down == {(2, 9): rest, (3, 8): drag}
    assert left == {(1, 8): rest, (3, 8): drag}
    assert right == {(3, 8): Fraction(1)}


def test_barriers_and_the_border_block() -> None:
    model = lifegate(death_drag=0.4)
    rest, drag = Fraction(6, 10), Fraction(4, 10)
    assert rows(model, (0, 5))[4] == {(0, 5): Fraction(1)}  # a barrier to the right
    assert rows(model, (0, 9))[2] == {(0, 9): rest, (1, 9): drag}  # the border below


def test_dead_ends_ignore_the_action() -> None:
    for row in rows(lifegate(), (6, 6)):
        assert row == {(6, 6): Fraction(3, 10), (7, 6): Fraction(7, 10)}


def test_expected_rewards() -> None:
    model = lifegate(death_drag=0.4)
    assert model.rewards is not None
    where = cells(model)
    np.testing.assert_allclose(
        model.rewards[where.index((8, 1))], [-0.4, -1.0, -0.4, -0.4, -1.0], rtol=1e-15
    )
    np.testing.assert_allclose(model.rewards[where.index((5, 1))], [0, 0.6, 0, 0, 0], rtol=1e-15)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: lifegate(death_drag=1.2), r"death_drag must lie in 0 to 1, not 1\.2"),
        (lambda: lifegate(push=-1), r"push must lie in 0 to 1, not -1"),
    ],
)
def test_bad_parameters_are_refused(build: Callable[[], SafeMDP], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
