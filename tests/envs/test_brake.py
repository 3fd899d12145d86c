"""The braking car against its closed form: stopping distance and survival time."""

import math
from itertools import pairwise

import numpy as np
import pytest

from dead_ends import classify
from dead_ends.envs.brake import (
    BrakeLattice,
    brake,
    explicit,
    late_braker,
    semi_implicit,
    stopping_distance,
    uniform_driver,
    weak_braker,
)
from dead_ends.labels.labelling import INFINITE

LATTICES = [
    BrakeLattice(max_distance, max_speed, braking, acceleration, depth, dynamics)
    for dynamics in (semi_implicit, explicit)
    for max_distance, max_speed, braking, acceleration, depth in (
        (60, 8, 2, 2, 8),
        (60, 8, 1, 3, 1),
        (25, 13, 3, 0, 4),
        (9, 12, 5, 2, 3),
        (200, 17, 1, 1, 17),
    )
]
each_lattice = pytest.mark.parametrize(
    "lattice", LATTICES, ids=[f"{each.dynamics.__name__}-{each.max_speed}" for each in LATTICES]
)


def braked_distance(lattice: BrakeLattice, speed: int) -> int:
    """Brake step by step until the car stands: the definition, not its closed form."""
    distance = 0
    while speed:
        slower = max(speed - lattice.max_braking, 0)
        distance += speed if lattice.dynamics is explicit else slower
        speed = slower
    return distance


def closed_form_survival_time(lattice: BrakeLattice, distance: int, speed: int) -> int:
    """T of a state: the least k with k-step braking distance > d, by the quadratic formula.

    Braking hardest, k <= v / b steps cover k v - b k (k -+ 1) / 2 (explicit, semi-implicit);
    the least k at which this reaches d + 1 is the smaller root of a quadratic, rounded up.
    """
    if distance < 0:
        return 0
    if distance >= stopping_distance(lattice, np.array(speed)):
        return INFINITE
    braking = lattice.max_braking
    linear = 2 * speed + (braking if lattice.dynamics is explicit else -braking)
    root = math.isqrt(linear**2 - 8 * braking * (distance + 1))
    return -((root - linear) // (2 * braking))


@each_lattice
def test_stopping_distance_is_what_braking_covers(lattice: BrakeLattice) -> None:
    speeds = range(lattice.max_speed + 1)
    assert [braked_distance(lattice, speed) for speed in speeds] == list(
        stopping_distance(lattice, np.arange(lattice.max_speed + 1))
    )


@each_lattice
def test_labels_and_survival_times_have_the_closed_form(lattice: BrakeLattice) -> None:
    labelling = classify(brake(lattice))
    distance, speed = lattice.coordinates()
    stop = stopping_distance(lattice, speed)
    np.testing.assert_array_equal(labelling.fail, distance < 0)
    np.testing.assert_array_equal(labelling.dead, (distance >= 0) & (distance < stop))
    np.testing.assert_array_equal(labelling.safe, (distance >= 0) & (distance >= stop))
    expected = [
        closed_form_survival_time(lattice, d, v)
        for d, v in zip(distance.tolist(), speed.tolist(), strict=True)
    ]
    np.testing.assert_array_equal(labelling.survival_time, expected)


def test_the_lattice_of_the_expectile_statement_has_horizon_three() -> None:
    """61 distances x 9 speeds, accelerations -2 to 2."""
    lattice = BrakeLattice(60, 8, 2, 2)
    distance, _ = lattice.coordinates()
    assert np.count_nonzero(distance >= 0) == 61 * 9
    np.testing.assert_array_equal(lattice.changes, [-2, -1, 0, 1, 2])
    assert classify(brake(lattice)).horizon == 3
    assert classify(brake(BrakeLattice(60, 8, 2, 2, dynamics=explicit))).horizon == 4


def test_a_transition_and_its_reward_by_hand() -> None:
    model = brake(BrakeLattice(60, 8, 2, 2, 8, semi_implicit, distance_step=0.5, time_step=0.5))
    lattice = BrakeLattice(60, 8, 2, 2, 8)
    assert model.next_state is not None
    assert model.rewards is not None
    state = lattice.state(10, 5)
    np.testing.assert_array_equal(
        model.next_state[state],
        [lattice.state(d, v) for d, v in ((7, 3), (6, 4), (5, 5), (4, 6), (3, 7))],
    )
    np.testing.assert_array_equal(model.rewards[state], [1.5, 2, 2.5, 3, 3.5])
    crash = lattice.state(3, 8)
    np.testing.assert_array_equal(model.next_state[crash, 2], lattice.state(-5, 8))
    np.testing.assert_array_equal(model.rewards[crash], [1.5] * 5)  # up to the obstacle
    assert model.state_names is not None
    assert model.action_names is not None
    assert model.state_names[state] == "5 m, 5 m/s"
    assert model.action_names == ("-4 m/s²", "-2 m/s²", "+0 m/s²", "+2 m/s²", "+4 m/s²")


def test_explicit_dynamics_move_with_the_old_speed() -> None:
    lattice = BrakeLattice(60, 8, 2, 2, 8, explicit)
    model = brake(lattice)
    assert model.next_state is not None
    assert model.rewards is not None
    state = lattice.state(10, 5)
    np.testing.assert_array_equal(
        model.next_state[state], [lattice.state(5, v) for v in (3, 4, 5, 6, 7)]
    )
    np.testing.assert_array_equal(model.rewards[state], [5 * lattice.distance_step] * 5)


def test_a_collided_car_ends_at_most_obstacle_depth_deep() -> None:
    lattice = BrakeLattice(60, 8, 2, 2, 3)
    model = brake(lattice)
    assert model.next_state is not None
    assert model.next_state[lattice.state(0, 8), 4] == lattice.state(-3, 8)


def test_initial_states_are_far_away_and_can_stop() -> None:
    lattice = BrakeLattice(9, 12, 2, 2)
    initial = brake(lattice).initial
    assert initial is not None
    speeds = np.flatnonzero(stopping_distance(lattice, np.arange(13)) <= 9)
    expected = [lattice.state(9, v) for v in speeds.tolist()]
    np.testing.assert_array_equal(np.flatnonzero(initial), expected)
    assert 1 < len(speeds) < 13


def test_geometry_is_in_metres() -> None:
    lattice = BrakeLattice(max_distance=10, max_speed=4, obstacle_depth=2)
    geometry = brake(lattice).geometry
    assert geometry is not None
    column, row = geometry.cell[lattice.state(6, 3)]
    assert geometry.origin[0] + column * geometry.step[0] == 6 * lattice.distance_step
    assert geometry.origin[1] + row * geometry.step[1] == 3 * lattice.speed_step


def test_the_default_shows_all_three_subsets() -> None:
    labelling = classify(brake())
    assert labelling.fail.sum() == 24 * 41
    assert 2000 < labelling.dead.sum() < labelling.safe.sum()
    assert labelling.horizon == 13  # speeds 37, 34, ..., 1: the 13th step still moves


def test_late_braker_brakes_within_its_distance_only() -> None:
    lattice = BrakeLattice(20, 4, 2, 1, 1)
    distance, _ = lattice.coordinates()
    policy = late_braker(lattice, 5)
    np.testing.assert_array_equal(lattice.changes[policy], np.where(distance <= 5, -2, 1))


def test_weak_braker_uses_a_part_of_the_braking() -> None:
    lattice = BrakeLattice(20, 4, 3, 1, 1)
    policy = weak_braker(lattice, 2)
    assert policy.shape == (22 * 5,)
    np.testing.assert_array_equal(lattice.changes[policy], -2)
    with pytest.raises(ValueError, match=r"braking must lie in 0 to 3, not 4"):
        weak_braker(lattice, 4)


def test_weaker_brakes_mean_more_dead_ends() -> None:
    dead = [classify(brake(BrakeLattice(60, 12, b, 1))).dead.sum() for b in (1, 2, 3, 4)]
    assert all(stronger < weaker for weaker, stronger in pairwise(dead))


def test_uniform_driver_is_a_distribution_over_the_actions() -> None:
    lattice = BrakeLattice(20, 4, 3, 1, 1)
    np.testing.assert_array_equal(uniform_driver(lattice), np.full((22 * 5, 5), 0.2))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("max_distance", 0, "max_distance must be at least 1, not 0"),
        ("max_speed", 0, "max_speed must be at least 1, not 0"),
        ("max_braking", 0, "max_braking must be at least 1, not 0"),
        ("max_acceleration", -1, "max_acceleration must be at least 0, not -1"),
        ("obstacle_depth", 0, "obstacle_depth must be at least 1, not 0"),
        ("distance_step", 0.0, "distance_step must be positive, not 0.0"),
        ("time_step", float("nan"), "time_step must be positive, not nan"),
        ("dynamics", max, "dynamics must be semi_implicit or explicit"),
    ],
)
def test_bad_lattices_are_refused(name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BrakeLattice(**{name: value})  # type: ignore[arg-type]  # the wrong value is the test


def test_states_outside_the_lattice_are_refused() -> None:
    with pytest.raises(ValueError, match=r"distance 481, speed 0 lies outside the lattice"):
        BrakeLattice().state(481, 0)
