"""The tasks: their exact answers against brute force, and their environments."""

from __future__ import annotations

import itertools

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from deep.tasks import (
    ENVIRONMENT_IDS,
    TASK_NAMES,
    Brake,
    DoubleIntegrator,
    Dubins,
    TaskEnv,
    TaskVectorEnv,
    make_task,
    navigation2,
)
from deep.tasks.shapes import Disc, Outside, Rectangle, nearest_point
from deep.tasks.task import Task


def exact_tasks() -> list[Brake | DoubleIntegrator]:
    return [
        Brake(),
        Brake(max_distance=9.0, max_speed=3.7, acceleration=1.3),
        DoubleIntegrator(),
        DoubleIntegrator(dt=0.3, max_speed=0.95, acceleration=0.8),
    ]


def longest_survival(task: Task, states: np.ndarray, grid: np.ndarray, depth: int) -> np.ndarray:
    """Steps until the first violation, greatest over all action sequences of the grid.

    ``depth`` + 1 where some sequence survives ``depth`` steps.
    """
    rng = np.random.default_rng(0)
    best = np.zeros(len(states), dtype=np.int64)
    for sequence in itertools.product(grid, repeat=depth):
        state, alive = states.copy(), np.ones(len(states), dtype=bool)
        lasted = np.zeros(len(states), dtype=np.int64)
        for action in sequence:
            step = task.step(state, np.full((len(state), 1), action), rng)
            lasted += alive
            alive &= ~step.violation
            state = step.next_state
        best = np.maximum(best, np.where(alive, depth + 1, lasted))
    return best


@pytest.mark.parametrize("task", exact_tasks(), ids=repr)
def test_dead_states_die_at_the_stated_time_under_every_action_sequence(
    task: Brake | DoubleIntegrator,
) -> None:
    state = task.reset(np.random.default_rng(3), 4000)
    dead = state[task.dead(state)][:150]
    assert len(dead) > 100
    longest = longest_survival(task, dead, np.linspace(-1, 1, 5), task.horizon)
    assert np.array_equal(longest, task.survival_time(dead))
    assert longest.max() == task.horizon


@pytest.mark.parametrize("task", exact_tasks(), ids=repr)
def test_safe_states_survive_and_stay_safe_under_the_safest_action(
    task: Brake | DoubleIntegrator,
) -> None:
    rng = np.random.default_rng(4)
    state = task.reset(rng, 20_000)
    state = state[~task.dead(state)]
    assert (task.survival_time(state) == -1).all()
    for _ in range(3 * task.horizon + 5):
        step = task.step(state, task.safest_action(state), rng)
        assert not step.violation.any()
        assert not task.dead(step.next_state).any()
        state = step.next_state


@pytest.mark.parametrize("task", exact_tasks(), ids=repr)
def test_no_action_leads_from_a_dead_state_to_a_safe_one(task: Brake | DoubleIntegrator) -> None:
    rng = np.random.default_rng(5)
    state = task.reset(rng, 20_000)
    state = state[task.dead(state)]
    for action in np.linspace(-1, 1, 21):
        step = task.step(state, np.full((len(state), 1), action), rng)
        assert (step.violation | task.dead(step.next_state)).all()
        assert (task.survival_time(step.next_state) < task.survival_time(state)).all()


def test_the_boundary_belongs_to_the_dead_set_in_both_tasks() -> None:
    brake, mass = Brake(), DoubleIntegrator(dt=0.25)
    assert brake.dead(np.array([[12.0, 8.0], [12.001, 8.0], [0.0, 8.0], [1.0, 0.0]])).tolist() == [
        True,
        False,
        False,
        False,
    ]
    # D(1) = 0.5 in binary fractions: exact.
    edge = np.array([[0.5, 1.0], [0.4999, 1.0], [-0.5, -1.0], [1.0, 1.0], [0.99, 0.125]])
    assert mass.dead(edge).tolist() == [True, False, True, False, False]
    assert mass.survival_time(edge).tolist() == [4, -1, 4, 0, -1]


def test_boundary_distance_is_zero_on_the_boundary_only() -> None:
    assert Brake().boundary_distance(np.array([[12.0, 8.0], [13.0, 8.0]])).tolist() == [0.0, 1.0]
    mass = DoubleIntegrator(dt=0.25)
    states = np.array([[0.5, 1.0], [-0.5, -1.0], [0.25, 0.0]])
    assert mass.boundary_distance(states).tolist() == [0.0, 0.0, 0.75]


def test_the_adversary_breaks_into_the_obstacle() -> None:
    rng = np.random.default_rng(6)
    for name in TASK_NAMES:
        task = make_task(name)
        if name.startswith("navigation"):
            continue  # too far away for its 100 steps from some starts
        state = task.reset(rng, 300)
        hit = np.zeros(300, dtype=bool)
        for _ in range(task.time_limit):
            step = task.step(state, task.towards_obstacle(state), rng)
            hit |= step.violation
            state = step.next_state
        assert hit.mean() > 0.95, name


def test_a_double_integrator_that_cannot_stop_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot stop in half of the gap"):
        DoubleIntegrator(max_speed=3.0)


# Safety Gym's sensors are unbounded, and their spaces say so.
@pytest.mark.filterwarnings("ignore:.*A Box observation space (min|max)imum value is -?infinity")
@pytest.mark.parametrize("identifier", ENVIRONMENT_IDS)
def test_registered_environments_pass_the_check(identifier: str) -> None:
    environment = gymnasium.make(identifier, render_mode="rgb_array")
    check_env(environment.unwrapped)
    environment.reset(seed=0)
    image = environment.render()
    assert isinstance(image, np.ndarray)
    assert image.dtype == np.uint8
    assert len(np.unique(image.reshape(-1, 3), axis=0)) >= 3  # background, obstacle, agent


@pytest.mark.parametrize("name", TASK_NAMES)
def test_observations_stay_in_the_box_and_resets_are_no_violations(name: str) -> None:
    task = make_task(name)
    rng = np.random.default_rng(1)
    state = task.reset(rng, 2000)
    assert not task.violates(state).any()
    for _ in range(20):
        observation = task.observe(state)
        assert observation.dtype == np.float32
        assert observation.shape == (2000, task.observation_dim)
        assert (observation >= task.observation_low).all()
        assert (observation <= task.observation_high).all()
        state = task.step(state, rng.uniform(-1, 1, (2000, task.action_dim)), rng).next_state


def test_an_episode_terminates_at_the_violation_and_is_truncated_at_the_limit() -> None:
    environment = TaskEnv(Brake())
    environment.reset(options={"state": [5.0, 8.0]})
    _, _, terminated, truncated, info = environment.step(np.array([-1.0]))
    assert (terminated, truncated, info["cost"]) == (True, False, 1.0)
    environment.reset(options={"state": [5.0, 0.0]})
    for step in range(Brake.time_limit):
        _, _, terminated, truncated, info = environment.step(np.array([-1.0]))
        assert (terminated, truncated, info["cost"]) == (False, step == Brake.time_limit - 1, 0.0)


def test_the_environment_is_reproducible_and_agrees_with_the_task() -> None:
    first, second = TaskEnv(navigation2()), TaskEnv(navigation2())
    a, _ = first.reset(seed=5)
    b, _ = second.reset(seed=5)
    assert np.array_equal(a, b)
    for _ in range(5):
        one, other = first.step(np.ones(2)), second.step(np.ones(2))
        assert np.array_equal(one[0], other[0])
        assert one[1] == other[1]


def test_steps_before_reset_and_odd_render_modes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"brake: call reset\(\) before step"):
        TaskEnv(Brake()).step(np.zeros(1))
    with pytest.raises(ValueError, match=r"brake: call reset\(\) before step"):
        TaskVectorEnv(Brake(), 2).step(np.zeros((2, 1)))
    with pytest.raises(ValueError, match="render_mode must be None or 'rgb_array', not 'human'"):
        TaskEnv(Brake(), render_mode="human")
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        TaskVectorEnv(Brake(), 0)
    with pytest.raises(ValueError, match="give one seed, not a list"):
        TaskVectorEnv(Brake(), 2).reset(seed=[1, 2])
    with pytest.raises(ValueError, match="there is no task 'breaks'"):
        make_task("breaks")
    assert TaskEnv(Brake()).render() is None


def test_the_vector_environment_resets_itself_and_keeps_the_final_observation() -> None:
    task = Brake()
    environment = TaskVectorEnv(task, 50)
    environment.reset(seed=0)
    finals = 0
    for _ in range(120):
        observation, reward, terminated, truncated, info = environment.step(np.ones((50, 1)))
        assert environment.observation_space.contains(observation)
        assert reward.shape == (50,)
        done = terminated | truncated
        assert np.array_equal(info["cost"] == 1, terminated)
        if done.any():
            assert np.array_equal(info["_final_obs"], done)
            # The finished episode ended at distance 0 (observed as -1); the next did not.
            assert (info["final_obs"][terminated, 0] == -1).all()
            assert (observation[done, 0] > -1).all()
            finals += int(done.sum())
        else:
            assert "final_obs" not in info
    assert finals > 500


def test_the_vector_environment_truncates_each_copy_by_its_own_clock() -> None:
    environment = TaskVectorEnv(Brake(max_speed=1e-6, acceleration=1e-6), 3)
    environment.reset(seed=0)
    for step in range(1, 2 * Brake.time_limit + 1):
        _, _, terminated, truncated, _ = environment.step(np.zeros((3, 1)))
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (step % Brake.time_limit == 0)


def test_success_ends_navigation_without_cost() -> None:
    environment = TaskEnv(navigation2())
    environment.reset(seed=0, options={"state": [3.0, 0.0]})
    _, reward, terminated, truncated, info = environment.step(np.zeros(2))
    assert (reward, terminated, truncated, info["cost"]) == (-3.0, True, False, 0.0)


def test_dubins_follows_arcs_of_unit_length() -> None:
    task = Dubins()
    state = np.array([[2.0, 2.0, np.pi - 0.1]])
    for action, turned in ((1.0, task.delta), (0.4, 0.0), (-0.6, -task.delta)):
        step = task.step(state, np.full((1, 1), action), np.random.default_rng(0))
        # The arc of length 1 by small pieces.
        pieces = state[0, 2] + turned * (np.arange(10_000) + 0.5) / 10_000
        expected = state[0, :2] + [np.cos(pieces).mean(), np.sin(pieces).mean()]
        assert step.next_state[0, :2] == pytest.approx(expected, abs=1e-8)
        heading = (state[0, 2] + turned + np.pi) % (2 * np.pi) - np.pi
        assert step.next_state[0, 2] == pytest.approx(heading)


def test_nearest_points_of_shapes() -> None:
    points = np.array([[3.0, 0.0]])
    assert Disc(0, 0, 1).nearest(points).tolist() == [[1.0, 0.0]]
    assert Rectangle(-1, 1, 2, 3).nearest(points).tolist() == [[1.0, 2.0]]
    assert Outside(4.0).nearest(points).tolist() == [[4.0, 0.0]]
    assert nearest_point((Disc(0, 0, 1), Outside(4.0)), points).tolist() == [[4.0, 0.0]]
    assert Outside(4.0).contains(np.array([[4.0, 0.0], [3.9, -3.9]])).tolist() == [True, False]
