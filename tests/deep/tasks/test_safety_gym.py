"""The vectorised Safety Gym tasks: layouts, lidars, rewards, ends of episodes, robots."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deep.data.collect import collect, random_policy, uniform_starts
from deep.tasks import TaskEnv, TaskVectorEnv, make_task
from deep.tasks.safety_gym.car_body import CAR_PUBLISHED, MASS, PITCH, ROLL, YAW
from deep.tasks.safety_gym.car_robot import _turn_ball, car_sensors
from deep.tasks.safety_gym.layout import EXTENT, GOAL_KEEPOUT, ROBOT_KEEPOUT, VASE_KEEPOUT
from deep.tasks.safety_gym.point_robot import POINT, SUBSTEP
from deep.tasks.safety_gym.tasks import VASE_RADIUS, NavigationTask

Array = np.ndarray[Any, np.dtype[Any]]
NAMES = ("static-env", "dynamic-env", "point-goal1", "car-goal1")


def task_of(name: str) -> NavigationTask:
    task = make_task(name)
    assert isinstance(task, NavigationTask)
    return task


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def random_actions(rng: np.random.Generator, n: int) -> Array:
    return rng.uniform(-1, 1, (n, 2))


def scalar_lidar(state: Array, points: Array) -> Array:
    """The definition once more, one object and one sector after another, by complex numbers."""
    readings = [0.0] * 16
    turn = complex(math.cos(state[2]), -math.sin(state[2]))
    for x, y in points:
        z = complex(x - state[0], y - state[1]) * turn
        angle = math.atan2(z.imag, z.real)
        if angle < 0:
            angle += 2 * math.pi
        width = 2 * math.pi / 16
        sector = min(int(angle / width), 15)
        share = angle / width - sector
        near = max(0.0, 3 - abs(z)) / 3
        for s, value in (
            (sector, near),
            (sector + 1, share * near),
            (sector - 1, (1 - share) * near),
        ):
            readings[s % 16] = max(readings[s % 16], value)
    return np.array(readings)


@pytest.mark.parametrize(("name", "dimension"), list(zip(NAMES, (44, 44, 60, 72), strict=True)))
def test_the_observation_is_sensors_then_the_lidars_of_goal_hazards_and_vases(
    name: str, dimension: int
) -> None:
    task = task_of(name)
    rng = generator()
    state = task.reset(rng, 40)
    for _ in range(5):
        state = task.step(state, random_actions(rng, 40), rng).next_state
    observation = task.observe(state)
    assert observation.shape == (40, dimension) == (40, task.observation_dim)
    sensors = 24 if name == "car-goal1" else 12
    objects, count = task.objects(state), task.layout.hazards
    kinds = [objects[:, :1], objects[:, 1 : 1 + count], objects[:, 1 + count :]]
    for k, kind in enumerate(kinds[: (dimension - sensors) // 16]):
        lidar = observation[:, sensors + 16 * k : sensors + 16 * (k + 1)]
        expected = [scalar_lidar(s, points) for s, points in zip(state, kind, strict=True)]
        assert lidar == pytest.approx(np.array(expected), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_sensors_measure_the_motion_in_the_robots_own_axes(name: str) -> None:
    task = task_of(name)
    rng = generator()
    state = task.anywhere(rng, 30)
    observation = task.observe(state).astype(np.float64)
    turned = (state[:, 3] + 1j * state[:, 4]) * np.exp(-1j * state[:, 2])
    assert observation[:, 3] + 1j * observation[:, 4] == pytest.approx(turned, abs=1e-6)
    assert observation[:, 8] == pytest.approx(state[:, 5], abs=1e-6)
    south = -0.5j * np.exp(-1j * state[:, 2])
    assert observation[:, 9] + 1j * observation[:, 10] == pytest.approx(south, abs=1e-6)
    if name == "car-goal1":
        for _ in range(20):
            state = task.step(state, random_actions(rng, 30), rng).next_state
        matrix = task.observe(state)[:, 15:24].reshape(-1, 3, 3).astype(np.float64)
        assert matrix @ matrix.swapaxes(1, 2) == pytest.approx(
            np.broadcast_to(np.eye(3), matrix.shape), abs=1e-5
        )
        assert np.linalg.det(matrix) == pytest.approx(np.ones(30), abs=1e-5)
        assert np.abs(matrix - np.eye(3)).max() > 0.5  # the balls did turn


@pytest.mark.parametrize("name", NAMES)
def test_layouts_keep_the_distances_and_the_square(name: str) -> None:
    task = task_of(name)
    state = task.reset(generator(), 3000)
    hazards, vases = task.layout.hazards, task.layout.vases
    keepouts = np.array(
        [ROBOT_KEEPOUT, GOAL_KEEPOUT]
        + [task.layout.hazard_keepout] * hazards
        + [VASE_KEEPOUT] * vases
    )
    objects = np.concatenate([state[:, None, :2], task.objects(state)], axis=1)
    assert objects.shape == (3000, 2 + hazards + vases, 2)
    for i in range(len(keepouts)):
        assert np.abs(objects[:, i]).max() <= EXTENT - keepouts[i]
        for j in range(i):
            distance = np.linalg.norm(objects[:, i] - objects[:, j], axis=1)
            assert distance.min() >= keepouts[i] + keepouts[j]
    if name != "static-env":
        # The whole square is used.
        assert np.abs(task.objects(state)[:, 0]).max() > EXTENT - GOAL_KEEPOUT - 0.02
    assert (state[:, 3:6] == 0).all()


def test_static_env_has_its_fixed_layout_and_start_distances() -> None:
    task = task_of("static-env")
    state = task.reset(generator(), 20_000)
    assert np.unique(task.objects(state).reshape(len(state), -1), axis=0).tolist() == [
        [1.1, 1.1, 0.0, 0.0]
    ]
    start, goal = state[:, :2], np.array([1.1, 1.1])
    distance = np.linalg.norm(start - goal, axis=1)
    assert distance.mean() == pytest.approx(2.217, abs=0.01)
    along = ((-start) * (goal - start)).sum(axis=1) / distance**2
    nearest = np.linalg.norm(start + np.clip(along, 0, 1)[:, None] * (goal - start), axis=1)
    assert (nearest < 0.7).mean() == pytest.approx(0.34, abs=0.01)


@pytest.mark.parametrize("name", ["dynamic-env", "point-goal1", "car-goal1"])
def test_rewards_telescope_and_goals_are_drawn_again_with_their_distances(name: str) -> None:
    task = task_of(name)
    rng = generator(3)
    state = task.reset(rng, 200)
    total, expected = np.zeros(200), np.zeros(200)
    reached = 0
    start = np.linalg.norm(task.objects(state)[:, 0] - state[:, :2], axis=1)
    for t in range(60):
        if t % 20 == 5:  # put the robots next to their goals, at rest
            moved = task.objects(state)[:, 0] + np.array([0.3005, 0.0])
            here = np.linalg.norm(task.objects(state)[:, 0] - state[:, :2], axis=1)
            expected += start - here
            state[:, :2] = moved
            state[:, 2] = np.pi - task.robot.drives_towards
            start = np.full(200, 0.3005)
        step = task.step(state, np.ones((200, 2)) * [1, 1 if "car" in name else 0], rng)
        total += step.reward
        goal, after = task.objects(state)[:, 0], step.next_state
        new_goal = task.objects(after)[:, 0]
        met = np.linalg.norm(goal - after[:, :2], axis=1) <= 0.3
        assert np.array_equal(met, (new_goal != goal).any(axis=1))
        expected[met] += 1 + (start - np.linalg.norm(goal - after[:, :2], axis=1))[met]
        start[met] = np.linalg.norm(new_goal - after[:, :2], axis=1)[met]
        if met.any():
            reached += int(met.sum())
            assert start[met].min() >= GOAL_KEEPOUT + ROBOT_KEEPOUT
            hazards = task.hazards(after)[met]
            apart = np.linalg.norm(hazards - new_goal[met][:, None], axis=2)
            assert apart.min() >= GOAL_KEEPOUT + task.layout.hazard_keepout
        state = after
    expected += start - np.linalg.norm(task.objects(state)[:, 0] - state[:, :2], axis=1)
    assert reached > 300
    assert total == pytest.approx(expected, abs=1e-9)


def test_static_env_ends_at_its_goal_without_cost() -> None:
    task = task_of("static-env")
    environment = TaskEnv(task)
    environment.reset(seed=0)
    state = task.reset(generator(), 1)[0]
    state[:3] = 1.1, 0.799, np.pi / 2
    environment.reset(options={"state": state})
    for _ in range(20):
        _, reward, terminated, truncated, info = environment.step(np.array([1.0, 0.0]))
        if terminated:
            break
    assert (terminated, truncated, info["cost"]) == (True, False, 0.0)
    assert 1 < reward < 1.1


@pytest.mark.parametrize("name", NAMES)
def test_the_robots_centre_in_a_hazard_ends_the_episode(name: str) -> None:
    task = task_of(name)
    state = task.reset(generator(), 1)
    hazard, size = task.hazards(state)[0, -1], task.layout.hazard_size
    environment = TaskEnv(task)
    for inside in (True, False):
        first = state[0].copy()
        first[:2] = hazard + (size + (-0.01 if inside else 0.01)) * np.array([0.6, -0.8])
        if task.violates(first[None])[0] != inside:
            pytest.fail("another hazard is in the way of the test")
        environment.reset(options={"state": first})
        _, _, terminated, truncated, info = environment.step(np.zeros(2))
        assert (terminated, truncated, info["cost"]) == (inside, False, float(inside))


def test_violations_count_whatever_the_goal() -> None:
    task = task_of("static-env")
    state = task.reset(generator(), 1)
    state[0, -2:] = state[0, :2] = state[0, -4:-2]  # robot and hazard in the goal
    step = task.step(state, np.zeros((1, 2)), generator())
    assert (step.violation.tolist(), step.success.tolist()) == ([True], [False])


def test_an_episode_lasts_a_thousand_steps_and_its_last_observation_is_kept() -> None:
    task = task_of("point-goal1")
    environment = TaskVectorEnv(task, 3)
    before, _ = environment.reset(seed=1)
    for step in range(1, 1001):
        observation, _, terminated, truncated, info = environment.step(np.zeros((3, 2)))
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (step == 1000)
        if step < 1000:
            assert "final_obs" not in info
            before = observation
    # The robots stood still: the last observation is the one before, the next is another.
    assert info["final_obs"] == pytest.approx(before, abs=1e-4)
    assert info["_final_obs"].all()
    assert np.abs(observation - before).max() > 0.1
    assert environment.single_observation_space.contains(observation[0])


def test_a_violation_in_the_vector_environment_keeps_the_final_observation() -> None:
    task = task_of("dynamic-env")
    environment = TaskVectorEnv(task, 64)
    environment.reset(seed=2)
    ends = 0
    for _ in range(400):
        assert environment._states is not None
        action = task.towards_obstacle(environment._states)
        _, _, terminated, truncated, info = environment.step(action)
        assert np.array_equal(terminated, info["cost"] == 1) or ends == 0
        if terminated.any():
            ends += int(terminated.sum())
            final = info["final_obs"][terminated]
            # In a hazard of radius 0.3 its reading is above 0.9; starts are 0.7 away.
            assert final[:, 28:44].max(axis=1).min() > 0.89
            assert task.observe(environment._states)[terminated, 28:44].max() < 0.77
        assert not truncated.any()
    assert ends > 100


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_fixes_everything(name: str) -> None:
    first, second, other = (TaskVectorEnv(task_of(name), 8) for _ in range(3))
    a, _ = first.reset(seed=7)
    b, _ = second.reset(seed=7)
    c, _ = other.reset(seed=8)
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    rng = generator()
    for _ in range(30):
        actions = random_actions(rng, 8)
        one, two = first.step(actions), second.step(actions)
        for x, y in zip(one[:4], two[:4], strict=True):
            assert np.array_equal(x, y)


@pytest.mark.parametrize("name", NAMES)
def test_one_copy_is_a_row_of_many(name: str) -> None:
    task = task_of(name)
    rng = generator(5)
    state = task.reset(rng, 64)
    singles = state.copy()
    for _ in range(10):
        actions = random_actions(rng, 64)
        kept = state.copy()
        step = task.step(state, actions, generator())
        assert np.array_equal(state, kept)  # a step does not change what it is given
        rows = [task.step(singles[i : i + 1], actions[i : i + 1], generator()) for i in range(64)]
        met = (task.objects(step.next_state)[:, 0] != task.objects(state)[:, 0]).any(axis=1)
        assert np.array_equal(step.reward, np.concatenate([row.reward for row in rows]))
        singles = np.concatenate([row.next_state for row in rows])
        assert np.array_equal(step.next_state[~met], singles[~met])
        assert np.array_equal(task.observe(singles[:1]), task.observe(singles)[:1])
        state, singles = step.next_state, step.next_state.copy()


def test_a_vase_is_pushed_aside_and_stops_nobody() -> None:
    task = task_of("point-goal1")
    state = task.reset(generator(), 1)
    state[0, :3] = 0.0
    state[0, -2:] = 0.3, 0.0
    state[0, 10:26] = 9.0  # no hazard near by
    empty = state.copy()
    empty[0, -2:] = 5.0
    for _ in range(60):
        state = task.step(state, np.array([[1.0, 0.0]]), generator()).next_state
        empty = task.step(empty, np.array([[1.0, 0.0]]), generator()).next_state
    assert state[0, 0] == empty[0, 0] > 0.5
    gap = np.hypot(*(state[0, -2:] - state[0, :2]))
    assert gap == pytest.approx(0.1 + VASE_RADIUS, abs=1e-12)


def test_the_point_is_driven_turned_and_slowed_as_its_equations_say() -> None:
    task = task_of("dynamic-env")
    state = task.reset(generator(), 1)
    state[0, 2] = 0.0  # with an exact sine: the servo amplifies the smallest sideways motion
    u = 0.0
    for t in range(100):
        state = task.step(state, np.array([[0.7, 0.0]]), generator()).next_state
        for _ in range(10):  # damping at the end of the substep
            u = (u + SUBSTEP * POINT.thrust) / (1 + SUBSTEP * POINT.drag)
        speed = np.hypot(state[0, 3], state[0, 4])
        assert speed == pytest.approx(u, rel=1e-9), t
    assert u == pytest.approx(POINT.thrust / POINT.drag, rel=0.05)
    # A torque on its own turns it at torque / drag, whatever the offset of its mass.
    state = task.reset(generator(), 1)
    for _ in range(300):
        state = task.step(state, np.array([[0.0, 1.0]]), generator()).next_state
    assert state[0, 5] == pytest.approx(POINT.torque / POINT.yaw_drag, rel=0.01)


def test_the_point_without_force_keeps_the_momentum_that_damping_leaves() -> None:
    """d/dt of the momentum of the centre of mass is -b v of the axis: an independent sum."""
    task = task_of("dynamic-env")
    state = task.anywhere(generator(1), 1)
    c = POINT.offset

    def momentum(s: Array) -> Array:
        ahead = np.array([-np.sin(s[2]), np.cos(s[2])])
        return s[3:5] + c * s[5] * ahead

    before, place = momentum(state[0]), state[0, :2].copy()
    for _ in range(40):
        state = task.step(state, np.zeros((1, 2)), generator()).next_state
    lost = POINT.drag * (state[0, :2] - place)
    assert momentum(state[0]) == pytest.approx(before - lost, abs=2e-3)


def test_the_car_stands_on_its_weight_drives_and_turns() -> None:
    task = task_of("car-goal1")
    rest = task.reset(generator(), 1)
    rest[0, 23:] = 20.0  # nothing near by
    state = rest
    for _ in range(50):
        state = task.step(state, np.zeros((1, 2)), generator()).next_state
    assert np.abs(state[0, 3:6]).max() < 5e-3
    assert state[0, 8] == pytest.approx(9.81, abs=1e-2)
    assert -1e-3 < state[0, 9] < 0
    ahead = rest
    for _ in range(50):
        ahead = task.step(ahead, np.ones((1, 2)), generator()).next_state
    driven = (ahead[0, :2] - rest[0, :2]) @ [-np.sin(rest[0, 2]), np.cos(rest[0, 2])]
    assert -1.7 < driven < -1.0  # towards its -y, at up to 0.9 m/s for two seconds
    turned = rest
    for _ in range(50):
        turned = task.step(turned, np.array([[1.0, -1.0]]), generator()).next_state
    assert 1.0 < turned[0, 2] - rest[0, 2] < 4.0
    assert np.hypot(*(turned[0, :2] - rest[0, :2])) < 0.3


def test_the_cars_mirror_image_moves_as_the_mirror_says() -> None:
    task = task_of("car-goal1")
    state = task.reset(generator(), 1)
    state[0, 23:] = 20.0
    state[0, :3] = 0.0
    other = state.copy()
    for left, right in ((1.0, 1.0), (1.0, 0.0), (-1.0, 0.5)) * 2:
        state = task.step(state, np.array([[left, right]]), generator()).next_state
        other = task.step(other, np.array([[right, left]]), generator()).next_state
    # Sweeps go from left to right: the mirror image differs by what they leave unsolved.
    assert other[0, :3] == pytest.approx(state[0, :3] * [-1, 1, -1], abs=0.03)
    assert np.abs(state[0, :3]).max() > 0.02


def test_the_cars_masses_are_the_published_ones() -> None:
    """Compared with what MuJoCo computes from the robot's model."""
    assert pytest.approx(0.0304450, abs=1e-7) == MASS
    assert 2.4e-4 < PITCH < 2.6e-4
    assert 1.7e-4 < ROLL < 1.9e-4
    assert pytest.approx(3.62e-4, abs=3e-6) == YAW
    assert CAR_PUBLISHED.rate == pytest.approx(2 / (0.95 * 0.02), rel=1e-5)
    assert CAR_PUBLISHED.stiffness == pytest.approx(1 / (0.95 * 0.02) ** 2, rel=1e-5)


def test_the_cars_ball_turns_as_a_composition_of_rotations() -> None:
    rng = generator()
    state = task_of("car-goal1").reset(rng, 1)[0]
    expected = Rotation.identity()
    for x, y in rng.uniform(-20, 20, (200, 2)):
        _turn_ball(state, x, y)
        expected = Rotation.from_rotvec([0.004 * x, 0.004 * y, 0.0]) * expected
    sensors = np.empty(24)
    car_sensors(state, sensors)
    assert sensors[15:].reshape(3, 3) == pytest.approx(expected.as_matrix(), abs=0.01)
    assert np.abs(sensors[15:].reshape(3, 3) - np.eye(3)).max() > 0.3


def test_starts_from_anywhere_are_outside_hazards_and_move() -> None:
    task = task_of("point-goal1")
    state = uniform_starts(task)(generator(), 2000)
    assert not task.violates(state).any()
    assert np.abs(state[:, :2]).max() <= EXTENT
    assert 1.4 < np.hypot(state[:, 3], state[:, 4]).max() <= task.robot.top_speed


def test_data_are_collected_from_them() -> None:
    task = task_of("point-goal1")
    data = collect(task, random_policy(task), generator(), 6400, starts=uniform_starts(task))
    assert data.observations.shape == (6400, 60)
    assert 0 < data.costs.sum() <= data.terminals.sum()


@pytest.mark.parametrize("name", ["StaticEnv", "DynamicEnv", "PointGoal1", "CarGoal1"])
def test_pictures_show_hazards_goal_vase_and_robot(name: str) -> None:
    environment = gymnasium.make(f"deep/{name}-v0", render_mode="rgb_array")
    environment.reset(seed=0)
    image = environment.render()
    assert isinstance(image, np.ndarray)
    colours = len(np.unique(image.reshape(-1, 3), axis=0))
    assert colours == (5 if name.endswith("Goal1") else 4)
