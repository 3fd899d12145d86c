"""Runs: resumable at any moment with the same result, and honest about what went wrong."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import deep
from deep.__main__ import main, parse
from deep.cli.pretrain import Pretrain
from deep.data.formats import read_hdf5, write_hdf5
from deep.data.minibatches import Batches
from deep.data.normalisation import Normalisation, normalisation_of, normalise
from deep.data.transitions import Transitions
from deep.filter.safety_filter import SafetyFilter
from deep.filter.thresholds import discount_from_horizon, low_threshold, paper_threshold
from deep.pretraining import (
    FORMS,
    DeaRrlAnnealedSettings,
    DeaRrlSettings,
    Form,
    RrlMsdpSettings,
    Sizes,
    build_learner,
    form_of,
)
from deep.pretraining.config import Mix, PretrainConfig, config_from_json, config_to_json, resolve
from deep.pretraining.health import Fault, check_losses, read_health
from deep.pretraining.learner import Losses
from deep.pretraining.run import DATA_STREAM, pretrain_in_folder, read_run
from deep.runs.checkpoint import load_checkpoint, save_checkpoint
from deep.runs.forms import FORM_ROWS
from deep.tasks import make_task
from deep.tasks.bounds import Bounds

SMALL = {"hidden": (8,), "batch_size": 16}
TINY = PretrainConfig(
    task="brake",
    method=DeaRrlAnnealedSettings(**SMALL),
    seeds=(0, 3),
    updates=40,
    mix=Mix(transitions=400),
    log_every=10,
    checkpoint_every=15,
)


def filter_bytes(folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted((folder / "filters").iterdir())]


def progress(folder: Path) -> list[dict[str, str]]:
    with (folder / "progress.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def test_a_run_leaves_everything_that_is_needed(tmp_path: Path) -> None:
    result = pretrain_in_folder(TINY, tmp_path / "run", quiet=True)
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["run"]["gamma_safe"] == 0.75
    assert config["run"]["threshold"] == 0.75**3 / 4
    assert config["run"]["horizon"] == 3
    assert config["run"]["method"]["name"] == "dea-rrl-annealed"
    assert {"numpy", "torch", "python", "git"} <= set(config["made with"])
    rows = progress(tmp_path / "run")
    assert [(row["update"], row["seed"]) for row in rows] == [
        (str(update), seed) for update in (10, 20, 30, 40) for seed in ("0", "3")
    ]
    assert read_run(tmp_path / "run") == resolve(TINY, 3)
    loaded = SafetyFilter.load(tmp_path / "run" / "filters" / "seed3.safetensors")
    assert loaded.threshold == result.filters[1].threshold == 0.75**3 / 4
    assert [health.seed for health in result.health] == [0, 3]
    assert read_health(tmp_path / "run") == result.health
    assert loaded.actions == Bounds.unit(1)
    assert loaded.observations == result.filters[1].observations


def test_a_finished_run_is_not_trained_again(tmp_path: Path) -> None:
    pretrain_in_folder(TINY, tmp_path / "run", quiet=True)
    before = filter_bytes(tmp_path / "run")
    stamp = (tmp_path / "run" / "checkpoint.safetensors").stat().st_mtime_ns
    pretrain_in_folder(TINY, tmp_path / "run", quiet=True)
    assert filter_bytes(tmp_path / "run") == before
    assert (tmp_path / "run" / "checkpoint.safetensors").stat().st_mtime_ns == stamp


def test_another_run_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    pretrain_in_folder(TINY, tmp_path / "run", quiet=True)
    with pytest.raises(ValueError, match="holds a run with another configuration"):
        pretrain_in_folder(replace(TINY, updates=41), tmp_path / "run", quiet=True)
    with pytest.raises(ValueError, match="there is no run here"):
        read_run(tmp_path)


@pytest.mark.parametrize("method", FORMS)
def test_checkpoints_hold_the_whole_state(method: str, tmp_path: Path) -> None:
    config = replace(TINY, method=FORMS[method].settings(**SMALL))
    pretrain_in_folder(config, tmp_path / "whole", quiet=True)
    # The same run, stopped after 15 updates: its checkpoint, and a half-written log.
    learner = build_learner(resolve(config, 3).method, Sizes(2, 1), config.seeds)
    stopped = tmp_path / "stopped"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deep.pretraining.run.save_checkpoint", _stop_after_saving)
        with pytest.raises(_Stopped):
            pretrain_in_folder(config, stopped, quiet=True)
    assert load_checkpoint(learner, stopped / "checkpoint.safetensors") == (15, "")
    with (stopped / "progress.csv").open("a") as file:
        file.write("20,0,0.1,0.1,0.1,0.1,9\n20,3,0.")
    pretrain_in_folder(config, stopped, quiet=True)
    assert filter_bytes(stopped) == filter_bytes(tmp_path / "whole")
    assert progress(stopped) == progress(tmp_path / "whole")


class _Stopped(Exception):
    pass


def _stop_after_saving(*arguments: object) -> None:
    save_checkpoint(*arguments)  # type: ignore[arg-type]  # passed through
    raise _Stopped


COMMAND = [
    *(sys.executable, "-m", "deep", "pretrain", "--task", "brake", "--seeds", "0", "3"),
    *("--updates", "600", "--checkpoint-every", "7", "--log-every", "50"),
    *("--mix.transitions", "400", "dea-rrl-annealed"),
    *("--hidden", "8", "--batch-size", "16"),
]
FROM_COMMAND = replace(TINY, updates=600, checkpoint_every=7, log_every=50)


def start(folder: Path) -> subprocess.Popen[str]:
    """The command, from the moment on at which it has written a further checkpoint."""
    checkpoint = folder / "checkpoint.safetensors"
    before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
    process = subprocess.Popen(
        [*COMMAND[:4], "--out", str(folder), *COMMAND[4:]],
        cwd=Path(__file__).parents[3],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    while not (checkpoint.exists() and checkpoint.stat().st_mtime_ns > before):
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.002)
    return process


def test_a_run_that_is_killed_and_interrupted_ends_as_if_nothing_had_happened(
    tmp_path: Path,
) -> None:
    pretrain_in_folder(FROM_COMMAND, tmp_path / "whole", quiet=True)
    folder = tmp_path / "killed"
    process = start(folder)
    process.kill()
    process.communicate()
    process = start(folder)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode == 130, errors
    assert "deep: interrupted; the same command goes on from here" in errors
    rows = progress(folder)
    assert 0 < int(rows[-1]["update"]) < 600  # saved where it was, and not finished
    pretrain_in_folder(FROM_COMMAND, folder, quiet=True)
    assert filter_bytes(folder) == filter_bytes(tmp_path / "whole")
    logged = [row for row in progress(folder) if int(row["update"]) % 50 == 0]
    assert logged == progress(tmp_path / "whole")


def test_a_loss_that_is_no_number_stops_the_run_and_keeps_the_checkpoint(tmp_path: Path) -> None:
    config = replace(TINY, updates=30, checkpoint_every=5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deep.pretraining.run.save_checkpoint", _stop_after_saving)
        with pytest.raises(_Stopped):
            pretrain_in_folder(config, tmp_path / "run", quiet=True)
    path = tmp_path / "run" / "checkpoint.safetensors"
    learner = build_learner(resolve(config, 3).method, Sizes(2, 1), config.seeds)
    load_checkpoint(learner, path)
    with torch.no_grad():
        learner.critic.mlp.weights[0][-1] = torch.nan  # a network of seed 3
    save_checkpoint(learner, 5, path)
    broken = path.read_bytes()
    with pytest.raises(FloatingPointError, match="update 10: the critic loss of seed 3 is nan"):
        pretrain_in_folder(config, tmp_path / "run", quiet=True)
    assert path.read_bytes() == broken


def test_broken_checkpoints_are_refused(tmp_path: Path) -> None:
    learner = build_learner(DeaRrlSettings(**SMALL), Sizes(2, 1), (0,))
    path = tmp_path / "checkpoint.safetensors"
    path.write_text("no")
    with pytest.raises(ValueError, match="not a checkpoint of this run"):
        load_checkpoint(learner, path)
    save_checkpoint(build_learner(RrlMsdpSettings(**SMALL), Sizes(2, 1), (0,)), 3, path)
    with pytest.raises(ValueError, match="not a checkpoint of this run"):
        load_checkpoint(learner, path)


def test_a_loss_that_is_no_number_names_its_seed() -> None:
    learner = build_learner(DeaRrlAnnealedSettings(), Sizes(2, 1), (0, 1, 2, 3))
    losses = Losses(torch.zeros(4), torch.tensor([0.0, torch.inf, 0, 0]), torch.zeros(4))
    with pytest.raises(FloatingPointError, match="update 7: the value loss of seed 1 is inf"):
        check_losses(learner, losses, 7)


@pytest.mark.parametrize("form", FORMS.values(), ids=list(FORMS))
def test_a_form_is_a_file_and_a_row(form: Form) -> None:
    """The command line takes its name, a run keeps it, and no other module need know it."""
    home = Path(deep.__file__).parent
    naming = {path for path in home.rglob("*.py") if f'"{form.name}"' in path.read_text()}
    elsewhere = {home / "study" / "paper_results.py", home / "runs" / "forms.py"}
    assert list(FORM_ROWS) == list(FORMS)
    assert FORM_ROWS[form.name].from_horizon == (form.discount is not None)
    assert naming - elsewhere == {Path(str(sys.modules[form.learner.__module__].__file__))}
    assert form_of(form.settings()) is form
    assert form.build(form.settings(), Sizes(2, 1), (0,)).name == form.name
    command = parse(["pretrain", "--task", "brake", "--out", "x", form.name])
    assert isinstance(command, Pretrain)
    assert type(command.run_config.method) is form.settings
    assert config_to_json(command.run_config)["method"]["name"] == form.name


def test_configurations_survive_json_and_resolve_by_the_horizon() -> None:
    for kind in (form.settings for form in FORMS.values()):
        config = replace(TINY, method=kind(**SMALL))
        filed = replace(config, task=None, data=Path("x"), cut=True, violation="cost > 2")
        for one in (config, filed):
            assert config_from_json(json.loads(json.dumps(config_to_json(one)))) == one
    annealed = resolve(TINY, 5)
    assert annealed.gamma_safe == annealed.method.gamma_safe == 5 / 6
    assert annealed.threshold == low_threshold(5 / 6, 5) == (5 / 6) ** 5 / 4
    paper = resolve(replace(TINY, method=DeaRrlSettings()), 5)
    assert paper.gamma_safe == 0.99
    assert paper.threshold == paper_threshold(0.99, 5) == 0.99**5.5
    given = resolve(replace(TINY, gamma_safe=0.9, threshold=0.2), None)
    assert (given.gamma_safe, given.threshold, given.horizon) == (0.9, 0.2, None)
    assert resolve(replace(TINY, horizon=2), 5).horizon == 2
    with pytest.raises(ValueError, match="give the horizon"):
        resolve(replace(TINY, threshold=0.2), None)
    with pytest.raises(ValueError, match="not the configuration of a run"):
        config_from_json({"method": {"name": "sac"}})
    plain = config_to_json(TINY)
    for entry in ("seeds", "sharpness"):
        lacking = {name: value for name, value in plain.items() if name != entry}
        with pytest.raises(ValueError, match=f"of a run: '{entry}' is missing$"):
            config_from_json(lacking)


def test_the_discount_from_the_horizon_leaves_the_largest_residual() -> None:
    for horizon in (1, 3, 10):
        gammas = np.linspace(0.01, 0.99, 9_801)
        best = gammas[np.argmax((1 - gammas) * gammas**horizon)]
        assert discount_from_horizon(horizon) == pytest.approx(best, abs=2e-4)
    assert discount_from_horizon(0) == 0.5
    with pytest.raises(ValueError, match="horizon must not be negative"):
        discount_from_horizon(-1)


BAD_SETTINGS = {
    "expectile must lie in": lambda: DeaRrlSettings(expectile=1.0),
    "gamma_safe must lie in": lambda: DeaRrlSettings(gamma_safe=1.1),
    "batch_size must be positive": lambda: DeaRrlSettings(batch_size=0),
    "entropy_weight must not be negative": lambda: DeaRrlSettings(entropy_weight=-1.0),
    "violation_share must lie in": lambda: DeaRrlSettings(violation_share=2.0),
    "final_expectile must lie in": lambda: DeaRrlAnnealedSettings(final_expectile=0.0),
    "either a task or a data file": PretrainConfig,
    "updates must be at least 1": lambda: replace(TINY, updates=0),
    "device must be cpu or cuda, not 'tpu'": lambda: replace(TINY, device="tpu"),
    "seeds must be distinct": lambda: build_learner(DeaRrlSettings(), Sizes(2, 1), (1, 1)),
}


@pytest.mark.parametrize("message", BAD_SETTINGS)
def test_bad_settings_are_refused(message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BAD_SETTINGS[message]()


def test_a_missing_cuda_device_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(ValueError, match="device cuda: this machine or this build"):
        pretrain_in_folder(replace(TINY, device="cuda"), tmp_path / "run", quiet=True)


def test_the_schedules_of_the_recipe() -> None:
    settings = DeaRrlAnnealedSettings(first_expectile=0.4, final_expectile=0.1, anneal=0.5)
    assert [settings.expectile(p) for p in (0.0, 0.25, 0.5, 0.9)] == pytest.approx(
        [0.4, 0.2, 0.1, 0.1]
    )
    assert settings.rate(0.3) == settings.learning_rate
    assert settings.rate(1.0) == pytest.approx(settings.learning_rate * settings.final_rate)


def scaled(data: Transitions) -> Transitions:
    """The same in other units."""
    return replace(
        data,
        observations=data.observations * 7 + 3,
        next_observations=data.next_observations * 7 + 3,
        actions=data.actions * 4 - 1,
    )


def test_data_from_a_file_are_normalised_and_their_change_is_noticed(tmp_path: Path) -> None:
    assert (
        main(
            [
                "collect",
                "--task",
                "brake",
                "--out",
                str(tmp_path / "d.hdf5"),
                "--transitions",
                "400",
            ]
        )
        == 0
    )
    data = scaled(read_hdf5(tmp_path / "d.hdf5"))
    write_hdf5(data, tmp_path / "d.hdf5")
    units = normalisation_of(data)
    assert units.action_centre == pytest.approx([-1.0], abs=0.05)
    assert units.action_scale == pytest.approx([4.0], abs=0.05)
    config = replace(TINY, task=None, data=tmp_path / "d.hdf5", horizon=3)
    safety = pretrain_in_folder(config, tmp_path / "run", quiet=True).filters[0]
    assert safety.normalisation == units
    assert -5.05 <= safety.recovery_action(data.observations).min()
    write_hdf5(scaled(data), tmp_path / "d.hdf5")
    with pytest.raises(ValueError, match="the data have changed since the run began"):
        read_run(tmp_path / "run")
    with pytest.raises(ValueError, match="the data have changed since the run began"):
        pretrain_in_folder(config, tmp_path / "run", quiet=True)


def transitions(observations: np.ndarray) -> Transitions:
    """Rows with these observations, the last of them a violation."""
    n = len(observations)
    end = np.arange(n) == n - 1
    actions = np.linspace(-1, 1, n)[:, None]
    return Transitions(
        observations, actions, observations, np.zeros(n), end * 1.0, end, np.zeros(n, dtype=bool)
    )


def test_one_spike_does_not_squash_a_sensor() -> None:
    rng = np.random.default_rng(0)
    sensors = rng.normal([5.0, -2.0], [3.0, 0.01], (20_000, 2))
    calm = normalisation_of(transitions(sensors))
    assert calm.observation_centre == pytest.approx([5.0, -2.0], abs=0.1)
    assert calm.observation_scale == pytest.approx([3.0, 0.01], rel=0.02)
    sensors[1000, 0] = 300.0  # a hundred deviations
    spiked = normalisation_of(transitions(sensors))
    assert spiked.observation_scale[0] == pytest.approx(3.0, rel=0.3)  # of a range: 150
    assert spiked.observation_scale[1] == calm.observation_scale[1]


def test_mean_and_deviation_are_numpys_over_all_rows() -> None:
    observations = np.random.default_rng(0).exponential(2.0, (40_000, 3)).astype(np.float32)
    found = normalisation_of(transitions(observations))
    exact = observations.astype(np.float64)
    assert found.observation_centre == pytest.approx(exact.mean(axis=0), rel=1e-12)
    assert found.observation_scale == pytest.approx(exact.std(axis=0), rel=1e-12)


def test_a_constant_coordinate_is_only_centred() -> None:
    rng = np.random.default_rng(0)
    rounding = rng.choice([-1e-6, 0, 1e-6], 500)
    values = (9.81 + rounding, np.zeros(500), np.full(500, -400.0), -400 + 100 * rounding)
    found = normalisation_of(transitions(np.column_stack(values)))
    assert found.observation_scale == (1.0, 1.0, 1.0, 1.0)
    assert found.observation_centre == pytest.approx([9.81, 0.0, -400.0, -400.0], abs=1e-4)


def test_actions_fill_their_range_and_one_that_never_changes_is_only_centred() -> None:
    data = transitions(np.random.default_rng(0).normal(size=(50, 2)))
    actions = np.column_stack([np.linspace(-3, 1, 50), np.full(50, 0.4)])
    data = replace(data, actions=actions)
    found = normalisation_of(data)
    assert found.action_centre == pytest.approx((-1.0, 0.4))
    assert found.action_scale == pytest.approx((2.0, 1.0))
    expected = np.column_stack([np.linspace(-1, 1, 50), np.zeros(50)])
    assert normalise(data, found).actions == pytest.approx(expected, abs=1e-6)


def test_scaled_tasks_keep_their_units(tmp_path: Path) -> None:
    for safety in pretrain_in_folder(TINY, tmp_path / "run", quiet=True).filters:
        assert safety.normalisation == Normalisation.identity(2, 1)


SENSORS = replace(
    TINY, task="static-env", horizon=30, mix=Mix(3000, random=0, corners=0, adversary=1)
)


def test_each_seed_sees_its_own_data_normalised(tmp_path: Path) -> None:
    seen: list[Transitions] = []

    def spy(data: list[Transitions], *rest: object) -> Batches:
        seen.extend(data)
        return Batches(data, *rest)  # type: ignore[arg-type]  # passed through

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deep.pretraining.algorithm.Batches", spy)
        filters = pretrain_in_folder(SENSORS, tmp_path / "run", quiet=True).filters
    assert (
        filters[0].normalisation.observation_centre != filters[1].normalisation.observation_centre
    )
    for data, safety in zip(seen, filters, strict=True):
        rng = np.random.default_rng((safety.seed, DATA_STREAM))
        raw = SENSORS.mix.collect(make_task("static-env"), rng)
        units, found = safety.normalisation, normalisation_of(raw)
        assert units.observation_centre == found.observation_centre
        assert units.observation_scale == found.observation_scale
        centre, scale = np.array(found.observation_centre), np.array(found.observation_scale)
        for name in ("observations", "next_observations"):
            expected = (getattr(raw, name) - centre) / scale
            assert getattr(data, name) == pytest.approx(expected, abs=1e-4)
        assert (units.action_centre, units.action_scale) == ((0.0, 0.0), (1.0, 1.0))
        assert np.array_equal(data.actions, raw.actions)
        assert data.observations.mean(axis=0) == pytest.approx(0, abs=1e-4)
        varies = np.array(found.observation_scale) != 1.0
        assert varies.sum() == 39  # of 44: a robot in the plane neither falls nor rolls
        assert data.observations[:, varies].std(axis=0) == pytest.approx(1, abs=1e-4)
    alone = pretrain_in_folder(
        replace(SENSORS, seeds=(3,)), tmp_path / "alone", quiet=True
    ).filters[0]
    beside = filters[1].q(raw.observations, raw.actions)
    assert alone.q(raw.observations, raw.actions) == pytest.approx(beside, abs=1e-4)


@pytest.mark.parametrize("source", ["--task", "--data"])
def test_runs_of_sensors_go_on_where_they_stopped(source: str, tmp_path: Path) -> None:
    mix = ["--random", "0", "--corners", "0", "--adversary", "1", "--transitions", "3000"]
    data = str(tmp_path / "data.hdf5")
    assert main(["collect", "--task", "static-env", "--out", data, *mix]) == 0
    nested = [part.replace("--", "--mix.") for part in mix] if source == "--task" else []
    of_method = ["dea-rrl-annealed", "--hidden", "8", "--batch-size", "16"]

    def run(folder: str) -> list[str]:
        given = [source, "static-env" if source == "--task" else data, "--horizon", "30"]
        numbers = ["--seeds", "0", "3", "--updates", "40", "--checkpoint-every", "15"]
        return ["pretrain", "--out", folder, *given, *numbers, *nested, *of_method]

    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert main(run(str(whole))) == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deep.pretraining.run.save_checkpoint", _stop_after_saving)
        with pytest.raises(_Stopped):
            main(run(str(stopped)))
    assert not (stopped / "filters").exists()
    assert main(run(str(stopped))) == 0
    assert filter_bytes(stopped) == filter_bytes(whole)


def test_data_are_not_held_many_times_over(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    data = transitions(rng.standard_normal((50_000, 60)))
    path = tmp_path / "data.hdf5"
    write_hdf5(data, path)
    size = sum(getattr(data, field.name).nbytes for field in fields(data))
    del data
    config = replace(TINY, task=None, data=path, horizon=30, seeds=(0, 1, 2), updates=1)
    tracemalloc.start()
    pretrain_in_folder(config, tmp_path / "run", quiet=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # As read and as checked, as given and normalised, normalised and as tensors: two at once.
    assert peak < 2.6 * size


def test_the_command_line_says_what_is_wrong_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pretrain", "--out", str(tmp_path / "x"), "--task", "bike"]) == 2
    assert capsys.readouterr().err.startswith("deep: there is no task 'bike'; there are brake, ")
    assert (
        main(
            [
                "pretrain",
                "--out",
                str(tmp_path / "x"),
                "--data",
                str(tmp_path / "no.hdf5"),
                "--horizon",
                "3",
            ]
        )
        == 2
    )
    assert "no.hdf5: there is no such file" in capsys.readouterr().err
    sensors = ["pretrain", "--out", str(tmp_path / "x"), "--task", "point-goal1"]
    assert main(sensors) == 2
    assert capsys.readouterr().err == (
        "deep: give the horizon (the most steps from a dead-end to the violation), "
        "or both gamma_safe and threshold\n"
    )
    assert not (tmp_path / "x").exists()
    assert main(["compare", "--out", str(tmp_path / "y"), "--task", "static-env"]) == 2
    assert "static-env: there is no exact answer" in capsys.readouterr().err


def test_pretraining_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [*COMMAND[3:4], "--out", str(tmp_path / "run"), *COMMAND[4:]]
    arguments[arguments.index("600")] = "20"
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    (health, _) = read_health(tmp_path / "run")
    assert f"seed0.safetensors: {health}\n" in printed
    assert str(health).startswith("seed 0: at epsilon 0.105 it blocks 100.0% of 400 logged actions")
    assert SafetyFilter.load(tmp_path / "run" / "filters" / "seed0.safetensors").seed == 0


def test_a_filter_of_no_use_is_a_finished_run_with_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    arguments = ["pretrain", "--out", str(folder), *COMMAND[4:]]
    arguments[arguments.index("600")] = "20"
    assert main(arguments) == 0
    assert "deep: warning: 2 of 2 filters are of no use (seeds: 0, 3)\n" in capsys.readouterr().err
    assert [health.fault for health in read_health(folder)] == [Fault.BLOCKS_ALL] * 2
    config = read_run(folder)
    learner = build_learner(config.method, Sizes(2, 1), config.seeds)
    load_checkpoint(learner, folder / "checkpoint.safetensors")
    with torch.no_grad():
        learner.critic.mlp.biases[-1][learner.critic.members :] = -50.0  # those of seed 3
    save_checkpoint(learner, 20, folder / "checkpoint.safetensors")
    before = filter_bytes(folder)
    assert main(arguments) == 0  # as `grid` expects of a job that left its result
    said = capsys.readouterr()
    assert "seed3.safetensors: seed 3: at epsilon 0.105 it blocks 0.0% of 400" in said.out
    assert f"; warning: of no use, {Fault.BLOCKS_NONE}\n" in said.out
    found = [health.fault for health in read_health(folder)]
    assert found == [Fault.BLOCKS_ALL, Fault.BLOCKS_NONE]
    after = filter_bytes(folder)
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_a_file_can_be_given_the_environments_action_bounds(tmp_path: Path) -> None:
    data = tmp_path / "data.hdf5"
    write_hdf5(transitions(np.random.default_rng(0).normal(size=(60, 2))), data)
    seen = replace(TINY, task=None, data=data, horizon=3, updates=1)
    (safety, _) = pretrain_in_folder(seen, tmp_path / "seen", quiet=True).filters
    assert safety.actions == Bounds.unit(1)
    stated = replace(seen, action_low=(-4.0,), action_high=(1.0,))
    (safety, _) = pretrain_in_folder(stated, tmp_path / "stated", quiet=True).filters
    assert safety.actions == Bounds((-4.0,), (1.0,))
    assert read_run(tmp_path / "stated").action_bounds == safety.actions
    narrow = replace(seen, action_low=(0.0,), action_high=(1.0,))
    with pytest.raises(ValueError, match=r"data.hdf5: actions: row 0 is \(-1\), outside of their"):
        pretrain_in_folder(narrow, tmp_path / "narrow", quiet=True)
    assert not (tmp_path / "narrow").exists()
    for bounds, message in (
        ({"action_low": (0.0,)}, "give both action_low and action_high, or neither"),
        ({"action_low": (1.0,), "action_high": (0.0,)}, "bounds must not cross"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(seen, **bounds)
    with pytest.raises(ValueError, match="go with a data file"):
        replace(TINY, action_low=(-1.0,), action_high=(1.0,))


def test_closenesses_are_sharpened_before_they_are_normalised(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    seen = np.column_stack(
        [
            *(rng.uniform(0, 1, 500), rng.normal(size=500), np.zeros(500)),
            *(rng.uniform(0, 1.1, 500), rng.uniform(-0.1, 1, 500)),
        ]
    ).astype(np.float32)
    data = transitions(seen)
    found = normalisation_of(data, 8.0)
    # Only what stays in [0, 1] and varies.
    assert found.observation_power == (8.0, 1.0, 1.0, 1.0, 1.0)
    assert found.observation_centre[0] == pytest.approx((seen[:, 0] ** 8).mean(), rel=1e-5)
    assert found.observation_scale[0] == pytest.approx((seen[:, 0] ** 8).std(), rel=1e-4)
    assert normalisation_of(data).observation_power == ()
    own = normalise(data, found).next_observations[:, 0]
    expected = (np.maximum(data.next_observations[:, 0], 0) ** 8 - found.observation_centre[0]) / (
        found.observation_scale[0]
    )
    assert own == pytest.approx(expected, rel=1e-4, abs=1e-6)
    write_hdf5(data, tmp_path / "data.hdf5")
    config = replace(
        TINY, task=None, data=tmp_path / "data.hdf5", horizon=5, sharpness=8.0, updates=2
    )
    safety = pretrain_in_folder(config, tmp_path / "run", quiet=True).filters[0]
    assert safety.normalisation.observation_power == (8.0, 1.0, 1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="sharpness must be at least 1, not 0.5"):
        replace(config, sharpness=0.5)
