"""The real Safety-Gymnasium tasks, where DEAD_ENDS_SAFETY_PYTHON names a Python that has them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from deep.filter.task_policy import TrainedPolicy
from deep.tasks import make_task
from deep.tasks.safety_gym.real import REAL_NAMES, VARIABLE, RealEnv, RealVectorEnv, worker_python
from deep.tasks.safety_gym.tasks import NavigationTask
from deep.train.config import TrainConfig
from deep.train.run import train

installed = pytest.mark.skipif(
    worker_python() is None,
    reason=f"{VARIABLE} is not set: see scripts/install_safety_gymnasium.sh",
)
DIMENSIONS = dict(zip(REAL_NAMES, (44, 44, 60, 72, 104), strict=True))


@installed
@pytest.mark.parametrize("name", REAL_NAMES)
def test_every_real_task_runs_and_begins_anew(name: str) -> None:
    environment = RealVectorEnv(name, 4)
    observation, _ = environment.reset(seed=0)
    assert observation.shape == (4, DIMENSIONS[name])
    rng = np.random.default_rng(0)
    violations = 0
    for step in range(300):
        if step % 75 == 0:  # at first new ones each step, then held, which leads further
            held = rng.choice([-1.0, 1.0], environment.action_space.shape)
        actions = rng.uniform(-1, 1, held.shape) if step < 75 else held
        before = observation
        observation, reward, terminated, truncated, info = environment.step(actions)
        assert environment.observation_space.contains(observation)
        assert observation.dtype == np.float32
        assert np.isfinite(observation).all()
        assert (observation != before).any(axis=1).all()
        assert reward.shape == (4,)
        assert np.abs(reward).max() < 1.5
        assert not truncated.any()
        assert np.isin(info["cost"], (0, 1)).all()
        assert terminated[info["cost"] == 1].all()
        if name != "static-env":  # which ends at its goal too
            assert np.array_equal(terminated, info["cost"] == 1)
        if terminated.any():
            assert np.array_equal(info["_final_obs"], terminated)
            assert np.abs(info["final_obs"][terminated] - observation[terminated]).max() > 0.1
        violations += int(info["cost"].sum())
    environment.close()
    assert violations > 0 or name == "doggo-goal1"  # which stands and trembles


@installed
@pytest.mark.parametrize("name", REAL_NAMES)
def test_a_violation_ends_the_episode_of_its_copy_alone(name: str) -> None:
    environment = RealVectorEnv(name, 3)
    environment.reset(seed=0)
    actions = np.zeros(environment.action_space.shape)
    environment.step(actions)
    environment._worker.call("lay_hazard", 1)
    _, _, terminated, truncated, info = environment.step(actions)
    assert info["cost"].tolist() == [0, 1, 0]
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert info["_final_obs"].tolist() == [False, True, False]
    for _ in range(20):  # the next episode has its hazards where they belong
        assert not environment.step(actions)[2].any()
    environment.close()


@installed
@pytest.mark.parametrize("name", [name for name in REAL_NAMES if name != "doggo-goal1"])
def test_the_vectorised_task_observes_what_the_real_one_does(name: str) -> None:
    task = make_task(name)
    assert isinstance(task, NavigationTask)
    environment = RealVectorEnv(name, 20)
    observation, _ = environment.reset(seed=1)
    state = task.reset(np.random.default_rng(0), 20)
    state[:, :3] = environment._worker.call("poses")
    objects = environment._worker.call("objects")
    assert objects.shape == task.objects(state).shape
    state[:, len(task.robot.state_names) :] = objects.reshape(20, -1)
    # All but the accelerometer, which a robot at rest on the brink of contact leaves open.
    assert task.observe(state)[:, 3:] == pytest.approx(observation[:, 3:], abs=1e-4)
    # And the layouts obey the same distances.
    places = np.concatenate([state[:, None, :2], objects], axis=1)
    keepouts = task.layout.keepouts
    for i in range(len(keepouts)):
        for j in range(i):
            apart = np.linalg.norm(places[:, i] - places[:, j], axis=1).min()
            assert apart >= keepouts[i] + keepouts[j] - 1e-6
    environment.close()


@installed
@pytest.mark.parametrize("name", ["static-env", "dynamic-env", "point-goal1"])
def test_the_vectorised_point_earns_and_sees_what_the_real_one_does(name: str) -> None:
    task = make_task(name)
    assert isinstance(task, NavigationTask)
    environment = RealVectorEnv(name, 10)
    environment.reset(seed=2)
    state = task.reset(np.random.default_rng(0), 10)
    state[:, :3] = environment._worker.call("poses")
    state[:, len(task.robot.state_names) :] = environment._worker.call("objects").reshape(10, -1)
    rng = np.random.default_rng(0)
    alive = np.ones(10, dtype=bool)
    for _ in range(30):
        actions = rng.uniform(-1, 1, (10, 2))
        there, here = environment.step(actions), task.step(state, actions, rng)
        state = here.next_state
        assert np.array_equal(there[4]["cost"][alive] == 1, here.violation[alive])
        alive &= ~there[2] & (np.abs(here.reward) < 0.5)
        assert there[1][alive] == pytest.approx(here.reward[alive], abs=2e-3)
        lidars = slice(12, 44)
        assert there[0][alive, lidars] == pytest.approx(
            task.observe(state)[alive, lidars], abs=0.05
        )
    assert alive.sum() >= 5
    environment.close()


@installed
@pytest.mark.parametrize("name", REAL_NAMES)
def test_a_short_training_on_every_real_task(name: str, tmp_path: Path) -> None:
    config = TrainConfig(
        task=f"real:{name}",
        seeds=(0, 1),
        steps=240,
        copies=2,
        start_steps=80,
        evaluate_every=160,
        evaluation_episodes=1,
        episodes=1,
        log_every=80,
        checkpoint_every=80,
    )
    found = train(config, tmp_path, quiet=True)
    assert [entry.seed for entry in found.seeds] == [0, 1]
    assert all(1 <= entry.length <= 1000 for entry in found.seeds)
    content = json.loads((tmp_path / "result.json").read_text())
    assert content["budget"]["updates"] == (240 - 80) // 10
    policy = TrainedPolicy.load(tmp_path / "policies" / "seed1.safetensors")
    action = policy.act(np.zeros((3, DIMENSIONS[name]), dtype=np.float32))
    assert np.isfinite(action).all()
    assert np.abs(action).max() <= 1


@installed
def test_the_real_environment_passes_the_check_and_renders() -> None:
    environment = RealEnv("point-goal1", render_mode="rgb_array")
    with pytest.warns(UserWarning, match="infinity"):  # sensors are unbounded
        check_env(environment, skip_render_check=True)
    first, _ = environment.reset(seed=3)
    second, info = environment.reset(seed=3)
    assert np.array_equal(first, second)
    assert info == {"cost": 0.0}
    image = environment.render()
    assert image is not None
    assert image.shape == (256, 256, 3)
    assert image.std() > 5
    environment.close()


def test_a_missing_simulator_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(ValueError, match=f"{VARIABLE} does not name a Python"):
        RealEnv("point-goal1")
    monkeypatch.setenv(VARIABLE, "/nowhere/python")
    with pytest.raises(ValueError, match=f"{VARIABLE}: /nowhere/python cannot be run"):
        RealVectorEnv("point-goal1", 2)
    monkeypatch.setenv(VARIABLE, sys.executable)  # it has no Safety-Gymnasium
    with pytest.raises(ValueError, match="the Safety-Gymnasium process .* has ended"):
        RealEnv("point-goal1")


def test_bad_arguments_are_refused_before_a_process_starts() -> None:
    with pytest.raises(ValueError, match="there is no real task 'brake'; there are static-env"):
        RealEnv("brake")
    with pytest.raises(ValueError, match="there is no real task 'brake'"):
        RealVectorEnv("brake", 1)
    with pytest.raises(ValueError, match="num_envs must be at least 1, not 0"):
        RealVectorEnv("point-goal1", 0)
    with pytest.raises(ValueError, match="render_mode must be None or 'rgb_array', not 'human'"):
        RealEnv("point-goal1", render_mode="human")


@installed
def test_steps_before_reset_and_lists_of_seeds_are_refused() -> None:
    environment = RealVectorEnv("point-goal1", 1)
    with pytest.raises(ValueError, match=r"point-goal1: call reset\(\) before step"):
        environment.step(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="give one seed, not a list"):
        environment.reset(seed=[1])
    environment.reset(seed=0)
    with pytest.raises(ValueError, match="Safety-Gymnasium: ValueError: Action dimension"):
        environment.step(np.zeros((1, 3)))
    environment.close()
