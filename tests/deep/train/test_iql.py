"""IQL: its update by hand, its fixed points on small chains, and its runs."""

from __future__ import annotations

import csv
import itertools
import json
import math
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

import deep.train.offline
from deep.__main__ import main
from deep.data.formats import read_hdf5, write_hdf5
from deep.data.minibatches import Batches
from deep.data.normalisation import Normalisation
from deep.data.transitions import Transitions
from deep.filter.task_policy import TrainedPolicy
from deep.nn.losses import advantage_weighted_regression
from deep.runs.checkpoint import load_checkpoint, save_checkpoint
from deep.tasks import make_task
from deep.tasks.gym import Rules
from deep.tasks.task import Sizes
from deep.train.episodes import run_episodes
from deep.train.iql import Iql, IqlSettings
from deep.train.learner import TaskBatch, TaskLosses
from deep.train.offline import OfflineConfig, task_batch, train_offline
from deep.train.result import EPISODES_KEPT_APART, checked_losses
from tests.deep.adam import went_down

GAMMA = 0.8
SIZES = Sizes(3, 1)
SMALL = IqlSettings(
    gamma=GAMMA,
    hidden=(32,),
    learning_rate=5e-3,
    batch_size=64,
    polyak=0.05,
    reward_scale=1.0,
)
CHOICES = np.linspace(-1, 1, 32)


def chain_of_choices() -> Transitions:
    """s0 pays its action and leads to s1; s1 pays 1 plus its action and ends.

    Actions are uniform. The worst action in s1 counts as a violation: data must show one.
    """
    state = np.repeat([0, 1], len(CHOICES))
    action = np.tile(CHOICES, 2)
    last = state == 1
    cost = np.zeros(len(state))
    cost[len(CHOICES)] = 1.0
    return Transitions(
        observations=np.eye(3)[state],
        actions=action[:, None],
        next_observations=np.eye(3)[state + 1],
        rewards=last + action,
        costs=cost,
        terminals=last,
        timeouts=np.zeros(len(state), dtype=bool),
    )


def batches_of(data: Transitions, seeds: tuple[int, ...] = (0,)) -> Batches:
    return Batches([data], seeds, 64, None, torch.device("cpu"))


def learn(settings: IqlSettings, data: Transitions, updates: int = 700) -> Iql:
    learner = Iql(settings, SIZES, (0,))
    batches = batches_of(data)
    for update in range(updates):
        learner.slow_down(update / updates)
        learner.update(task_batch(batches, update))
    return learner


def values(learner: Iql) -> list[float]:
    with torch.no_grad():
        found: list[float] = learner.value(torch.eye(3)[None, :2])[0].tolist()
    return found


def expectile_of(rewards: NDArray[np.float64], expectile: float) -> float:
    """By its first-order condition, bisected."""
    low, high = float(rewards.min()), float(rewards.max())
    for _ in range(60):
        middle = (low + high) / 2
        above = expectile * np.maximum(rewards - middle, 0).sum()
        below = (1 - expectile) * np.maximum(middle - rewards, 0).sum()
        low, high = (middle, high) if above > below else (low, middle)
    return low


@pytest.mark.parametrize("expectile", [0.5, 0.7, 0.97])
def test_the_value_is_the_expectile_over_the_datas_actions(expectile: float) -> None:
    last = expectile_of(1 + CHOICES, expectile)
    first = expectile_of(CHOICES + GAMMA * last, expectile)
    found = values(learn(replace(SMALL, expectile=expectile), chain_of_choices()))
    assert found == pytest.approx([first, last], abs=0.06)
    if expectile == 0.5:  # the behaviour policy's own value
        assert (first, last) == pytest.approx((GAMMA, 1.0), abs=1e-6)
    if expectile == 0.97:  # towards the best action's
        assert found == pytest.approx([1 + 2 * GAMMA, 2.0], abs=0.6)


def test_the_policy_takes_the_better_actions_of_the_data() -> None:
    learner = learn(SMALL, chain_of_choices())
    with torch.no_grad():
        first, last = learner.policy.mean_action(torch.eye(3)[None, :2])[0, :, 0].tolist()
    assert first > 0.3
    assert last > 0.3


def test_without_beta_the_policy_copies_the_data() -> None:
    learner = learn(replace(SMALL, beta=0.0), chain_of_choices(), 400)
    with torch.no_grad():
        mean = learner.policy.mean_action(torch.eye(3)[None, :2])[0, :, 0]
    assert mean.abs().max().item() < 0.15


def test_a_timeout_is_bootstrapped_through_and_an_end_is_not() -> None:
    # The same rows, paying 1 in one state for ever: 1 / (1 - gamma) if only cut off, else 1.
    rows = 64
    state = np.tile(np.eye(3)[0], (rows, 1))
    ends = np.arange(rows) % 8 == 7
    common = {
        "observations": state,
        "actions": np.resize(CHOICES, rows)[:, None],
        "next_observations": state,
        "rewards": np.ones(rows),
    }
    cost = np.zeros(rows)
    cost[-1] = 1.0  # data must show a violation
    violation = cost == 1
    cut = Transitions(**common, costs=cost, terminals=violation, timeouts=ends & ~violation)
    everywhere = np.ones(rows, dtype=bool)
    over = Transitions(**common, costs=cost, terminals=everywhere, timeouts=~everywhere)
    settings = replace(SMALL, expectile=0.5)
    # One row in 64 ends: V = 1 + gamma 63/64 V.
    assert values(learn(settings, cut))[0] == pytest.approx(1 / (1 - GAMMA * 63 / 64), abs=0.15)
    assert values(learn(settings, over))[0] == pytest.approx(1.0, abs=0.05)


def test_one_update_by_hand() -> None:
    settings = replace(SMALL, reward_scale=10.0, expectile=0.9, beta=2.0)
    learner, untouched = (Iql(settings, SIZES, (5,)) for _ in range(2))
    for one in (learner, untouched):  # targets that are not the critics
        with torch.no_grad():
            for parameter in one.critic_target.parameters():
                parameter += 0.1
    batch = task_batch(batches_of(chain_of_choices(), (5,)), 0)
    losses = learner.update(batch)
    with torch.no_grad():
        q = untouched.critic_target(batch.observation, batch.action).amin(dim=1)
        # The value is updated first; policy and critics see the new one.
        baseline, following = (
            learner.value(batch.observation),
            learner.value(batch.next_observation),
        )
        weight = torch.minimum(torch.exp(2.0 * (q - baseline)), torch.tensor(100.0))
        target = 10 * batch.reward + GAMMA * (1 - batch.terminal) * following
    log_prob = untouched.policy.log_prob(batch.observation, batch.action)
    policy_loss = -(weight * log_prob).mean()
    both = untouched.critic(batch.observation, batch.action)
    squares = ((both[:, 0] - target) ** 2).mean() + ((both[:, 1] - target) ** 2).mean()
    assert losses.policy.item() == pytest.approx(policy_loss.item(), rel=1e-5)
    assert losses.critic.item() == pytest.approx(squares.item(), rel=1e-5)
    u = q - untouched.value(batch.observation)
    value_loss = (torch.where(u > 0, 0.9, 0.1) * u**2).mean()
    assert went_down(value_loss, untouched.value, learner.value, settings.learning_rate)
    assert went_down(policy_loss, untouched.policy, learner.policy, settings.learning_rate)
    assert went_down(squares, untouched.critic, learner.critic, settings.learning_rate)
    # The targets have followed by polyak.
    for start, online, target_net in zip(
        untouched.critic_target.parameters(), learner.critic.parameters(),
        learner.critic_target.parameters(), strict=True,
    ):  # fmt: skip
        assert torch.allclose(target_net, start + 0.05 * (online - start), atol=1e-7)


def test_advantages_are_capped_and_point_towards_reward() -> None:
    def weight(advantage: float) -> float:
        one = torch.ones(1, 1)
        return -advantage_weighted_regression(-advantage * one, 0 * one, one, 3.0, one).item()

    assert weight(1.0) == pytest.approx(math.exp(3))
    assert weight(-1.0) == pytest.approx(math.exp(-3))
    assert weight(2.0) == 100.0


def test_minibatches_carry_their_rewards() -> None:
    data = chain_of_choices()
    batches = batches_of(data, (0, 4))
    batch, plain = task_batch(batches, 70), batches.get(70)
    for name in ("observation", "action", "next_observation", "cost", "terminal"):
        assert getattr(batch, name).equal(getattr(plain, name)), name
    assert batch.noise.equal(plain.noise)
    assert batch.next_noise.equal(plain.next_noise)
    assert not batch.noise.equal(batch.next_noise)
    known = {(tuple(s), float(a[0])): r for s, a, r in zip(
        data.observations.tolist(), data.actions, data.rewards, strict=True)}  # fmt: skip
    for s, a, r in zip(
        batch.observation.flatten(0, 1).tolist(),
        batch.action.flatten().tolist(),
        batch.reward.flatten().tolist(),
        strict=True,
    ):
        assert known[tuple(s), a] == r
    assert batch.executed is batch.action


def test_a_seed_learns_the_same_alone() -> None:
    data = chain_of_choices()
    both, alone = Iql(SMALL, SIZES, (3, 8)), Iql(SMALL, SIZES, (8,))
    for update in range(10):
        both.update(task_batch(batches_of(data, (3, 8)), update))
        alone.update(task_batch(batches_of(data, (8,)), update))
    for name, tensor in alone.state_dict().items():
        found = both.state_dict()[name].reshape(2, -1)[1]  # seeds come first in every tensor
        assert found.tolist() == pytest.approx(tensor.flatten().tolist(), abs=1e-5), name


def test_a_checkpoint_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    batches = batches_of(chain_of_choices())
    whole, first, second = (Iql(SMALL, SIZES, (0,)) for _ in range(3))
    for update in range(6):
        whole.update(task_batch(batches, update))
        if update < 3:
            first.update(task_batch(batches, update))
    save_checkpoint(first, 3, tmp_path / "checkpoint.safetensors")
    load_checkpoint(second, tmp_path / "checkpoint.safetensors")
    for update in range(3, 6):
        second.update(task_batch(batches, update))
    for name, tensor in whole.state_dict().items():
        assert tensor.equal(second.state_dict()[name]), name


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"expectile": 0.0}, r"expectile must lie in \(0, 1\), not 0.0"),
        ({"expectile": 1.0}, r"expectile must lie in \(0, 1\), not 1.0"),
        ({"beta": -1.0}, "beta must not be negative, not -1.0"),
        ({"gamma": 0.0}, r"gamma must lie in \(0, 1\], not 0.0"),
    ],
)
def test_settings_that_make_no_sense(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        IqlSettings(**wrong)


# Runs


@pytest.fixture
def config(tmp_path: Path) -> OfflineConfig:
    """A tiny run on the brake task, with recorded random actions."""
    rng = np.random.default_rng(0)
    task = make_task("brake")
    n = 400
    observations = rng.uniform(-1, 1, (n, task.observation_dim))
    cost = rng.random(n) < 0.1
    data = Transitions(
        observations=observations,
        actions=rng.uniform(-1, 1, (n, task.action_dim)),
        next_observations=0.5 + np.roll(observations, -1, axis=0),
        rewards=rng.normal(size=n),
        costs=cost,
        terminals=cost,
        timeouts=(np.arange(n) == n - 1) & ~cost,
    )
    write_hdf5(data, tmp_path / "data.hdf5")
    return OfflineConfig(
        task="brake",
        data=tmp_path / "data.hdf5",
        method=IqlSettings(hidden=(8,), batch_size=16),
        seeds=(0, 3),
        updates=40,
        evaluate_every=20,
        evaluation_episodes=3,
        episodes=5,
        log_every=10,
        checkpoint_every=15,
    )


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def test_a_run_leaves_everything_that_is_needed(config: OfflineConfig, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    found = train_offline(config, folder, quiet=True)
    assert found.method == "iql"
    result = json.loads((folder / "result.json").read_text())
    assert (result["task"], result["method"]) == ("brake", "iql")
    assert result["budget"]["env_steps"] == 0
    assert result["budget"]["updates"] == 40
    assert result["budget"]["evaluation_episodes"] == 5
    assert [entry["seed"] for entry in result["seeds"]] == [0, 3]
    for entry in result["seeds"]:
        assert (entry["tv"], entry["arr"], entry["threshold"]) == (0, 0.0, None)
    stored = json.loads((folder / "config.json").read_text())
    assert stored["run"] == json.loads(json.dumps(config.to_json()))
    assert stored["run"]["method"]["name"] == "iql"
    assert {"numpy", "torch", "python", "git"} <= set(stored["made with"])
    steps = [(row["step"], row["seed"]) for row in rows(folder / "progress.csv")]
    assert steps == [(str(u), seed) for u in (10, 20, 30, 40) for seed in ("0", "3")]
    evaluations = rows(folder / "evaluations.csv")
    assert [(row["step"], row["episodes"]) for row in evaluations] == [
        (step, "3") for step in ("20", "20", "40", "40")
    ]
    policy = TrainedPolicy.load(folder / "policies" / "seed3.safetensors")
    assert (policy.method, policy.seed) == ("iql", 3)
    assert not (folder / "filters").exists()


def test_the_saved_policy_is_the_trained_one(config: OfflineConfig, tmp_path: Path) -> None:
    train_offline(config, tmp_path / "run", quiet=True)
    task = make_task("brake")
    learner = Iql(config.method, Sizes(task.observation_dim, task.action_dim), config.seeds)
    load_checkpoint(learner, tmp_path / "run" / "checkpoint.safetensors")
    policy = TrainedPolicy.load(tmp_path / "run" / "policies" / "seed3.safetensors")
    n: Normalisation = policy.normalisation
    raw = np.random.default_rng(1).uniform(-1, 1, (6, task.observation_dim)).astype(np.float32)
    scaled = (raw - np.array(n.observation_centre)) / np.array(n.observation_scale)
    states: Tensor = torch.from_numpy(scaled.astype(np.float32)).expand(2, -1, -1)
    with torch.no_grad():
        expected = learner.policy.mean_action(states)[1].numpy()
    assert policy.act(raw) == pytest.approx(expected, abs=1e-5)


def test_the_files_costs_may_have_a_rule_of_their_own(
    config: OfflineConfig, tmp_path: Path
) -> None:
    doubled = tmp_path / "doubled.hdf5"
    shutil.copy(config.data, doubled)
    with h5py.File(doubled, "r+") as file:
        file["costs"][:] = 2 * file["costs"][:]
    with pytest.raises(ValueError, match="--violation"):
        train_offline(replace(config, data=doubled), tmp_path / "refused", quiet=True)
    ruled = replace(config, data=doubled, data_violation="cost > 1")
    train_offline(ruled, tmp_path / "ruled", quiet=True)
    stored = json.loads((tmp_path / "ruled" / "config.json").read_text())["run"]
    assert stored["data_violation"] == "cost > 1"
    assert "rules" not in stored
    ending = replace(ruled, task="gym:any", rules=Rules(termination_is_violation=True))
    assert ending.environment_rules.violation is None
    assert ending.violation_in_data == "cost > 1"
    same = replace(config, task="gym:any", rules=Rules(violation="cost > 3"))
    assert same.violation_in_data == same.environment_rules.violation == "cost > 3"
    with pytest.raises(ValueError, match="rule"):
        replace(config, data_violation="speed > 1")


def test_what_a_run_learns_from(
    config: OfflineConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All rows alike, standardised by the whole data, at rates that slide down."""
    batches: list[TaskBatch] = []
    rates: list[set[float]] = []
    update = Iql.update

    def watched(self: Iql, batch: TaskBatch) -> TaskLosses:
        batches.append(batch)
        rates.append({group["lr"] for o in self.optimizers for group in o.param_groups})
        return update(self, batch)

    monkeypatch.setattr(Iql, "update", watched)
    train_offline(config, tmp_path / "run", quiet=True)
    data = read_hdf5(config.data)
    centre, scale = data.observations.mean(axis=0), data.observations.std(axis=0)
    units = TrainedPolicy.load(tmp_path / "run" / "policies" / "seed0.safetensors").normalisation
    assert units.observation_centre == pytest.approx(centre, rel=1e-4)
    assert units.observation_scale == pytest.approx(scale, rel=1e-4)
    assert (units.action_centre, units.action_scale) == ((0.0,), (1.0,))
    unscaled = Batches([data], config.seeds, 16, None, torch.device("cpu"))
    assert len(batches) == config.updates
    for number in (0, 33):
        found, raw = batches[number], task_batch(unscaled, number)
        for name in ("observation", "next_observation"):
            expected = (getattr(raw, name).numpy() - centre) / scale
            assert getattr(found, name).numpy() == pytest.approx(expected, abs=1e-5)
        for name in ("action", "executed", "reward", "cost", "terminal", "noise", "next_noise"):
            assert getattr(found, name).equal(getattr(raw, name)), name
    for number, rate in enumerate(rates):
        (only,) = rate
        slid = max(number / config.updates - 0.5, 0) / 0.5
        expected_rate = config.method.learning_rate * (1 - 0.95 * slid)
        assert only == pytest.approx(expected_rate)


def test_results_are_the_saved_policies(config: OfflineConfig, tmp_path: Path) -> None:
    found = train_offline(config, tmp_path / "run", quiet=True)
    evaluations = rows(tmp_path / "run" / "evaluations.csv")
    for k, seed in enumerate(config.seeds):
        policy = TrainedPolicy.load(tmp_path / "run" / "policies" / f"seed{seed}.safetensors")
        at_end = run_episodes("brake", policy.act, None, 5, seed)
        entry = [getattr(found.seeds[k], name) for name in ("acr", "avr", "arr", "length")]
        assert entry == [at_end.acr, at_end.avr, at_end.arr, at_end.length]
        during = run_episodes("brake", policy.act, None, 3, seed + EPISODES_KEPT_APART)
        last = [float(evaluations[-2 + k][name]) for name in ("acr", "avr", "arr", "length")]
        expected = [during.acr, during.avr, during.arr, during.length]
        assert last == pytest.approx(expected, rel=1e-5)


class Stop(Exception):
    """Stands for whatever ends a process."""


@pytest.mark.parametrize("at", [17, 32])
def test_a_run_that_was_stopped_ends_as_if_nothing_had_happened(
    config: OfflineConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    train_offline(config, tmp_path / "whole", quiet=True)
    update = Iql.update
    done = 0

    def stopping(self: Iql, batch: TaskBatch) -> TaskLosses:
        nonlocal done
        done += 1
        if done == at:
            raise Stop
        return update(self, batch)

    with monkeypatch.context() as patch:
        patch.setattr(Iql, "update", stopping)
        with pytest.raises(Stop):
            train_offline(config, tmp_path / "cut", quiet=True)
    assert not (tmp_path / "cut" / "result.json").exists()
    with monkeypatch.context() as patch:
        patch.setattr(Iql, "update", stopping)
        done = at
        train_offline(config, tmp_path / "cut", quiet=True)
    assert done - at == config.updates - at // 15 * 15  # went on from the checkpoint
    for name in ("policies/seed0.safetensors", "policies/seed3.safetensors"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    for table in ("progress.csv", "evaluations.csv"):
        assert rows(tmp_path / "cut" / table) == rows(tmp_path / "whole" / table)


def test_the_time_of_all_parts_of_a_run_is_added_up(
    config: OfflineConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = itertools.count()  # one when a part begins, one an update
    clock = SimpleNamespace(perf_counter=lambda: float(next(ticks)))
    monkeypatch.setattr(deep.train.offline, "time", clock)
    update = Iql.update
    done = 0

    def stopping(self: Iql, batch: TaskBatch) -> TaskLosses:
        nonlocal done
        done += 1
        if done == 20:
            raise Stop
        return update(self, batch)

    monkeypatch.setattr(Iql, "update", stopping)
    with pytest.raises(Stop):
        train_offline(config, tmp_path / "run", quiet=True)
    train_offline(config, tmp_path / "run", quiet=True)
    budget = json.loads((tmp_path / "run" / "result.json").read_text())["budget"]
    assert budget["wall_seconds"] == config.updates  # without the four that were lost
    with (tmp_path / "run" / "progress.csv").open() as file:
        logged = [(row["step"], row["seconds"]) for row in csv.DictReader(file)]
    assert logged[::2] == [(str(step), f"{step}.0") for step in (10, 20, 30, 40)]


def test_an_interrupt_saves_and_is_passed_on(
    config: OfflineConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    update = Iql.update
    done = 0

    def interrupted(self: Iql, batch: TaskBatch) -> TaskLosses:
        nonlocal done
        done += 1
        if done == 7:
            os.kill(os.getpid(), signal.SIGINT)
        return update(self, batch)

    monkeypatch.setattr(Iql, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_offline(config, tmp_path / "run", quiet=True)
    assert done == 7
    train_offline(config, tmp_path / "run", quiet=True)
    assert done == config.updates  # nothing was done twice


@pytest.mark.parametrize("due", ["evaluate_every", "checkpoint_every"])
def test_a_loss_that_is_no_number_stops_the_run_and_keeps_the_checkpoint(
    config: OfflineConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, due: str
) -> None:
    rhythms = {"log_every": 100, "evaluate_every": 100, "checkpoint_every": 15} | {due: 15}
    config = replace(config, **rhythms)
    update = Iql.update
    done = 0

    def poisoned(self: Iql, batch: TaskBatch) -> TaskLosses:
        nonlocal done
        done += 1
        losses = update(self, batch)
        if done >= 20:
            losses.critic[1] = torch.nan
            with torch.no_grad():
                self.policy.mlp.biases[0][1] = torch.nan
        return losses

    with monkeypatch.context() as patch:
        patch.setattr(Iql, "update", poisoned)
        message = "^update 30: a loss of seed 3 is not a number; try a smaller learning rate$"
        with pytest.raises(FloatingPointError, match=message):
            train_offline(config, tmp_path / "run", quiet=True)
    assert len(train_offline(config, tmp_path / "run", quiet=True).seeds) == 2


def test_a_finished_run_is_only_read(config: OfflineConfig, tmp_path: Path) -> None:
    first = train_offline(config, tmp_path / "run", quiet=True)
    (tmp_path / "run" / "checkpoint.safetensors").unlink()
    assert train_offline(config, tmp_path / "run", quiet=True) == first


def test_another_run_or_other_data_are_refused(config: OfflineConfig, tmp_path: Path) -> None:
    train_offline(config, tmp_path / "run", quiet=True)
    with pytest.raises(ValueError, match=r"run holds a run with another configuration$"):
        train_offline(replace(config, updates=50), tmp_path / "run", quiet=True)
    config.data.write_bytes(b"something else")
    with pytest.raises(ValueError, match=r"data.hdf5: the data have changed since the run began$"):
        train_offline(config, tmp_path / "run", quiet=True)


def test_data_that_do_not_fit_the_task_are_refused(config: OfflineConfig, tmp_path: Path) -> None:
    data = chain_of_choices()
    write_hdf5(data, config.data)
    message = r"data.hdf5: observations in R\^3 and actions in R\^1, brake has R\^2 and R\^1$"
    with pytest.raises(ValueError, match=message):
        train_offline(config, tmp_path / "run", quiet=True)
    actions = data.actions.copy()
    narrow = replace(data, observations=data.observations[:, :2],
                     next_observations=data.next_observations[:, :2])  # fmt: skip
    for wide, row in ((1.01, 40), (-1.01, 5)):
        actions[row] = wide
        write_hdf5(replace(narrow, actions=actions), config.data)
        with pytest.raises(ValueError, match=rf"actions: row {row} is \({wide}\), outside"):
            train_offline(config, tmp_path / "other", quiet=True)
    assert not (tmp_path / "other").exists()
    write_hdf5(replace(narrow, actions=data.actions * 1.0005), config.data)  # by rounding
    train_offline(replace(config, updates=1), tmp_path / "other", quiet=True)


@pytest.mark.parametrize(
    "name",
    [
        *("updates", "episodes", "evaluate_every"),
        *("log_every", "evaluation_episodes", "checkpoint_every"),
    ],
)
def test_counts_must_be_positive(config: OfflineConfig, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be at least 1, not 0$"):
        replace(config, **{name: 0})


def test_a_loss_that_is_no_number_names_its_seed() -> None:
    losses = TaskLosses(torch.tensor([1.0, float("nan")]), torch.tensor([0.5, 0.5]))
    assert checked_losses(7, 0, losses, "update 20") == ["1", "0.5"]
    assert checked_losses(7, 0, None, "update 20") == ["", ""]
    with pytest.raises(FloatingPointError, match="^update 20: a loss of seed 8 is not a number"):
        checked_losses(8, 1, losses, "update 20")


def test_the_command(
    config: OfflineConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train-offline", "--task", "brake", "--data", str(config.data)]
    rest = ["--out", str(tmp_path / "run"), "--updates", "5", "--episodes", "2"]
    assert main([*words, *rest, "--method.hidden", "8", "--seeds", "1"]) == 0
    assert "seed 1: ACR" in capsys.readouterr().out
    assert (tmp_path / "run" / "policies" / "seed1.safetensors").is_file()
    assert main([*words[:-1], str(tmp_path / "none"), *rest]) == 2
    assert capsys.readouterr().err == f"deep: {tmp_path / 'none'}: there is no such file\n"
