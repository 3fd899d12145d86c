"""The double integrator: inner <= true safe set <= outer, cell by cell, exactly.

All coordinates are multiples of powers of 1/2, so floating point makes no error here.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from dead_ends import classify
from dead_ends.envs.bracket import Bracket
from dead_ends.envs.double_integrator import double_integrator

Floats = NDArray[np.float64]
SIZES = [(20, 6, 1), (20, 6, 2), (20, 6, 4), (20, 6, 8), (2, 2, 8), (5, 7, 4), (33, 4, 3)]


def stopping(speed: Floats) -> Floats:
    """P(v): the way to the turning point at full braking, at the ends of steps."""
    steps = np.floor(speed + 0.5)
    return steps * speed - steps**2 / 2


def truly_safe(x: Floats, v: Floats, length: int, max_speed: int) -> NDArray[np.bool_]:
    inside = (x >= 0) & (x < length) & (v >= -max_speed) & (v < max_speed)
    stops = np.where(v >= 0, x + stopping(np.abs(v)) < length, x - stopping(np.abs(v)) >= 0)
    return np.asarray(inside & stops)


def safe_sets(pair: Bracket) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    cells = pair.grid.num_cells
    return classify(pair.inner).safe[:cells], classify(pair.outer).safe[:cells]


def step(x: Floats, v: Floats, control: Floats) -> tuple[Floats, Floats]:
    return x + v + control / 2, v + control


def reference_control(x: Floats, v: Floats, length: int) -> Floats:
    """Brake to |v| <= 1/2, then drift towards the middle of the corridor and back."""
    idle = np.where(x >= length / 2, np.where(v > 0, -1, 0), np.where(v < 0, 1, 0))
    return np.where(v > 0.5, -1, np.where(v < -0.5, 1, idle)).astype(float)


@pytest.mark.parametrize(("length", "max_speed"), [(20, 6), (2, 2), (3, 2), (5, 7)])
def test_the_analytic_answer_is_right(length: int, max_speed: int) -> None:
    """Safe points survive under a policy; unsafe ones fail under the hardest braking."""
    x, v = np.meshgrid(np.arange(0, length, 1 / 16), np.arange(-max_speed, max_speed, 1 / 16))
    x, v = x.ravel(), v.ravel()
    safe = truly_safe(x, v, length, max_speed)
    assert safe.any()
    assert not safe.all()
    far, fast = x[safe], v[safe]
    for _ in range(200):
        far, fast = step(far, fast, reference_control(far, fast, length))
        assert ((far >= 0) & (far < length) & (np.abs(fast) <= max_speed)).all()
    position, speed = x[~safe], v[~safe]
    direction = -np.sign(speed)
    failed = np.zeros(len(position), dtype=bool)
    for _ in range(max_speed + 1):
        position, speed = step(position, speed, direction)
        failed |= (position < 0) | (position >= length)
    assert failed.all()


@pytest.mark.parametrize(("length", "max_speed", "resolution"), SIZES)
def test_the_bracket_holds_for_every_cell(length: int, max_speed: int, resolution: int) -> None:
    """An inner cell has safe points only, a cell outside the outer set has none.

    A cell is half-open; x + P(v) grows in both coordinates, so that its corners decide.
    """
    pair = double_integrator(length, max_speed, resolution)
    inner, outer = safe_sets(pair)
    position, row = pair.grid.indices().T
    scale = 4 * resolution**2  # positions and P in multiples of 1 / (2 k)^2, integers
    k = resolution
    low_v, high_v = row - max_speed * k, row - max_speed * k + 1

    def reach(v: NDArray[np.int64]) -> NDArray[np.int64]:
        """scale * P(v / k) for v >= 0."""
        steps = (2 * v + k) // (2 * k)
        return 4 * k * steps * v - 2 * k**2 * steps**2

    wall = length * scale
    rightward = low_v >= 0
    cell_low, cell_high = position * 4 * k, (position + 1) * 4 * k
    all_safe = np.where(
        rightward,
        cell_high + reach(np.abs(high_v)) <= wall,
        cell_low - reach(np.abs(low_v)) >= 0,
    )
    none_safe = np.where(
        rightward,
        cell_low + reach(np.abs(low_v)) >= wall,
        cell_high - reach(np.abs(high_v)) <= 0,
    )
    assert not (inner & ~all_safe).any()
    assert not (~outer & ~none_safe).any()
    assert not (inner & ~outer).any()
    assert 0 < outer.sum() < len(outer)


def test_the_gap_shrinks_with_the_resolution() -> None:
    gaps = []
    for resolution in (1, 2, 4, 8, 16):
        inner, outer = safe_sets(double_integrator(20, 6, resolution))
        gaps.append((outer & ~inner).mean())
    assert all(finer < 0.6 * coarser for coarser, finer in pairwise(gaps))
    assert inner.any()


@pytest.mark.parametrize("resolution", [1, 2, 3, 4])
def test_successors_are_exactly_the_cells_reached(resolution: int) -> None:
    """Compared with the images of many points, on a lattice finer than the cells.

    Offsets (1/8 to 7/8 of a cell and their ends) reach every cell that can be reached.
    """
    pair = double_integrator(4, 2, resolution)
    grid = pair.grid
    kernel = pair.inner.transitions().toarray().reshape(-1, 3, grid.num_cells + 1)
    offsets = np.stack(np.meshgrid(*2 * [np.arange(0, 1, 1 / 8)]), axis=-1).reshape(-1, 2)
    for cell, index in enumerate(grid.indices()):
        # positions and speeds in multiples of 1 / (8 k): exact integers
        fine = (8 * (index - np.array([0, 2 * resolution])) + 8 * offsets).astype(int)
        for action, control in enumerate((-1, 0, 1)):
            x = fine[:, 0] + fine[:, 1] + 4 * resolution * control
            v = fine[:, 1] + 8 * resolution * control
            column, row = x // 8, v // 8 + 2 * resolution
            inside = (column >= 0) & (column < 4 * resolution) & (row >= 0) & (row < 4 * resolution)
            reached = np.unique(np.where(inside, column * grid.shape[1] + row, grid.num_cells))
            np.testing.assert_array_equal(np.flatnonzero(kernel[cell, action]), reached)


def test_geometry_and_grid_are_in_physical_units() -> None:
    pair = double_integrator(6, 3, 2, acceleration=2.0, time_step=0.5)
    np.testing.assert_array_equal(pair.grid.corners()[0], [0, -3])
    np.testing.assert_array_equal(pair.grid.width, [0.25, 0.5])
    geometry = pair.inner.geometry
    assert geometry is not None
    drawn = np.array(geometry.origin) + geometry.cell[:-1] * np.array(geometry.step)
    np.testing.assert_array_equal(drawn, pair.grid.centres())
    np.testing.assert_array_equal(geometry.cell[-1], [-1, -1])  # "outside" is not drawn


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1, 6, 4), r"length must be at least 2, not 1"),
        ((20, 1, 4), r"max_speed must be at least 2, not 1"),
        ((20, 6, 0), r"resolution must be at least 1, not 0"),
    ],
)
def test_bad_sizes_are_refused(arguments: tuple[int, int, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        double_integrator(*arguments)


@pytest.mark.parametrize("unit", ["acceleration", "time_step"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_units_are_positive(unit: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{unit} must be positive and finite, not {value}"):
        double_integrator(**{unit: value})
