"""Algorithm 2 from end to end: the logs and results are what a recount of the replay gives."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import deep.train.run
from deep.data.normalisation import Normalisation
from deep.filter.safety_filter import SafetyFilter
from deep.filter.task_policy import TrainedPolicy
from deep.pretraining import RrlMsdpSettings, RrlSettings
from deep.tasks import Brake
from deep.train.config import TrainConfig
from deep.train.episodes import run_episodes
from deep.train.learner import NormalisationOf
from deep.train.noise import ActionNoise
from deep.train.run import train
from deep.train.sac import Sac
from deep.train.wcsac import Wcsac, WcsacSettings
from tests.deep.online_runs import (
    SEEDS,
    TINY,
    WRAPPED,
    blocking_filter,
    braking_filter,
    hand_made,
    pretrained,
    raw_replay,
    table,
)

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def corrected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pretraining run whose filters brake; the second seed's less readily."""
    filters = {0: braking_filter(), 3: braking_filter(0.8)}
    return hand_made(tmp_path_factory.mktemp("safety") / "run", filters)


@pytest.fixture(scope="module")
def rrl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = RrlSettings(hidden=(8,), batch_size=16)
    return pretrained(tmp_path_factory.mktemp("rrl"), settings)


def result(folder: Path) -> dict[str, object]:
    content: dict[str, object] = json.loads((folder / "result.json").read_text())
    return content


def recount(columns: Columns, k: int, copies: int, rhythm: list[int]) -> list[list[float]]:
    """The log's numbers from step to return and length, by one loop over the transitions."""
    rows: list[list[float]] = []
    total, length = np.zeros(copies), np.zeros(copies, dtype=int)
    episodes = violations = interventions = 0
    returns: list[float] = []
    lengths: list[float] = []
    for step in range(rhythm[-1] // copies):
        for n in range(copies):
            cost, terminal, timeout, reward, action, executed = (
                columns[name][k, step, n]
                for name in ("cost", "terminal", "timeout", "reward", "action", "executed")
            )
            violations += int(cost)
            interventions += int(action != executed)
            total[n] += reward
            length[n] += 1
            if terminal or timeout:
                episodes += 1
                returns.append(total[n])
                lengths.append(length[n])
                total[n] = length[n] = 0
        done = (step + 1) * copies
        if done in rhythm:
            since = done - (rows[-1][0] if rows else 0)
            rows.append(
                [done, episodes, violations, interventions / since,
                 float(np.mean(returns)), float(np.mean(lengths))]
            )  # fmt: skip
            interventions, returns, lengths = 0, [], []
    return rows


@pytest.mark.parametrize("behind", ["nothing", "filters"])
@pytest.mark.parametrize("log_every", [40, 100])
def test_the_logs_are_what_a_recount_gives(
    behind: str, log_every: int, corrected: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Brake, "time_limit", 7)
    safety = corrected if behind == "filters" else None
    config = replace(TINY, safety=safety, log_every=log_every)
    trained = train(config, tmp_path, quiet=True)
    columns = raw_replay(tmp_path, config)
    rows = table(tmp_path / "progress.csv")
    rhythm = [*range(log_every, 240, log_every), 240]  # the last row is the end
    assert [(int(row["step"]), int(row["seed"])) for row in rows] == [
        (step, seed) for step in rhythm for seed in SEEDS
    ]
    assert columns["timeout"][:, :60].sum() > 5
    assert not (columns["timeout"] * columns["terminal"]).any()
    for k, seed in enumerate(SEEDS):
        own = [row for row in rows if int(row["seed"]) == seed]
        expected = recount(columns, k, 4, rhythm)
        names = ("step", "episodes", "violations", "interventions", "return", "length")
        found = [[float(row[name]) for name in names] for row in own]
        assert np.array(found) == pytest.approx(np.array(expected), rel=1e-5)
        last = trained.seeds[k]
        assert last.seed == seed
        assert [last.episodes, last.tv] == expected[-1][1:3]
        replaced = columns["action"][k, :60] != columns["executed"][k, :60]
        assert last.training_arr == pytest.approx(replaced.mean())
        assert (replaced.sum() > 0) == (safety is not None)
    losses = [(row["critic_loss"], row["policy_loss"]) for row in rows]
    # Where the row's own step had an update.
    learning = [int(row["step"]) > 80 and (int(row["step"]) - 80) % 8 < 4 for row in rows]
    assert [loss != ("", "") for loss in losses] == learning
    assert all(np.isfinite([float(x) for x in loss]).all() for loss in losses if loss != ("", ""))


def test_the_transitions_are_algorithm_2s(corrected: Path, tmp_path: Path) -> None:
    config = replace(TINY, safety=corrected)
    train(config, tmp_path, quiet=True)
    columns = {name: column[:, :60] for name, column in raw_replay(tmp_path, config).items()}
    noise = ActionNoise(SEEDS, 4, 1)
    for k, seed in enumerate(SEEDS):
        path = corrected / "filters" / f"seed{seed}.safetensors"
        assert (tmp_path / "filters" / path.name).read_bytes() == path.read_bytes()  # frozen
        safety = SafetyFilter.load(path)
        # Every proposal is judged where it was made, and replaced by the recovery mean.
        s, a = columns["observation"][k].reshape(-1, 2), columns["action"][k].reshape(-1, 1)
        near = safety.q(s, a) >= safety.threshold
        executed = columns["executed"][k].reshape(-1)
        assert np.array_equal(executed[~near], a[~near, 0])
        assert executed[near] == pytest.approx(np.tanh(-5.0))
        assert near.reshape(60, 4)[:20].any()  # the start is corrected too
        # Uniform actions for 80 steps of 4 copies, then the policy's.
        uniform = np.array([noise.draw(step)[1][k, :, 0] for step in range(60)])
        assert np.array_equal(columns["action"][k, :20], uniform[:20])
        assert not (columns["action"][k, 20:] == uniform[20:]).any()
        assert abs(columns["action"][k]).max() <= 1
        # Where no episode ended the next observation is where the copy goes on.
        goes_on = (columns["terminal"][k] + columns["timeout"][k])[:-1] == 0
        following, before = columns["observation"][k, 1:], columns["next_observation"][k, :-1]
        assert np.array_equal(following[goes_on], before[goes_on])
        assert not (following[~goes_on] == before[~goes_on]).all(axis=-1).any()
        # What was executed is what happened.
        speed = (columns["observation"][k, ..., 1] + 1) * 4 + 2 * columns["executed"][k]
        moved = (columns["next_observation"][k, ..., 1] + 1) * 4
        assert moved == pytest.approx(np.clip(speed, 0, 8), abs=1e-5)
    assert [seed.threshold for seed in train(config, tmp_path).seeds] == [0.5, 0.8]


def test_a_filter_that_blocks_everything_and_one_that_blocks_nothing(tmp_path: Path) -> None:
    cases = {
        "all": (blocking_filter(5, 0.5), 1.0),
        "none": (blocking_filter(5, 1.0), 0.0),
        "certain": (blocking_filter(100, 1.0), 1.0),  # Q = 1 is not below 1
    }
    for name, (safety, share) in cases.items():
        folder = hand_made(tmp_path / f"{name}-safety", {0: safety})
        config = replace(TINY, seeds=(0,), safety=folder, steps=120, evaluate_every=120)
        (seed,) = train(config, tmp_path / name, quiet=True).seeds
        assert seed.arr == seed.training_arr == share
        assert {float(row["interventions"]) for row in table(tmp_path / name / "progress.csv")} == {
            share
        }
        assert {float(row["arr"]) for row in table(tmp_path / name / "evaluations.csv")} == {share}
        columns = {key: c[0, :30] for key, c in raw_replay(tmp_path / name, config).items()}
        if share == 1:
            assert columns["executed"] == pytest.approx(np.tanh(0.3))
        else:
            assert np.array_equal(columns["executed"], columns["action"])


def test_updates_are_made_in_their_rhythm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, int]] = []
    sample = deep.train.run.Replay.sample

    def spy(self: deep.train.run.Replay, update: int, steps: int, *rest: object) -> object:
        seen.append((update, steps * 4))
        return sample(self, update, steps, *rest)  # type: ignore[arg-type]  # passed through

    monkeypatch.setattr(deep.train.run.Replay, "sample", spy)
    train(replace(TINY, steps_per_update=3), tmp_path, quiet=True)
    assert [update for update, _ in seen] == list(range(53))  # 160 steps after the start
    for update, step in seen:
        assert step - 4 < 80 + 3 * (update + 1) <= step
    assert result(tmp_path)["budget"] == {
        "env_steps": 240,
        "updates": 53,
        "wall_seconds": result(tmp_path)["budget"]["wall_seconds"],  # type: ignore[index]
        "evaluation_episodes": 5,
    }


def test_results_are_the_saved_policies_behind_the_saved_filters(
    corrected: Path, tmp_path: Path
) -> None:
    for safety in (None, corrected):
        folder = tmp_path / str(safety is None)
        train(replace(TINY, safety=safety), folder, quiet=True)
        rows = table(folder / "evaluations.csv")
        assert [(int(r["step"]), int(r["seed"]), int(r["episodes"])) for r in rows] == [
            (step, seed, 3) for step in (120, 240) for seed in SEEDS
        ]
        for k, seed in enumerate(SEEDS):
            policy = TrainedPolicy.load(folder / "policies" / f"seed{seed}.safetensors")
            kept = folder / "filters" / f"seed{seed}.safetensors"
            assert kept.exists() == (safety is not None)
            gate = SafetyFilter.load(kept) if safety else None
            assert (policy.seed, policy.method) == (seed, result(folder)["method"])
            assert policy.method == ("dea-rrl-annealed" if safety else "sac")
            entry = result(folder)["seeds"][k]  # type: ignore[index]
            at_end = run_episodes("brake", policy.act, gate, 5, seed)
            assert [entry[n] for n in ("acr", "avr", "arr", "length")] == [
                at_end.acr, at_end.avr, at_end.arr, at_end.length
            ]  # fmt: skip
            during = run_episodes("brake", policy.act, gate, 3, seed + 1000)  # others
            last = [float(rows[-2 + k][n]) for n in ("acr", "avr", "arr", "length")]
            assert last == pytest.approx(
                [during.acr, during.avr, during.arr, during.length], rel=1e-5
            )


def test_the_saved_policy_is_the_mean_of_the_learned_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learners: list[Sac] = []

    class Kept(Sac):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments)  # type: ignore[arg-type]  # passed through
            learners.append(self)

    monkeypatch.setattr("deep.train.config.Sac", Kept)
    train(TINY, tmp_path, quiet=True)
    start = raw_replay(tmp_path, TINY)["observation"][:, :20].reshape(2, 80, 2)
    for k, seed in enumerate(SEEDS):
        policy = TrainedPolicy.load(tmp_path / "policies" / f"seed{seed}.safetensors")
        # Without a pretraining run, observations are normalised by those of the start.
        units = policy.normalisation
        assert units.observation_centre == pytest.approx(start[k].mean(axis=0), rel=1e-5)
        assert units.observation_scale == pytest.approx(start[k].std(axis=0), rel=1e-5)
        scaled = (start - start[k].mean(axis=0)) / start[k].std(axis=0)
        with torch.no_grad():
            mean = learners[0].policy.mean_action(torch.from_numpy(scaled.astype(np.float32)))
        assert policy.act(start[k]) == pytest.approx(mean[k].numpy(), abs=1e-5)


def test_behind_filters_the_policy_has_a_normalisation_of_its_own(tmp_path: Path) -> None:
    from tests.deep.filters import linear_filter

    units = Normalisation((0.2, -0.3), (0.5, 2.0), (0.0,), (1.0,))
    safety = linear_filter([-4.0, 4.0], 2.0, -1.0, -5.0, normalisation=units)
    folder = hand_made(tmp_path / "safety", {0: safety})
    train(replace(TINY, seeds=(0,), safety=folder), tmp_path / "run", quiet=True)
    kept = SafetyFilter.load(tmp_path / "run" / "filters" / "seed0.safetensors")
    assert kept.normalisation == units
    path = tmp_path / "run" / "policies" / "seed0.safetensors"
    own = TrainedPolicy.load(path).normalisation
    assert own != units
    # Those of its start phase: an uncorrected run's start is another, a second run's the same.
    train(replace(TINY, seeds=(0,), safety=folder), tmp_path / "again", quiet=True)
    again = TrainedPolicy.load(tmp_path / "again" / "policies" / "seed0.safetensors")
    assert again.normalisation == own


def assert_same_run(both: Path, alone: Path, seed: int) -> None:
    """Counts exactly, floats up to the rounding of a batched product."""
    exact = ("step", "seed", "episodes", "violations", "interventions", "length")
    for log in ("progress.csv", "evaluations.csv"):
        own = [row for row in table(both / log) if int(row["seed"]) == seed]
        one = table(alone / log)
        assert len(own) == len(one) > 1
        for row, other in zip(own, one, strict=True):
            for name, value in row.items():
                if name in exact or not value:
                    assert other[name] == value, name
                else:
                    assert float(other[name]) == pytest.approx(float(value), rel=5e-3), name
    paths = [folder / "policies" / f"seed{seed}.safetensors" for folder in (both, alone)]
    observations = np.random.default_rng(0).uniform(-1, 1, (50, 2)).astype(np.float32)
    actions = [TrainedPolicy.load(path).act(observations) for path in paths]
    assert actions[0] == pytest.approx(actions[1], abs=1e-4)


def test_a_seed_of_a_batch_is_the_seed_alone(tmp_path: Path) -> None:
    train(WRAPPED, tmp_path / "both", quiet=True)
    train(replace(WRAPPED, seeds=(3,)), tmp_path / "alone", quiet=True)
    assert_same_run(tmp_path / "both", tmp_path / "alone", 3)


def test_a_finetuned_seed_of_a_batch_is_the_seed_alone(rrl: Path, tmp_path: Path) -> None:
    config = replace(TINY, safety=rrl, threshold=(0.5,))
    both = train(config, tmp_path / "both", quiet=True)
    alone = train(replace(config, seeds=(3,)), tmp_path / "alone", quiet=True)
    assert 0 < both.seeds[1].training_arr < 1
    assert both.seeds[1].training_arr == alone.seeds[0].training_arr
    assert_same_run(tmp_path / "both", tmp_path / "alone", 3)
    filters = [
        SafetyFilter.load(tmp_path / name / "filters" / "seed3.safetensors")
        for name in ("both", "alone")
    ]
    for (w, _), (v, _) in zip(filters[0].critic, filters[1].critic, strict=True):
        assert w == pytest.approx(v, abs=1e-4)
    before = SafetyFilter.load(rrl / "filters" / "seed3.safetensors")
    assert not np.array_equal(filters[0].critic[0][0], before.critic[0][0])  # RRL's change
    assert not np.array_equal(filters[0].recovery[0][0], before.recovery[0][0])
    assert (both.method, filters[0].threshold) == ("rrl", 0.5)


def test_finetuning_begins_with_the_first_update(tmp_path: Path, rrl: Path) -> None:
    config = replace(TINY, seeds=(0,), safety=rrl, steps=80, evaluate_every=80)
    train(config, tmp_path / "start", quiet=True)
    kept, found = (
        SafetyFilter.load(folder / "filters" / "seed0.safetensors")
        for folder in (rrl, tmp_path / "start")
    )
    assert np.array_equal(kept.critic[0][0], found.critic[0][0])


def test_other_learners_and_corrections_run_too(tmp_path: Path, rrl: Path) -> None:
    settings = WcsacSettings(hidden=(8,), batch_size=16, cost_limit=(0.3, 0.1), sharpness=24)
    wcsac = train(replace(TINY, method=settings), tmp_path / "wcsac", quiet=True)
    assert wcsac.method == "wcsac"
    assert [seed.threshold for seed in wcsac.seeds] == [0.3, 0.1]
    frozen = replace(TINY, seeds=(0,), safety=rrl, finetune=False)
    assert train(frozen, tmp_path / "frozen", quiet=True).method == "rrl"
    path = Path("filters") / "seed0.safetensors"
    assert (tmp_path / "frozen" / path).read_bytes() == (rrl / path).read_bytes()
    msdp = pretrained(tmp_path / "msdp", RrlMsdpSettings(hidden=(8,), batch_size=16))
    config = replace(TINY, seeds=(0,), safety=msdp, threshold=(0.4,))
    assert train(config, tmp_path / "msdp-run", quiet=True).method == "rrl-msdp"
    assert (tmp_path / "msdp-run" / path).read_bytes() != (msdp / path).read_bytes()


def test_a_learner_is_told_once_how_observations_are_normalised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[list[Sequence[Normalisation]]] = []
    look = Wcsac.look

    def watched(self: Wcsac, normalisation: NormalisationOf) -> None:
        told.append([normalisation(power) for power in (1.0, 24.0)])
        look(self, normalisation)

    monkeypatch.setattr(Wcsac, "look", watched)
    settings = WcsacSettings(hidden=(8,), batch_size=16, sharpness=24)
    train(replace(TINY, method=settings), tmp_path, quiet=True)
    ((plain, sharp),) = told
    for k, seed in enumerate(SEEDS):
        policy = TrainedPolicy.load(tmp_path / "policies" / f"seed{seed}.safetensors")
        assert policy.normalisation == plain[k]
        assert len(sharp[k].observation_power) == 2


def test_a_finished_run_is_only_read_and_forgets_its_replay(tmp_path: Path) -> None:
    config = replace(TINY, keep_replay=False)
    first = train(config, tmp_path, quiet=True)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "config.json", "progress.csv", "evaluations.csv", "checkpoint.safetensors", "policies",
        "result.json",
    }  # fmt: skip
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = train(config, tmp_path, quiet=True)
    assert (again.seeds, again.method, again.folder) == (first.seeds, "sac", tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == stamps
    made = json.loads((tmp_path / "config.json").read_text())["made with"]
    assert made == result(tmp_path)["made with"]
    assert {"numpy", "torch", "python", "git"} <= set(made)


def test_another_run_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    train(TINY, tmp_path, quiet=True)
    with pytest.raises(ValueError, match="holds a run with another configuration$"):
        train(replace(TINY, steps=280), tmp_path, quiet=True)


def not_a_number_after(updates: int, monkeypatch: pytest.MonkeyPatch) -> None:
    update = Sac.update

    def poisoned(self: Sac, batch: object) -> object:
        losses = update(self, batch)  # type: ignore[arg-type]  # passed through
        if poisoned.count == updates:  # type: ignore[attr-defined]  # counts its calls
            losses.critic[1] = torch.nan
            with torch.no_grad():
                self.policy.mlp.biases[0][1] = torch.nan
        poisoned.count += 1  # type: ignore[attr-defined]  # counts its calls
        return losses

    poisoned.count = 0  # type: ignore[attr-defined]  # counts its calls
    monkeypatch.setattr(Sac, "update", poisoned)


@pytest.mark.parametrize("log_every", [40, 240])
def test_a_loss_that_is_no_number_stops_the_run_and_keeps_the_checkpoint(
    log_every: int, tmp_path: Path
) -> None:
    config: TrainConfig = replace(TINY, log_every=log_every, steps_per_update=4)
    with pytest.MonkeyPatch.context() as patch:
        not_a_number_after(15, patch)  # step 144 of 240; the checkpoint before it: 120
        with pytest.raises(FloatingPointError, match="a loss of seed 3 is not a number; try a"):
            train(config, tmp_path / "run", quiet=True)
    train(config, tmp_path / "run", quiet=True)
    train(config, tmp_path / "whole", quiet=True)
    for seed in SEEDS:
        name = Path("policies") / f"seed{seed}.safetensors"
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
