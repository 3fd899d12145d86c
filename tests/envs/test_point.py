"""The point among discs against the continuous dynamics, simulated here in plain numpy."""

from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from dead_ends.envs.point import Disc, PointBracket, PointModel, point_among_discs
from dead_ends.labels.implicit import SURVIVES, ImplicitLabelling, classify_implicit

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

DISCS: tuple[Disc, ...] = ((0.0, 0.1, 0.3), (-0.55, -0.5, 0.2))
HALF, SPEED, ACCELERATION, DT = 0.9, 0.7, 1.0, 0.2


def build(resolution: int, discs: tuple[Disc, ...] = DISCS) -> PointBracket:
    return point_among_discs(
        discs, HALF, SPEED, resolution, acceleration=ACCELERATION, time_step=DT
    )


def violated(points: Floats, discs: tuple[Disc, ...] = DISCS) -> Bools:
    hit = (np.abs(points[:, :2]) >= HALF).any(axis=1)
    for x, y, radius in discs:
        hit |= np.linalg.norm(points[:, :2] - (x, y), axis=1) <= radius
    return np.asarray(hit)


def drive(points: Floats, action: Floats) -> Floats:
    """One step with an acceleration in [-1, 1]^2 times the greatest."""
    velocity = np.clip(points[:, 2:] + ACCELERATION * DT * action, -SPEED, SPEED)
    return np.concatenate((points[:, :2] + (points[:, 2:] + velocity) * DT / 2, velocity), axis=1)


def free_points(count: int, discs: tuple[Disc, ...] = DISCS, seed: int = 0) -> Floats:
    high = np.array([HALF, HALF, SPEED, SPEED])
    points = np.random.default_rng(seed).uniform(-high, high, (count, 4))
    return points[~violated(points, discs)]


class Solved(NamedTuple):
    model: PointModel
    labelling: ImplicitLabelling

    @property
    def lasting(self) -> Bools:
        return np.asarray(self.labelling.survival_time[self.model.between] == SURVIVES)

    def goes_on(self, points: Floats) -> Bools:
        return ~np.isnan(self.model.next_velocity(points, self.lasting)[:, 0])


class Pair(NamedTuple):
    inner: Solved
    outer: Solved

    def safe(self, points: Floats) -> Bools:
        return self.inner.goes_on(points)

    def dead(self, points: Floats) -> Bools:
        return ~self.outer.goes_on(points)


def solve(bracket: PointBracket) -> Pair:
    def labels(model: PointModel) -> Solved:
        labelling = classify_implicit(
            model.successor, model.fail, model.num_states, model.num_actions
        )
        return Solved(model, labelling)

    return Pair(labels(bracket.inner), labels(bracket.outer))


@pytest.fixture(scope="module")
def pairs() -> list[Pair]:
    """Resolutions 1, 2 and 3."""
    return [solve(build(resolution)) for resolution in (1, 2, 3)]


def following(model: PointModel, state: int) -> set[int]:
    """The states after two steps of the model, one of the point."""
    actions = range(model.num_actions)
    halfway = {model.successor(state, action) for action in actions} - {-1}
    return {model.successor(middle, action) for middle in halfway for action in actions} - {-1}


def in_cells(model: PointModel, points: Floats) -> tuple[Floats, Floats]:
    """k and i of each point, along both axes, as real numbers: cells are their floors."""
    length, speed = ACCELERATION * DT**2, ACCELERATION * DT
    velocity = points[:, 2:] / speed
    z = points[:, :2] / length + velocity / 2
    lattice = model.lattice
    return (
        velocity / lattice.spacing - lattice.slowest,
        z / lattice.spacing + lattice.cells / 2,
    )


def state_of(model: PointModel, k: Floats, i: Floats) -> NDArray[np.int64]:
    shape = (model.lattice.speeds,) * 2 + (model.lattice.cells,) * 2
    return np.ravel_multi_index(np.floor(np.column_stack((k, i))).astype(int).T, shape)


@pytest.mark.parametrize("resolution", [1, 2])
def test_outer_states_lead_wherever_a_point_of_them_may_go(resolution: int) -> None:
    model = build(resolution).outer
    points = free_points(400)
    action = np.random.default_rng(1).uniform(-1.5, 1.5, (len(points), 2)).clip(-1, 1)
    after = drive(points, action)
    lost = violated(after)
    first = state_of(model, *in_cells(model, points))
    for state, point, gone in zip(first, after, lost, strict=True):
        reached = following(model, int(state))
        assert gone or int(state_of(model, *in_cells(model, point[None]))[0]) in reached
    assert 20 < lost.sum() < len(points) / 2


@pytest.mark.parametrize("resolution", [1, 2])
def test_inner_states_lead_all_their_points_to_one_cell(resolution: int) -> None:
    model = build(resolution).inner
    lattice, rng = model.lattice, np.random.default_rng(2)
    length, speed = ACCELERATION * DT**2, ACCELERATION * DT
    fails = 0
    for _ in range(2000):
        k = rng.integers(lattice.speeds, size=2)
        i = rng.integers(lattice.cells, size=2)
        state = int(state_of(model, k[None] + 0.0, i[None] + 0.0)[0])
        actions = rng.integers(2 * lattice.steps + 1, size=2)
        middle = model.successor(state, int(actions[0]))
        after = -1 if middle == -1 else model.successor(middle, int(actions[1]))
        if after in (-1, model.num_states - 1):
            fails += after == model.num_states - 1
            continue
        velocity = (k + lattice.slowest) * lattice.spacing
        z = (i + rng.random((50, 2)) - lattice.cells / 2) * lattice.spacing
        points = np.concatenate(
            ((z - velocity / 2) * length, np.tile(velocity, (50, 1)) * speed), 1
        )
        shape = (lattice.speeds,) * 2 + (lattice.cells,) * 2
        chosen = np.array(np.unravel_index(after, shape))[:2] + lattice.slowest
        change = chosen * lattice.spacing - velocity
        assert np.abs(change).max() <= 1
        moved = drive(points, np.tile(change, (50, 1)))
        assert not violated(moved).any()
        # The velocity is on the lattice up to rounding: half a number more, then down.
        k_after, i_after = in_cells(model, moved)
        assert (state_of(model, k_after + 0.5, i_after) == after).all()
    assert 100 < fails < 1900


def stopping_distance(velocity: Floats) -> Floats:
    """How far full braking goes on: the greatest of k v dt - A (k dt)^2 / 2, k = 0, 1, ..."""
    steps = np.arange(10)[:, None, None]
    covered = steps * DT * velocity - ACCELERATION * (steps * DT) ** 2 / 2
    return np.asarray(covered.max(axis=0))


def test_between_walls_alone_the_sets_enclose_the_closed_form() -> None:
    """Without discs the axes do not meet: dead iff one of them is, by its stopping distance."""
    points = free_points(40_000, discs=())
    place, velocity = points[:, :2], points[:, 2:]
    true = (place + stopping_distance(velocity) >= HALF) | (
        -place + stopping_distance(-velocity) >= HALF
    )
    truly_dead = true.any(axis=1)
    gaps = []
    for resolution in (1, 2):
        pair = solve(build(resolution, discs=()))
        safe, dead = pair.safe(points), pair.dead(points)
        assert not (safe & truly_dead).any()
        assert not (dead & ~truly_dead).any()
        gaps.append(1 - (safe | dead).mean())
    assert gaps[1] < 0.6 * gaps[0] < 0.06


def test_straight_at_a_disc_the_stopping_distance_decides() -> None:
    """From afar, with no way round: a disc so large that it is a wall at x = 0."""
    wall: tuple[Disc, ...] = ((50.0, 0.0, 50.0),)
    pair = solve(build(2, wall))
    place, velocity = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.5, -0.01, 99), [0.6]))
    points = np.column_stack((place, 0 * place, velocity, 0 * place))
    stop = stopping_distance(velocity[:, None])[:, 0]
    # The disc falls back by less than 0.01 over the way that the point can go aside.
    assert not pair.dead(points)[place + stop < 0].any()
    assert not pair.safe(points)[place + stop > 0.01].any()
    assert pair.safe(points)[place + stop < -0.06].all()
    assert pair.dead(points)[place + stop > 0.06].all()


def test_certain_points_stay_certain_on_finer_lattices(pairs: list[Pair]) -> None:
    points = free_points(40_000)
    labels = [(pair.safe(points), pair.dead(points)) for pair in pairs]
    for (coarse_safe, coarse_dead), (safe, dead) in pairwise(labels):
        assert not (coarse_safe & dead).any()
        assert not (coarse_dead & safe).any()
    # Cells of half the width lie in those of the whole one, so nothing that was certain is lost.
    (coarse_safe, coarse_dead), (safe, dead) = labels[:2]
    assert not (coarse_safe & ~safe).any()
    assert not (coarse_dead & ~dead).any()
    gaps = [1 - (safe | dead).mean() for safe, dead in labels]
    assert gaps[0] > 1.5 * gaps[1] > 2 * gaps[2]
    assert gaps[2] < 0.06


def test_the_inner_model_is_a_controller(pairs: list[Pair]) -> None:
    """A thousand steps of the continuous system, each on the advice for the point itself."""
    inner = pairs[1].inner
    points = free_points(1200, seed=3)
    points = points[inner.goes_on(points)]
    lasting = inner.lasting
    for _ in range(1000):
        velocity = inner.model.next_velocity(points, lasting)
        action = (velocity - points[:, 2:]) / (ACCELERATION * DT)
        assert np.abs(action).max() <= 1
        points = drive(points, action)
        assert not violated(points).any()
    assert len(points) > 500


EXTREMES = np.array(list(product((-1.0, 0.0, 1.0), repeat=2)))


def test_dead_points_are_lost_whatever_is_done(pairs: list[Pair]) -> None:
    """All sequences of nine actions, and random, braking and improved ones, from dead points."""
    pair = pairs[2]
    points = free_points(40_000, seed=4)
    points = points[pair.dead(points)]
    steps = pair.outer.labelling.horizon // 2 + 1
    rng = np.random.default_rng(5)
    longest = np.zeros(len(points), dtype=int)
    for trial in range(300):
        constant = rng.uniform(-2, 2, (len(points), 2)).clip(-1, 1)
        changing = rng.uniform(-2, 2, (steps, len(points), 2)).clip(-1, 1)
        survived = survival(points, changing if trial % 2 else [constant] * steps)
        longest = np.maximum(longest, survived)
    hardest = points[np.argsort(longest)[-300:]]
    brake = -np.sign(hardest[:, 2:])
    assert survival(hardest, [brake] * steps).max() < steps
    assert improved(hardest, steps, rng).max() < steps
    few = hardest[-12:]
    for first in product(EXTREMES, repeat=2):
        sequences = np.array(list(product(EXTREMES, repeat=2)))  # (81, 2, 2)
        repeated = np.repeat(few, len(sequences), axis=0)
        tiled = np.tile(sequences, (len(few), 1, 1))
        actions = [np.tile(a, (len(repeated), 1)) for a in first] + [tiled[:, 0], tiled[:, 1]]
        actions += [-np.sign(repeated[:, 2:])] * (steps - 4)
        assert survival(repeated, actions).max() < steps
    assert longest.max() >= 2  # there are dead points that do not fail at once


def survival(points: Floats, actions: list[Floats] | Floats) -> NDArray[np.int64]:
    """int (n,): how many steps each point survives under actions (steps, n, 2)."""
    survived = np.zeros(len(points), dtype=int)
    alive = np.ones(len(points), dtype=bool)
    for action in actions:
        points = drive(points, action)
        alive &= ~violated(points)
        survived += alive
    return survived


def improved(points: Floats, steps: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """The survival that random changes of the best sequence so far achieve."""
    best = rng.uniform(-1, 1, (steps, len(points), 2))
    survived = survival(points, best)
    for _ in range(300):
        noise = rng.normal(0, 0.5, best.shape) * (rng.random(best.shape) < 0.3)
        tried = (best + noise).clip(-1, 1)
        found = survival(points, tried)
        better = found >= survived
        best[:, better], survived = tried[:, better], np.maximum(found, survived)
    return survived


def test_bad_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match="resolution must be at least 1, not 0"):
        build(0)
    with pytest.raises(ValueError, match="resolution 40 makes .* states, more than 2"):
        build(40)
    with pytest.raises(ValueError, match=r"disc 1: .* not \(0.0, 0.0, -1.0\)"):
        build(1, ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)))
    for name in ("half_width", "max_speed", "acceleration", "time_step"):
        sizes = {"half_width": 1.0, "max_speed": 1.0, "acceleration": 1.0, "time_step": 1.0}
        with pytest.raises(ValueError, match=f"{name} must be positive and finite, not inf"):
            point_among_discs((), resolution=1, **(sizes | {name: np.inf}))
