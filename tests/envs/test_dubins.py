"""The Dubins car against simulation of the continuous dynamics (an arc's exact formula)."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from dead_ends import classify, safe_actions
from dead_ends.envs.bracket import Bracket
from dead_ends.envs.dubins import dubins

Floats = NDArray[np.float64]
LENGTH, HEADINGS, TURN, RADIUS = 8, 32, 5, 1.0
TURN_ANGLE = 2 * np.pi * TURN / HEADINGS


@pytest.fixture(scope="module")
def pair() -> Bracket:
    return dubins(LENGTH, 4, HEADINGS, TURN, RADIUS)


def drive(points: Floats, control: NDArray[np.int64], turn_angle: float = TURN_ANGLE) -> Floats:
    """(x, y, heading) after one step: an arc of length 1 that turns by u delta."""
    x, y, heading = points.T
    curvature = control * turn_angle
    after = heading + curvature
    radius = 1 / np.where(control == 0, 1, curvature)
    moved_x = np.where(control == 0, np.cos(heading), radius * (np.sin(after) - np.sin(heading)))
    moved_y = np.where(control == 0, np.sin(heading), radius * (np.cos(heading) - np.cos(after)))
    return np.stack((x + moved_x, y + moved_y, after % (2 * np.pi)), axis=1)


def violated(points: Floats) -> NDArray[np.bool_]:
    place = points[:, :2]
    outside = ((place < 0) | (place > LENGTH)).any(axis=1)
    return np.asarray(outside | (np.linalg.norm(place - LENGTH / 2, axis=1) < RADIUS))


def sample(pair: Bracket, cells: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """A uniformly random point of each cell."""
    offsets: Floats = rng.random((len(cells), 3)) * np.array(pair.grid.width)
    return pair.grid.corners()[cells] + offsets


@pytest.mark.parametrize(
    ("length", "resolution", "headings", "turn"),
    [(8, 4, 32, 5), (3, 16, 4, 1), (3, 16, 6, 2), (3, 12, 10, 1)],
)
def test_successors_contain_the_image_of_every_sampled_point(
    length: int, resolution: int, headings: int, turn: int
) -> None:
    """Coarse headings too, whose arcs reach their extremes in the middle of a cell."""
    pair = dubins(length, resolution, headings, turn, 0)
    rng = np.random.default_rng(0)
    cells = np.repeat(np.arange(pair.grid.num_cells), 3)
    kernel = pair.inner.transitions()
    for action, control in enumerate((-1, 0, 1)):
        controls = np.full(len(cells), control)
        points = drive(sample(pair, cells, rng), controls, 2 * np.pi * turn / headings)
        probability = kernel[cells * 3 + action, pair.grid.cell_of(points)]
        assert (np.asarray(probability).ravel() > 0).all()


def test_inner_lies_within_outer(pair: Bracket) -> None:
    inner, outer = classify(pair.inner).safe, classify(pair.outer).safe
    assert not (inner & ~outer).any()
    assert inner.mean() > 0.5
    assert outer.mean() < 0.95


def test_inner_cells_are_safe_in_the_continuous_system(pair: Bracket) -> None:
    """Random allowed controls keep 4000 sampled runs of 100 steps inside the inner set."""
    rng = np.random.default_rng(1)
    inner = classify(pair.inner).safe
    allowed = safe_actions(pair.inner)
    cells = rng.choice(np.flatnonzero(inner), 4000)
    points = sample(pair, cells, rng)
    for _ in range(100):
        # the allowed control with the greatest of three random numbers
        choice = np.where(allowed[cells], rng.random((len(cells), 3)), -1).argmax(axis=1)
        points = drive(points, choice - 1)
        cells = pair.grid.cell_of(points)
        assert not violated(points).any()
        assert inner[cells].all()


def test_cells_outside_the_outer_set_are_lost(pair: Bracket) -> None:
    """All control sequences from sampled points fail, within the outer survival time."""
    rng = np.random.default_rng(2)
    labelling = classify(pair.outer)
    assert labelling.horizon is not None
    dead = rng.choice(np.flatnonzero(labelling.dead), 4000)
    start = sample(pair, dead, rng)
    for controls in product((-1, 0, 1), repeat=labelling.horizon):
        points, failed = start, violated(start)
        for time, control in enumerate(controls, start=1):
            points = drive(points, np.full(len(points), control))
            failed |= violated(points)
            assert failed[labelling.survival_time[dead] <= time].all()
        assert failed.all()


def test_the_gap_shrinks_with_the_resolution() -> None:
    gaps = []
    for resolution in (2, 4, 6):
        pair = dubins(LENGTH, resolution, 8 * resolution, resolution, 0)
        inner, outer = classify(pair.inner).safe, classify(pair.outer).safe
        gaps.append((outer & ~inner).mean())
    assert gaps[1] < 0.6 * gaps[0]
    assert gaps[2] < 0.8 * gaps[1]


def test_pillar_cells(pair: Bracket) -> None:
    """inner: cells with a point in the disc fail; outer: cells with all corners in it."""
    low = pair.grid.corners()[:, :2] - LENGTH / 2
    high = low + pair.grid.width[0]
    nearest = np.linalg.norm(np.clip(0, low, high), axis=1)
    farthest = np.linalg.norm(np.maximum(np.abs(low), np.abs(high)), axis=1)
    np.testing.assert_array_equal(pair.inner.fail[:-1], nearest < RADIUS + 1e-9)
    np.testing.assert_array_equal(pair.outer.fail[:-1], farthest < RADIUS - 1e-9)
    assert pair.outer.fail[:-1].any()


def test_without_a_pillar_only_outside_fails() -> None:
    pair = dubins(4, 2, 8, 1, 0)
    np.testing.assert_array_equal(np.flatnonzero(pair.inner.fail), [pair.grid.num_cells])
    np.testing.assert_array_equal(np.flatnonzero(pair.outer.fail), [pair.grid.num_cells])


def test_geometry_shows_one_heading() -> None:
    pair = dubins(4, 2, 8, 1, 0, drawn_heading=3)
    geometry = pair.inner.geometry
    assert geometry is not None
    drawn = np.flatnonzero(geometry.cell[:, 0] >= 0)
    np.testing.assert_array_equal(pair.grid.indices()[drawn, 2], 3)
    assert len(drawn) == 64
    shown = np.array(geometry.origin) + geometry.cell[drawn] * np.array(geometry.step)
    np.testing.assert_array_equal(shown, pair.grid.centres()[drawn, :2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"length": 0}, r"length must be at least 1, not 0"),
        ({"resolution": 0}, r"resolution must be at least 1, not 0"),
        ({"headings": 7}, r"headings must be even and at least 4, not 7"),
        ({"headings": 2}, r"headings must be even and at least 4, not 2"),
        ({"turn": 0}, r"turn must be at least 1 and below headings / 2, not 0"),
        ({"turn": 16}, r"turn must be at least 1 and below headings / 2, not 16"),
        ({"pillar_radius": -1.0}, r"pillar_radius must be finite and at least 0, not -1"),
        ({"drawn_heading": 32}, r"drawn_heading must lie in 0 to 31, not 32"),
    ],
)
def test_bad_parameters_are_refused(arguments: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dubins(**arguments)
