"""The paper's offline data, and policies behind filters that they have never met."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from deep.__main__ import main
from deep.data.formats import read_hdf5
from deep.data.transitions import keep_before_violation
from deep.filter.task_policy import TrainedPolicy
from deep.runs.folder import read_object
from deep.tasks.gym import Rules
from deep.tasks.vectorised import FOREIGN_COPIES
from deep.train.episodes import run_episodes
from deep.train.evaluation import evaluate_policies
from deep.train.offline_data import offline_data, replayed
from deep.train.run import train
from tests.deep.online_runs import SEEDS, TINY, WRAPPED, blocking_filter, hand_made, same


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of SAC on the brake that kept its replay buffer."""
    folder = tmp_path_factory.mktemp("runs") / "sac"
    train(TINY, folder, quiet=True)
    return folder


def test_the_replay_holds_every_step_of_the_seed(run: Path) -> None:
    data = replayed(run, SEEDS[1])
    assert len(data) == TINY.steps
    result = json.loads((run / "result.json").read_text())
    assert int(data.costs.sum()) == result["seeds"][1]["tv"]
    # A copy's next observation is its next row's observation, except where an episode ended.
    goes_on = ~data.ends[:-1]
    assert np.array_equal(data.next_observations[:-1][goes_on], data.observations[1:][goes_on])


def test_the_mixture_is_what_lies_before_violations_of_both(run: Path) -> None:
    rng = np.random.default_rng(5)
    data = offline_data("brake", run, SEEDS[0], random=300, keep=3, rng=rng)
    own = keep_before_violation(replayed(run, SEEDS[0]), 3)
    assert np.array_equal(data.observations[: len(own)], own.observations)
    assert len(data) > len(own)
    steps = np.diff(np.concatenate([[-1], np.flatnonzero(data.ends)]))
    assert steps.max() <= 3
    assert (data.costs[data.ends] == 1).all()


def test_without_random_actions_and_filter_it_is_the_replay(run: Path) -> None:
    rng = np.random.default_rng(5)
    data = offline_data("brake", run, SEEDS[0], random=0, keep=None, rng=rng)
    assert np.array_equal(data.observations, replayed(run, SEEDS[0]).observations)


def test_the_command_writes_what_the_function_gives(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "data.hdf5"
    given = ["--run-folder", str(run), "--seed", "3", "--random", "300", "--keep", "3"]
    assert main(["offline-data", "--out", str(out), *given]) == 0
    expected = offline_data("brake", run, 3, 300, 3, np.random.default_rng(3))
    assert same(read_hdf5(out), expected)


class Coin(gymnasium.Env[np.ndarray, np.ndarray]):
    """Counts its steps; a cost with probability 1/4, the end of the clock after five."""

    observation_space = spaces.Box(0.0, 9.0, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  (Gymnasium's signature)
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, dtype=np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        cost = float(self.np_random.random() < 0.25)
        observation = np.array([self.steps], dtype=np.float32)
        return observation, float(action[0]), False, self.steps == 5, {"cost": cost}


@pytest.fixture
def coin() -> Iterator[str]:
    gymnasium.register(
        "Coin-v0", entry_point=lambda **_: Coin(), disable_env_checker=True, max_episode_steps=9
    )
    yield "gym:Coin-v0"
    del gymnasium.registry["Coin-v0"]


def test_foreign_environments_give_random_transitions_too(coin: str, tmp_path: Path) -> None:
    train(replace(TINY, task=coin), tmp_path / "run", quiet=True)
    data = offline_data(coin, tmp_path / "run", 0, 203, None, np.random.default_rng(5))
    fresh = data.take(np.arange(TINY.steps, len(data)))
    assert len(fresh) == 204  # four copies, as many steps each
    assert fresh.actions.shape == (204, 2)
    assert len(np.unique(fresh.actions)) > 400
    assert -1 <= fresh.actions.min() < -0.95
    assert 0.95 < fresh.actions.max() < 1
    assert np.array_equal(fresh.rewards, fresh.actions[:, 0])
    # Whole episodes one after another: each begins at 0, and ends at a cost or the fifth step.
    begins = np.append(True, fresh.ends[:-1])
    assert np.array_equal(fresh.observations[:, 0] == 0, begins)
    assert np.array_equal(fresh.next_observations, fresh.observations + 1)
    assert np.array_equal(fresh.terminals, fresh.costs == 1)
    late = (fresh.next_observations[:, 0] == 5) & ~fresh.terminals
    late[50::51] |= ~fresh.terminals[50::51]  # a copy's recording ends
    assert np.array_equal(fresh.timeouts, late)
    again = offline_data(coin, tmp_path / "run", 0, 203, None, np.random.default_rng(5))
    assert same(data, again)
    other = offline_data(coin, tmp_path / "run", 0, 203, None, np.random.default_rng(6))
    assert not np.array_equal(other.actions, data.actions)


def test_foreign_environments_are_collected_from(coin: str, tmp_path: Path) -> None:
    out = tmp_path / "coin.hdf5"
    given = ["collect", "--task", coin, "--transitions", "60", "--seed", "3"]
    mix = ["--random", "0.25", "--corners", "0.75", "--keep", "2"]
    assert main([*given, *mix, "--out", str(out)]) == 0
    data = read_hdf5(out)
    assert len(data) == 60
    steps = np.diff(np.flatnonzero(data.ends), prepend=-1)
    assert steps.max() == 2
    assert (np.abs(data.actions[:15]) < 1).all()
    assert (np.abs(data.actions[15:]) == 1).all()
    assert np.array_equal(data.rewards, data.actions[:, 0])
    again = tmp_path / "again.hdf5"
    assert main([*given, *mix, "--out", str(again)]) == 0
    assert same(read_hdf5(again), data)


def test_what_only_tasks_know_is_refused_for_others(
    coin: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["collect", "--task", coin, "--out", str(tmp_path / "x"), "--transitions", "9"]
    for option in (["--anywhere"], ["--adversary", "0.5"], ["--max-steps", "3"]):
        assert main([*given, *option]) == 2
        assert "gym:Coin-v0: adversary, anywhere and max_steps are for" in capsys.readouterr().err
    assert main([*given, "--random", "0.5", "--corners", "0.4"]) == 2
    assert "shares must be positive and sum to 1, not to 0.9" in capsys.readouterr().err
    pendulum = ["collect", "--task", "gym:Pendulum-v1", "--out", str(tmp_path / "x")]
    assert main(pendulum) == 2
    assert "give --termination-is-violation" in capsys.readouterr().err
    assert main([*pendulum, "--transitions", "9", "--termination-is-violation"]) == 2
    said = "Pendulum-v1: of 2,044 transitions too few lie within 100 steps before a violation"
    assert said in capsys.readouterr().err
    assert main(["collect", "--task", "brake", "--out", "x", "--time-limit", "3"]) == 2
    assert "brake knows its violations and its time limit" in capsys.readouterr().err
    assert main(["pretrain", "--task", coin, "--out", str(tmp_path / "x")]) == 2
    assert "make a file with collect or offline-data" in capsys.readouterr().err


class Jammed(Coin):
    """Breaks in its second step."""

    closed = 0

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if self.steps:
            raise RuntimeError(f"jammed at {action}")
        return super().step(action)

    def close(self) -> None:
        Jammed.closed += 1


def test_environments_that_break_are_closed(run: Path) -> None:
    gymnasium.register(
        "Jammed-v0", entry_point=lambda **_: Jammed(), disable_env_checker=True, max_episode_steps=9
    )
    try:
        begun = Jammed.closed
        with pytest.raises(RuntimeError, match="jammed at") as caught:
            offline_data("gym:Jammed-v0", run, 0, 8, None, np.random.default_rng(0))
        assert Jammed.closed - begun == 5  # one was tried before; the traceback holds on to them
        assert caught.tb is not None
    finally:
        del gymnasium.registry["Jammed-v0"]


def test_runs_without_a_buffer_are_refused(run: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"there is no run here \(no config.json\)"):
        offline_data("brake", tmp_path, 0, 0, None, rng)
    with pytest.raises(ValueError, match=r"there is no seed 1, only \[0, 3\]"):
        offline_data("brake", run, 1, 0, None, rng)
    forgetful = tmp_path / "forgetful"
    train(replace(TINY, keep_replay=False), forgetful, quiet=True)
    with pytest.raises(ValueError, match="not a finished run that kept its replay buffer"):
        offline_data("brake", forgetful, 0, 0, None, rng)


def test_data_that_cannot_be_are_named(run: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="^random must not be negative, not -1$"):
        offline_data("brake", run, 0, -1, None, rng)
    nothing = "costs: there is no violation in the data, so nothing to learn from$"
    with pytest.raises(ValueError, match=f"^navigation2, 4 random actions: {nothing}"):
        offline_data("navigation2", run, 0, 4, None, rng)
    silent = "Pendulum-v1: its steps report no info"
    with pytest.raises(ValueError, match=f"^gym:Pendulum-v1, 4 random actions: {silent}"):
        offline_data("gym:Pendulum-v1", run, 0, 4, None, rng)
    harmless = tmp_path / "harmless"
    shutil.copytree(run, harmless)
    columns = np.fromfile(harmless / "replay.bin", dtype=np.float32).reshape(-1, 10)
    columns[:, 7:9] = 0  # costs and ends
    columns.tofile(harmless / "replay.bin")
    with pytest.raises(ValueError, match=f"harmless: seed 3: {nothing}"):
        offline_data("brake", harmless, 3, 0, None, rng)
    (harmless / "result.json").unlink()
    with pytest.raises(ValueError, match="harmless: not a finished run that kept its replay"):
        offline_data("brake", harmless, 3, 0, None, rng)
    forgetful = tmp_path / "wrapped"
    train(WRAPPED, forgetful, quiet=True)
    message = "wrapped: seed 0: the replay buffer holds 35 steps, not 60$"
    with pytest.raises(ValueError, match=message):
        offline_data("brake", forgetful, 0, 0, None, rng)


def test_a_policy_alone_and_behind_filters(run: Path, tmp_path: Path) -> None:
    policy = TrainedPolicy.load(run / "policies" / "seed3.safetensors")
    alone = evaluate_policies(run, None, tmp_path / "alone", episodes=6)
    found = run_episodes("brake", policy.act, None, 6, 3)
    assert (alone[1].acr, alone[1].avr, alone[1].arr) == (found.acr, found.avr, 0.0)
    assert alone[1].threshold is None

    blocking = hand_made(tmp_path / "critics", {seed: blocking_filter(0.0, 0.4) for seed in SEEDS})
    plugged = evaluate_policies(run, blocking, tmp_path / "plugged", episodes=6)
    assert [entry.arr for entry in plugged] == [1.0, 1.0]
    content = json.loads((tmp_path / "plugged" / "result.json").read_text())
    assert content["method"] == f"sac+{blocking_filter(0.0, 0.4).method}"
    assert content["task"] == "brake"
    assert [entry["threshold"] for entry in content["seeds"]] == [0.4, 0.4]
    assert content["budget"]["evaluation_episodes"] == 6
    trained = json.loads((run / "result.json").read_text())["budget"]
    for name in ("env_steps", "updates"):
        assert content["budget"][name] == trained[name] > 0
    paths = (content["policies"], content["safety"])
    assert paths == (str(run), str(blocking))

    # Each policy has the filter of its own seed.
    own = {SEEDS[0]: blocking_filter(0.0, 0.4), SEEDS[1]: blocking_filter(0.0, 0.6)}
    each = hand_made(tmp_path / "each", own)
    found_each = evaluate_policies(run, each, tmp_path / "plugged-each", episodes=6)
    assert [entry.arr for entry in found_each] == [1.0, 0.0]

    # Q = 1/2 everywhere: at another threshold nothing is blocked.
    free = evaluate_policies(run, blocking, tmp_path / "free", threshold=0.6, episodes=6)
    assert [entry.arr for entry in free] == [0.0, 0.0]
    assert [entry.acr for entry in free] == [entry.acr for entry in alone]


def test_a_policy_is_evaluated_where_it_was_not_trained(run: Path, tmp_path: Path) -> None:
    elsewhere = "gym:MountainCarContinuous-v0"  # of the same dimensions as the brake
    rules = Rules(termination_is_violation=True, time_limit=150)
    found = evaluate_policies(run, None, tmp_path / "out", episodes=2, task=elsewhere, rules=rules)
    policy = TrainedPolicy.load(run / "policies" / "seed3.safetensors")
    expected = run_episodes(elsewhere, policy.act, None, 2, 3, FOREIGN_COPIES, rules)
    assert (found[1].acr, found[1].length) == (expected.acr, expected.length)
    assert json.loads((tmp_path / "out" / "result.json").read_text())["task"] == elsewhere


def test_an_environment_keeps_the_rules_of_its_training(tmp_path: Path) -> None:
    rules = Rules(termination_is_violation=True, time_limit=20)
    config = replace(TINY, task="gym:Pendulum-v1", rules=rules)
    train(config, tmp_path / "run", quiet=True)
    found = evaluate_policies(tmp_path / "run", None, tmp_path / "out", episodes=2)
    assert {entry.length for entry in found} == {20}
    given = ["evaluate", "--policy", str(tmp_path / "run"), "--episodes", "2"]
    options = ["--out", str(tmp_path / "other"), "--termination-is-violation", "--time-limit", "9"]
    assert main([*given, *options]) == 0
    assert read_object(tmp_path / "other" / "result.json", "seeds")["seeds"][0]["length"] == 9


def test_thresholds_come_from_files_too(run: Path, tmp_path: Path) -> None:
    blocking = hand_made(tmp_path / "critics", {seed: blocking_filter(0.0, 0.4) for seed in SEEDS})
    (tmp_path / "t.json").write_text('{"threshold": 0.7}')
    given = ["evaluate", "--policy", str(run), "--safety", str(blocking), "--episodes", "4"]
    out = ["--out", str(tmp_path / "out"), "--threshold-from", str(tmp_path / "t.json")]
    assert main([*given, *out]) == 0
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [entry["threshold"] for entry in content["seeds"]] == [0.7, 0.7]
    assert main([*given, *out, "--threshold", "0.5"]) == 2


def test_an_unfinished_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"not a finished run \(no result.json\)"):
        evaluate_policies(tmp_path, None, tmp_path / "out")
