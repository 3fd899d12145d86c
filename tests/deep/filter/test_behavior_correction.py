"""Behavior correction: the equation, the wrappers, the files, and SB3's agents inside."""

from __future__ import annotations

import timeit
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import onnxruntime
import pytest
import safetensors.torch
import torch
from safetensors.numpy import save_file
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv

from deep.data.normalisation import Normalisation, Ranges
from deep.filter.behavior_correction import BehaviorCorrection, BehaviorCorrectionVector
from deep.filter.onnx_export import export_onnx
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import DeaRrlAnnealed, DeaRrlAnnealedSettings, Sizes
from deep.pretraining.trained_filter import trained_filter
from deep.tasks import Brake, TaskEnv, TaskVectorEnv
from deep.tasks.bounds import Bounds
from tests.deep import filters


def accelerating_is_bad() -> SafetyFilter:
    """Blocks u >= 0 on the brake, and brakes fully instead."""
    safety: SafetyFilter = filters.linear_filter([0.0, 0.0], 10.0, 0.0, -20.0)
    return safety


def test_an_action_at_the_threshold_is_replaced_and_one_below_is_kept() -> None:
    safety = accelerating_is_bad()
    observations = np.zeros((3, 2), dtype=np.float32)
    actions = np.array([[-0.1], [0.0], [0.1]], dtype=np.float32)
    correction = safety.correct(observations, actions)
    assert correction.critic[1] == 0.5  # exactly the threshold: the paper blocks at Q >= eps
    assert correction.intervened.tolist() == [False, True, True]
    assert correction.executed[:, 0].tolist() == pytest.approx([-0.1, -1, -1])
    assert actions[:, 0].tolist() == pytest.approx([-0.1, 0.0, 0.1])  # the agent's are untouched


def test_an_action_that_is_no_number_is_replaced() -> None:
    safety = accelerating_is_bad()
    correction = safety.correct(np.zeros((1, 2)), np.array([[np.nan]]))
    assert correction.intervened.tolist() == [True]
    assert correction.executed[0, 0] == -1
    assert correction.critic.tolist() == [1.0]


def test_units_enter_through_the_normalisation() -> None:
    units = Normalisation((10.0,), (5.0,), (100.0,), (50.0,))
    raw = filters.linear_filter([1.0], 2.0, 0.5, 0.3, normalisation=units, reach=1.2)
    plain = filters.linear_filter([1.0], 2.0, 0.5, 0.3, reach=1.2)
    observations, actions = np.array([[12.0], [3.0]]), np.array([[130.0], [60.0]])
    expected = plain.q((observations - 10) / 5, (actions - 100) / 50)
    assert raw.q(observations, actions) == pytest.approx(expected, abs=1e-6)
    mean = 100 + 50 * 1.2 * np.tanh(0.3)
    assert raw.recovery_action(observations)[:, 0] == pytest.approx([mean, mean], rel=1e-6)


def test_the_filter_of_a_learner_computes_what_the_learner_does() -> None:
    import torch

    learner = DeaRrlAnnealed(DeaRrlAnnealedSettings(), Sizes(2, 1), (3, 4))
    ranges = Ranges(actions=Bounds((-1.0,), (0.5,)), observations=Bounds.unit(2))
    safety = trained_filter(learner, 4, 0.5, 0.75, Normalisation.identity(2, 1), ranges)
    observations = np.random.default_rng(0).uniform(-1, 1, (40, 2)).astype(np.float32)
    actions = np.random.default_rng(1).uniform(-1, 1, (40, 1)).astype(np.float32)
    assert (safety.actions, safety.observations) == ranges
    with torch.no_grad():
        s, a = (torch.from_numpy(x).expand(2, -1, -1) for x in (observations, actions))
        assert safety.q(observations, actions) == pytest.approx(
            learner.critic.worst(s, a)[1].numpy(), abs=1e-6
        )
        assert safety.recovery_action(observations) == pytest.approx(
            learner.recovery.mean_action(s)[1].numpy().clip(-1, 0.5), abs=1e-6
        )
    with pytest.raises(ValueError, match=r"seed 5 was not trained; there are \[3, 4\]"):
        trained_filter(learner, 5, 0.5, 0.75, Normalisation.identity(2, 1), ranges)


def test_the_wrapper_executes_the_correction_and_reports_it() -> None:
    environment = BehaviorCorrection(TaskEnv(Brake()), accelerating_is_bad())
    with pytest.raises(ValueError, match=r"call reset\(\) before step"):
        environment.step(np.ones(1))
    environment.reset(options={"state": [20.0, 8.0]})
    observation, _, _, _, info = environment.step(np.array([1.0], dtype=np.float32))
    assert info["intervened"] is True
    assert info["executed_action"].tolist() == [-1.0]
    assert info["critic"] > 0.99
    assert info["state"].tolist() == [14.0, 6.0]  # it braked
    assert observation[1] == pytest.approx(0.5)
    _, _, _, _, info = environment.step(np.array([-0.5], dtype=np.float32))
    assert info["intervened"] is False
    assert info["state"].tolist() == [9.0, 5.0]
    assert (environment.steps, environment.interventions) == (2, 1)


def test_the_vector_wrapper_does_the_same_and_survives_resets() -> None:
    single = BehaviorCorrection(TaskEnv(Brake()), accelerating_is_bad())
    many = BehaviorCorrectionVector(TaskVectorEnv(Brake(), 40), accelerating_is_bad())
    with pytest.raises(ValueError, match=r"call reset\(\) before step"):
        many.step(np.ones((40, 1)))
    observations, _ = many.reset(seed=0)
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(25):
        actions = rng.uniform(-1, 1, (40, 1)).astype(np.float32)
        expected = single.safety.correct(observations, actions)
        observations, _, terminated, _, info = many.step(actions)
        assert np.array_equal(info["intervened"], expected.intervened)
        assert np.array_equal(info["executed_action"], expected.executed)
        assert np.array_equal(info["critic"], expected.critic)
        ended += int(terminated.sum())
    assert ended > 0
    assert many.steps == 1000
    assert 400 < many.interventions < 600


def test_environments_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"shapes \(4,\) and \(2,\), the filter was trained on"):
        BehaviorCorrection(gymnasium.make("deep/Point-v0").unwrapped, accelerating_is_bad())


def test_save_and_load(tmp_path: Path) -> None:
    safety = filters.random_filter()
    path = tmp_path / "filter.safetensors"
    safety.save(path)
    loaded = SafetyFilter.load(path)
    rng = np.random.default_rng(0)
    observations, actions = rng.normal(size=(30, 3)), rng.normal(size=(30, 2))
    assert np.array_equal(loaded.q(observations, actions), safety.q(observations, actions))
    assert np.array_equal(
        loaded.recovery_action(observations), safety.recovery_action(observations)
    )
    names = ("threshold", "normalisation", "actions", "observations", "reach", "gamma_safe")
    for name in (*names, "method", "seed"):
        assert getattr(loaded, name) == getattr(safety, name)


def test_broken_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "filter.safetensors"
    with pytest.raises(ValueError, match="there is no such file"):
        SafetyFilter.load(path)
    path.write_text("no")
    with pytest.raises(ValueError, match="not a safetensors file"):
        SafetyFilter.load(path)
    save_file({"x": np.zeros(1)}, path)
    with pytest.raises(ValueError, match="not a .dead-ends safety filter 2. file"):
        SafetyFilter.load(path)
    save_file({"x": np.zeros(1)}, path, {"networks": '{"format": "dead-ends safety filter 2"}'})
    with pytest.raises(ValueError, match="the safety filter lacks 'actions'"):
        SafetyFilter.load(path)
    safetensors.torch.save_file({"x": torch.zeros(1, dtype=torch.bfloat16)}, path)
    with pytest.raises(ValueError, match="filter.safetensors: arrays of type 'BF16', expected F32"):
        SafetyFilter.load(path)
    save_file({"x": np.zeros(1)}, path, {"networks": "[" * 100_000})
    with pytest.raises(ValueError, match="filter.safetensors: the header is damaged"):
        SafetyFilter.load(path)


def test_filters_that_make_no_sense_are_refused() -> None:
    safety = filters.random_filter()
    with pytest.raises(ValueError, match=r"threshold must lie in \(0, 1\], not 0"):
        safety.with_threshold(0.0)
    with pytest.raises(ValueError, match=r"maps R\^2 to R\^1, expected R\^3 to R\^1"):
        replace(
            filters.linear_filter([1.0], 1.0, 0.0, 0.0),
            normalisation=Normalisation.identity(2, 1),
            observations=Bounds.unit(2),
        )
    with pytest.raises(ValueError, match="hold a NaN"):
        filters.linear_filter([np.nan], 1.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="1 centres for 2 scales"):
        Normalisation((0.0,), (1.0, 1.0), (0.0,), (1.0,))
    with pytest.raises(ValueError, match="scales positive"):
        Normalisation((0.0,), (0.0,), (0.0,), (1.0,))


@pytest.mark.parametrize("power", [(), (1.0, 3.0, 24.0)])
def test_onnx_computes_the_same(power: tuple[float, ...], tmp_path: Path) -> None:
    safety = filters.random_filter()
    safety = replace(safety, normalisation=replace(safety.normalisation, observation_power=power))
    some = np.random.default_rng(1).normal(size=(200, 5)) * 2
    median = float(np.median(safety.q(some[:, :3], some[:, 3:])))
    safety = safety.with_threshold(median)
    export_onnx(safety, tmp_path / "filter.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "filter.onnx"))
    rng = np.random.default_rng(0)
    for n in (1, 200):
        observation = rng.normal(size=(n, 3)).astype(np.float32) * 2
        action = rng.normal(size=(n, 2)).astype(np.float32) * 2
        executed, intervened, critic = session.run(
            None, {"observation": observation, "action": action}
        )
        expected = safety.correct(observation, action)
        assert critic == pytest.approx(expected.critic, abs=1e-5)
        clear = np.abs(expected.critic - safety.threshold) > 1e-4
        assert np.array_equal(intervened[clear], expected.intervened[clear])
        assert executed[clear] == pytest.approx(expected.executed[clear], abs=1e-4)
    assert 0 < expected.intervened.mean() < 1


def test_closenesses_are_raised_to_their_powers() -> None:
    sharp = replace(Normalisation.identity(3, 2), observation_power=(1.0, 3.0, 24.0))
    seen = sharp.powered(np.array([[-0.5, 0.5, 0.9], [2.0, -0.5, -0.1]]))
    expected = np.array([[-0.5, 0.125, 0.9**24], [2.0, 0.0, 0.0]])
    assert seen == pytest.approx(expected, rel=1e-6)
    plain = filters.random_filter()
    safety = replace(plain, normalisation=sharp)
    plain = replace(plain, normalisation=replace(sharp, observation_power=()))
    rng = np.random.default_rng(0)
    s, a = rng.uniform(-1, 1, (50, 3)), rng.uniform(-1, 1, (50, 2))
    assert safety.q(s, a) == pytest.approx(plain.q(sharp.powered(s), a), rel=1e-6)
    recovered = plain.recovery_action(sharp.powered(s))
    assert safety.recovery_action(s) == pytest.approx(recovered, rel=1e-6)
    with pytest.raises(ValueError, match="observation: 2 powers for 3 centres"):
        replace(sharp, observation_power=(1.0, 2.0))
    for power in (0.5, np.inf, np.nan):
        with pytest.raises(ValueError, match="powers must be finite and at least 1"):
            replace(sharp, observation_power=(1.0, 1.0, power))


def test_the_cost_of_a_step_is_small() -> None:
    """Three 64x64 members at batch 1; the aim is 100 microseconds on a free core.

    The bound leaves room for a busy machine; benchmarks give the number.
    """
    safety = filters.random_filter(members=3, hidden=64)
    observation, action = np.zeros((1, 3), np.float32), np.zeros((1, 2), np.float32)
    best = min(timeit.repeat(lambda: safety.correct(observation, action), number=50, repeat=20))
    assert best / 50 < 500e-6


def corrected() -> BehaviorCorrection:
    return BehaviorCorrection(TaskEnv(Brake()), accelerating_is_bad())


def test_sac_learns_inside_the_correction_and_stores_its_own_actions() -> None:
    environment = corrected()
    agent = SAC(
        "MlpPolicy",
        environment,
        learning_starts=20,
        batch_size=16,
        policy_kwargs={"net_arch": [16]},
        seed=0,
        device="cpu",
    )
    agent.learn(60)
    assert agent.replay_buffer is not None
    stored = agent.replay_buffer.actions[:60].ravel()
    # The environment never accelerated; the agent's memory says that it wanted to.
    assert (stored > 0).sum() > 10
    assert environment.interventions == (stored >= 0).sum()


def test_td3_learns_inside_the_correction() -> None:
    environment = corrected()
    TD3(
        "MlpPolicy",
        environment,
        learning_starts=20,
        batch_size=16,
        policy_kwargs={"net_arch": [16]},
        seed=0,
        device="cpu",
    ).learn(40)
    assert environment.steps == 40
    assert environment.interventions > 0


def test_ppo_learns_inside_the_correction_on_several_copies() -> None:
    copies = DummyVecEnv([corrected, corrected])
    agent = PPO(
        "MlpPolicy",
        copies,
        n_steps=16,
        batch_size=16,
        n_epochs=1,
        policy_kwargs={"net_arch": [16]},
        seed=0,
        device="cpu",
    )
    agent.learn(64)
    wrappers = [env for env in copies.envs if isinstance(env, gymnasium.Wrapper)]
    counts = [wrapper.get_wrapper_attr("interventions") for wrapper in wrappers]
    assert len(counts) == 2
    assert min(counts) > 0
