"""Gridworlds: moves, ice, currents and slips by hand; every error of the map's reader."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dead_ends import SafeMDP, classify
from dead_ends.envs.gridworld import ACTIONS, DEFAULT_MAP, gridworld

LEFT, DOWN, RIGHT, UP = range(4)


def at(model: SafeMDP, row: int, column: int) -> int:
    """The state in a cell."""
    assert model.state_names is not None
    return model.state_names.index(f"row {row}, column {column}")


def successor(model: SafeMDP, cell: tuple[int, int], action: int) -> tuple[int, int]:
    """Row and column after a move in a deterministic map."""
    assert model.geometry is not None
    column, row = model.geometry.cell[model.successors()[at(model, *cell), action]]
    return int(row), int(column)


def row_of(model: SafeMDP, cell: tuple[int, int], action: int) -> dict[tuple[int, int], Fraction]:
    """P(. | cell, action) with exact probabilities, by cell."""
    kernel, exact = model.transitions(), model.exact_probabilities()
    assert model.geometry is not None
    row = at(model, *cell) * 4 + action
    entries = range(kernel.indptr[row], kernel.indptr[row + 1])
    cells = [model.geometry.cell[kernel.indices[entry]] for entry in entries]
    return {
        (int(cell_row), int(column)): exact[entry]
        for (column, cell_row), entry in zip(cells, entries, strict=True)
    }


def test_floor_moves_one_cell_and_walls_stop() -> None:
    model = gridworld(["S.", "#."])
    assert model.num_states == 3
    assert model.action_names == ACTIONS
    assert successor(model, (0, 0), RIGHT) == (0, 1)
    assert successor(model, (0, 1), DOWN) == (1, 1)
    assert successor(model, (0, 0), DOWN) == (0, 0)
    assert successor(model, (0, 0), UP) == (0, 0)
    assert successor(model, (1, 1), LEFT) == (1, 1)


def test_ice_slides_to_the_first_cell_beyond_or_to_a_wall() -> None:
    model = gridworld(["S~~.", "L~~#"])
    assert successor(model, (0, 0), RIGHT) == (0, 3)
    assert successor(model, (0, 3), LEFT) == (0, 0)
    assert successor(model, (0, 1), DOWN) == (1, 1)  # the wall below stops it on the ice
    assert successor(model, (1, 1), RIGHT) == (1, 2)
    assert successor(model, (1, 2), LEFT) == (1, 0)  # into the lava


def test_ice_is_dead_only_if_every_slide_is() -> None:
    model = gridworld(["#L#", "S~L", "#L#"])
    assert classify(model).safe[at(model, 1, 1)]  # sliding back to the start is a way out
    model = gridworld(["##L##", "#L~L#", "#L^L#", "##S##"])
    survival_time = classify(model).survival_time
    assert survival_time[at(model, 2, 2)] == 1  # carried over the ice into the lava
    assert survival_time[at(model, 1, 2)] == 2  # back onto the current first
    assert classify(model).safe[at(model, 3, 2)]


def test_currents_carry_whatever_the_action() -> None:
    model = gridworld(["S>v", "L<<"])
    for action in range(4):
        assert successor(model, (0, 1), action) == (0, 2)
        assert successor(model, (0, 2), action) == (1, 2)
        assert successor(model, (1, 1), action) == (1, 0)


def test_a_current_against_a_wall_is_a_trap_without_harm() -> None:
    model = gridworld(["S>#"])
    assert successor(model, (0, 1), LEFT) == (0, 1)
    assert classify(model).safe.all()


def test_a_current_carries_onto_ice() -> None:
    assert successor(gridworld(["S>~~."]), (0, 1), UP) == (0, 4)


@given(length=st.integers(1, 30))
def test_a_current_into_lava_is_a_chain_of_dead_ends(length: int) -> None:
    """Closed form: T counts the cells to the lava; H = H_b = the current's length."""
    model = gridworld(["S" + ">" * length + "L"])
    labelling = classify(model)
    np.testing.assert_array_equal(labelling.dead, [False, *[True] * length, False])
    np.testing.assert_array_equal(labelling.survival_time[1:], np.arange(length, -1, -1))
    assert labelling.horizon == labelling.boundary_horizon == length
    assert labelling.reachable_boundary_horizon == length


def test_lava_without_ice_or_currents_makes_no_dead_ends() -> None:
    model = gridworld(["S..L", ".LL.", "L..G"])
    labelling = classify(model)
    assert not labelling.dead.any()
    assert labelling.horizon == 0
    assert labelling.boundary_horizon == 0


def test_floor_enclosed_by_lava_is_dead() -> None:
    model = gridworld([".L.", "LSL", ".L."])
    labelling = classify(model)
    np.testing.assert_array_equal(np.flatnonzero(labelling.dead), [at(model, 1, 1)])
    assert labelling.horizon == 1
    assert labelling.safe[at(model, 0, 0)]  # into the border for ever


def test_goal_is_terminal_and_rewarded_lava_is_a_failure() -> None:
    model = gridworld(["SG", "L."])
    np.testing.assert_array_equal(model.terminal, [False, True, False, False])
    np.testing.assert_array_equal(model.fail, [False, False, True, False])
    assert model.rewards is not None
    np.testing.assert_array_equal(model.rewards, [[0, 0, 1, 0], [0] * 4, [0] * 4, [0, 0, 0, 1]])


def test_several_starts_are_drawn_uniformly() -> None:
    np.testing.assert_array_equal(gridworld(["S.S", "S.S"]).initial, [0.25, 0, 0.25] * 2)


def test_slip_goes_sideways() -> None:
    model = gridworld(["...", ".S.", "..."], slip=0.2)
    nine_tenths, tenth = Fraction(8, 10), Fraction(1, 10)
    assert row_of(model, (1, 1), RIGHT) == {
        (1, 2): nine_tenths,
        (0, 1): tenth,
        (2, 1): tenth,
    }
    assert row_of(model, (0, 0), UP) == {(0, 0): Fraction(9, 10), (0, 1): tenth}


def test_slip_slides_over_ice_but_currents_do_not_slip() -> None:
    model = gridworld([".~S>.", "...~.", "....."], slip=0.5)
    assert row_of(model, (0, 2), UP) == {
        (0, 2): Fraction(1, 2),
        (0, 0): Fraction(1, 4),
        (0, 3): Fraction(1, 4),
    }
    assert row_of(model, (0, 3), DOWN) == {(0, 4): Fraction(1)}


def test_a_fraction_keeps_the_model_exact() -> None:
    model = gridworld(["..", "S.", ".."], slip=Fraction(2, 3))
    assert model.exact is not None
    assert row_of(model, (1, 0), RIGHT) == {
        cell: Fraction(1, 3) for cell in ((0, 0), (1, 1), (2, 0))
    }
    assert gridworld(["..", "S."], slip=0.2).exact is None


def test_slip_one_never_goes_ahead() -> None:
    model = gridworld(["...", ".S.", "..."], slip=1)
    assert row_of(model, (1, 1), RIGHT) == {(0, 1): Fraction(1, 2), (2, 1): Fraction(1, 2)}


def test_the_default_map_has_dead_ends_that_matter() -> None:
    model = gridworld()
    labelling = classify(model)
    assert model.is_deterministic
    assert int(labelling.dead.sum()) == 33
    assert labelling.horizon == 12
    assert labelling.reachable_boundary_horizon == 12
    assert model.initial is not None
    assert labelling.safe[model.initial > 0].all()
    assert model.terminal.sum() == 1


def test_slip_puts_the_default_maps_states_at_risk() -> None:
    labelling = classify(gridworld(slip=0.1))
    assert labelling.at_risk.any()
    np.testing.assert_array_equal(labelling.dead, classify(gridworld()).dead)


def test_geometry_covers_the_map_with_row_zero_at_the_top() -> None:
    lines = DEFAULT_MAP.strip().splitlines()
    geometry = gridworld().geometry
    assert geometry is not None
    assert geometry.y_down
    cells = {(int(column), int(row)) for column, row in geometry.cell}
    assert cells.isdisjoint(geometry.walls)
    assert cells | set(geometry.walls) == {
        (column, row) for row in range(len(lines)) for column in range(len(lines[0]))
    }
    assert all(lines[row][column] == "#" for column, row in geometry.walls)
    assert geometry.arrows == ((-1, 0), (0, -1), (1, 0), (0, 1))


def test_a_text_may_be_indented() -> None:
    text = """
        S.L
        ..G
    """
    assert gridworld(text).num_states == 6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"the map is empty"),
        ([], r"the map is empty"),
        (["S..", ".x."], r"row 1, column 1 of the map: unknown cell 'x'; known are \. # S"),
        (["S..", ".."], r"row 1 of the map has 2 cells, but row 0 has 3"),
        (["...", ".LG"], r"the map has no start S"),
    ],
)
def test_bad_maps_are_refused(text: str | list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gridworld(text)


@pytest.mark.parametrize("slip", [-0.1, 1.5, float("nan"), Fraction(3, 2)])
def test_bad_slips_are_refused(slip: float | Fraction) -> None:
    with pytest.raises(ValueError, match=r"slip must lie in 0 to 1, not"):
        gridworld(slip=slip)
