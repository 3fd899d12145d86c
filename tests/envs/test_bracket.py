"""The grid, and how successors become the two enclosing models."""

import numpy as np

from dead_ends import classify
from dead_ends.envs.bracket import Grid, bracket
from dead_ends.model.safe_mdp import Geometry

GRID = Grid(lower=(-1.0, 10.0), width=(0.5, 2.0), shape=(4, 3))


def test_cells_are_numbered_with_the_last_coordinate_fastest() -> None:
    assert GRID.num_cells == 12
    np.testing.assert_array_equal(GRID.indices()[[0, 1, 3]], [[0, 0], [0, 1], [1, 0]])
    np.testing.assert_array_equal(GRID.corners()[[0, 1, 3]], [[-1, 10], [-1, 12], [-0.5, 10]])
    np.testing.assert_array_equal(GRID.centres()[4], [-0.25, 13])


def test_points_find_their_cells() -> None:
    np.testing.assert_array_equal(GRID.cell_of(GRID.centres()), np.arange(12))
    np.testing.assert_array_equal(GRID.cell_of(GRID.corners()), np.arange(12))
    points = np.array([[-1.01, 11], [0, 16], [1, 11], [0, 9.9]])
    np.testing.assert_array_equal(GRID.cell_of(points), 12)


CELL = np.array([[0, 0], [1, 0], [2, 0], [-1, -1]], dtype=np.int32)
CHAIN = np.array(
    [
        [[0, -1], [1, -1]],  # cell 0 may stay for certain
        [[0, 1], [1, 3]],  # from cell 1, "a" leads to 0 or 1, "b" perhaps outside
        [[2, 3], [3, -1]],  # cell 2 stays, if it is lucky
    ],
    dtype=np.int32,
)
LINE = Grid((0.0,), (1.0,), (3,))


def test_inner_takes_chance_and_outer_takes_choice() -> None:
    pair = bracket(LINE, CHAIN, ("a", "b"), Geometry(CELL))
    np.testing.assert_array_equal(classify(pair.inner).safe, [True, True, False, False])
    np.testing.assert_array_equal(classify(pair.outer).safe, [True, True, True, False])
    assert pair.inner.action_names == ("a", "b")
    assert pair.outer.action_names is not None
    assert pair.outer.action_names[2] == "b, outcome 0"
    np.testing.assert_array_equal(pair.outer.successors()[2], [2, 3, 3, -1])
    kernel = pair.inner.transitions().toarray()
    np.testing.assert_array_equal(kernel[3], [0, 0.5, 0, 0.5])
    np.testing.assert_array_equal(kernel[5], [0, 0, 0, 1])


def test_cells_that_touch_a_violation_fail_inside_and_wholly_bad_ones_outside() -> None:
    touches = np.array([True, True, False])
    inside = np.array([True, False, False])
    pair = bracket(
        LINE, CHAIN, ("a", "b"), Geometry(CELL), touches_fail=touches, inside_fail=inside
    )
    np.testing.assert_array_equal(pair.inner.fail, [True, True, False, True])
    np.testing.assert_array_equal(pair.outer.fail, [True, False, False, True])
    np.testing.assert_array_equal(classify(pair.outer).safe, [False, True, True, False])
