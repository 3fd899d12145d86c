"""A study's jobs: in order, each a command that parses and writes what the next one reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from deep.__main__ import parse
from deep.config import PretrainConfig
from deep.grid import Job
from deep.online.commands import ChooseThreshold, Evaluate, OfflineData, Train, TrainOffline
from deep.online.wcsac import WcsacSettings
from deep.study import FORMS, METHODS, StudyConfig, study_jobs

CONFIG = StudyConfig(
    out=Path("study"), tasks=("point-goal1", "static-env"), real_tasks=("static-env",)
)
JOBS = {job.name: job for job in study_jobs(CONFIG)}


def test_names_are_unique_and_needs_come_first() -> None:
    names = [job.name for job in study_jobs(CONFIG)]
    assert len(set(names)) == len(names)
    for place, name in enumerate(names):
        assert all(need in names[:place] for need in JOBS[name].needs), name


def test_there_is_a_training_run_for_every_task_and_method() -> None:
    trained = {name for name in JOBS if "/train/" in name and not name.startswith("real-")}
    assert trained == {f"{task}/train/{method}" for task in CONFIG.tasks for method in METHODS}
    assert {name for name in JOBS if "/ablation/" in name} == {
        f"point-goal1/ablation/{form}" for form in FORMS if form != "dea-rrl-annealed"
    }


@pytest.mark.parametrize("job", JOBS.values(), ids=lambda job: job.name)
def test_every_command_parses_and_writes_its_result(job: Job) -> None:
    command = parse(job.command)
    out = getattr(command, "out")  # noqa: B009  (every command has one)
    if isinstance(command, OfflineData | ChooseThreshold):
        assert out == job.result
    else:
        assert job.result.is_relative_to(out)


def paths_read(command: object) -> set[Path]:
    """The files and folders that a command reads."""
    match command:
        case Train(run_config=config, threshold_from=chosen):
            found = {config.safety, chosen}
        case TrainOffline(run_config=config):
            found = {config.data}
        case OfflineData(run_folder=folder):
            found = {folder}
        case ChooseThreshold(run_folder=folder, baseline=baseline):
            found = {folder, baseline}
        case Evaluate(policy=policy, safety=safety, threshold_from=chosen):
            found = {policy, safety, chosen}
        case _:
            config = getattr(command, "run_config")  # noqa: B009  (the one that is left)
            assert isinstance(config, PretrainConfig)
            found = {config.data}
    return {path for path in found if path is not None}


@pytest.mark.parametrize("job", JOBS.values(), ids=lambda job: job.name)
def test_what_a_command_reads_is_made_by_a_job_that_it_needs(job: Job) -> None:
    made = [JOBS[need].result for need in job.needs]
    for path in paths_read(parse(job.command)):
        assert any(result == path or result.is_relative_to(path) for result in made), path


def test_thresholds_are_chosen_on_seeds_that_no_result_comes_from() -> None:
    for name, job in JOBS.items():
        command = parse(job.command)
        if not isinstance(command, Train):
            continue
        seeds = set(command.run_config.seeds)
        if "/select/" in name or "/data/" in name:
            assert not seeds & set(CONFIG.seeds)
            continue
        if name.startswith("real-"):
            continue
        assert seeds == set(CONFIG.seeds)
        method = name.rpartition("/")[2]
        if "/train/" in name and method in (*FORMS, "wcsac"):
            chosen = Path("study", name.partition("/")[0], "select", method, "threshold.json")
            assert command.threshold_from == chosen


def test_wcsac_tries_a_limit_a_seed_and_sees_lidars_as_the_others_critics_do() -> None:
    for part, limits in (("select", CONFIG.limits), ("train", WcsacSettings().cost_limit)):
        command = parse(JOBS[f"static-env/{part}/wcsac"].command)
        assert isinstance(command, Train)
        assert command.run_config.method == WcsacSettings(sharpness=24, cost_limit=limits)
        chosen = command.run_config.with_threshold(0.1).method
        assert chosen == WcsacSettings(sharpness=24, cost_limit=(0.1,))


def test_the_real_task_is_run_behind_what_its_twin_was_pretrained_to() -> None:
    names = {name for name in JOBS if name.startswith("real-")}
    methods = ("sac", "rrl", "dea-rrl", "dea-rrl-annealed")
    assert names == {f"real-static-env/train/{method}" for method in methods}
    command = parse(JOBS["real-static-env/train/rrl"].command)
    assert isinstance(command, Train)
    assert command.run_config.task == "real:static-env"
    assert command.run_config.safety == Path("study/static-env/pretrain/rrl")
    assert command.run_config.seeds == CONFIG.seeds[:1]


def test_fewer_methods_make_fewer_jobs() -> None:
    config = StudyConfig(out=Path("s"), tasks=("static-env",), methods=("sac", "dea-rrl"))
    names = {job.name.removeprefix("static-env/") for job in study_jobs(config)}
    assert names == {
        "data/sac", "data/offline.hdf5", "pretrain/dea-rrl", "select/dea-rrl",
        "select/dea-rrl/threshold.json", "train/sac", "train/dea-rrl", "plug/sac+dea-rrl",
    }  # fmt: skip


def test_configurations_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="there is no method 'ppo'; there are sac, dea-rrl"):
        StudyConfig(out=Path("s"), methods=("ppo",))
    with pytest.raises(ValueError, match="thresholds must be chosen on other seeds"):
        StudyConfig(out=Path("s"), selection_seeds=(3, 101, 102, 103))
    with pytest.raises(ValueError, match="real_tasks: 'car-goal1' is not one of the study's"):
        StudyConfig(out=Path("s"), real_tasks=("car-goal1",))
    with pytest.raises(ValueError, match="there is no task 'point-gaol1'; there are brake"):
        StudyConfig(out=Path("s"), tasks=("point-gaol1",))
    assert StudyConfig(out=Path("s"), tasks=("gym:Pendulum-v1",)).tasks == ("gym:Pendulum-v1",)
    for name, steps in (("selection_steps", 15_000), ("limit_selection_steps", 2_000_000)):
        with pytest.raises(
            ValueError, match=rf"{name} must be a multiple of 10000, where.*{steps}"
        ):
            StudyConfig(out=Path("s"), **{name: steps})  # type: ignore[arg-type]  # by name
    for name in ("candidates", "annealed_candidates", "limits"):
        with pytest.raises(ValueError, match=f"{name}: 2 for 4 selection_seeds: give one each"):
            StudyConfig(out=Path("s"), **{name: (0.1, 0.3)})  # type: ignore[arg-type]  # by name
