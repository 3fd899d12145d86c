"""A study's jobs: in order, each a command that parses and writes what the next one reads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from deep.__main__ import parse
from deep.cli.choose_threshold import ChooseThreshold
from deep.cli.evaluate import Evaluate
from deep.cli.offline_data import OfflineData
from deep.cli.pretrain import Pretrain
from deep.cli.train import Train
from deep.cli.train_offline import TrainOffline
from deep.pretraining import (
    FORMS,
    DeaRrlAnnealedSettings,
    DearrlIqlSettings,
    DeaRrlSettings,
    RrlMsdpSettings,
    RrlSettings,
)
from deep.pretraining.config import MethodChoice, PretrainConfig
from deep.study.jobs import StudyConfig, study_jobs
from deep.study.saved_runs import METHODS
from deep.study.schedule import Job
from deep.tasks.gym import NO_RULES, Rules
from deep.train.config import TrainConfig
from deep.train.offline import OfflineConfig
from deep.train.wcsac import WcsacSettings

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


OTHER = StudyConfig(
    out=Path("o"),
    tasks=("brake",),
    seeds=(7, 8),
    selection_seeds=(50, 51),
    steps=900_000,
    selection_steps=110_000,
    limit_selection_steps=210_000,
    pretrain_updates=11,
    iql_updates=12,
    random=13,
    keep=14,
    sharpness=3.0,
    horizon=15,
    candidates=(0.1, 0.2),
    horizon_candidates=(0.3, 0.4),
    limits=(0.6, 0.7),
    safety_share=0.8,
    ablation_task="brake",
    ablation_threshold=0.9,
    ablation_steps=120_000,
    real_tasks=("brake",),
    real_steps=130_000,
    real_episodes=16,
)
"""No number twice, and none as by default."""
HOME = Path("o/brake")
PRETRAINED: dict[str, MethodChoice] = {
    "dea-rrl": DeaRrlSettings(learning_rate=1e-3, batch_size=128, polyak=0.1),
    "rrl": RrlSettings(learning_rate=1e-3, batch_size=128, polyak=0.1),
    "rrl-msdp": RrlMsdpSettings(learning_rate=1e-3, batch_size=128, polyak=0.1),
    "dearrl-iql": DearrlIqlSettings(learning_rate=1e-3, batch_size=128, polyak=0.1),
    "dea-rrl-annealed": DeaRrlAnnealedSettings(
        learning_rate=1e-3, batch_size=128, final_expectile=0.1
    ),
}


def chosen_for(method: str) -> Path:
    return HOME / "select" / method / "threshold.json"


def commands_of_a_form(form: str) -> dict[str, object]:
    """Pretraining on the results' seeds and the first of the others, which all others use."""
    safety = HOME / "pretrain" / form
    candidates = (0.3, 0.4) if form == "dea-rrl-annealed" else (0.1, 0.2)
    pretrained = PretrainConfig(
        data=HOME / "data/offline.hdf5",
        method=PRETRAINED[form],
        seeds=(7, 8, 50),
        updates=11,
        horizon=15,
        sharpness=3.0,
    )
    long = TrainConfig(task="brake", safety=safety, seeds=(7, 8), steps=900_000)
    at_one = replace(long, threshold=(0.9,), steps=120_000)
    short = replace(
        long, safety_seeds=(50, 50), threshold=candidates, seeds=(50, 51), steps=110_000
    )
    found: dict[str, object] = {
        f"pretrain/{form}": Pretrain(safety, pretrained),
        f"select/{form}": Train(HOME / "select" / form, short),
        f"train/{form}": Train(HOME / "train" / form, long, chosen_for(form)),
    }
    if form != "dea-rrl-annealed":
        found[f"ablation/{form}"] = Train(HOME / "ablation" / form, at_one)
    return found


def other_commands() -> dict[str, object]:
    """Those of data and of the baselines, and the choices."""
    sac = HOME / "data/sac"
    wcsac = WcsacSettings(sharpness=3.0)
    limits = WcsacSettings(sharpness=3.0, cost_limit=(0.6, 0.7))
    long = TrainConfig(task="brake", seeds=(7, 8), steps=900_000)
    recorded = TrainConfig(task="brake", seeds=(50,), steps=900_000, keep_replay=True)
    short = TrainConfig(task="brake", method=limits, seeds=(50, 51), steps=210_000)
    iql = OfflineConfig(task="brake", data=HOME / "data/replay.hdf5", seeds=(7, 8), updates=12)
    return {
        "data/sac": Train(sac, recorded),
        "data/offline.hdf5": OfflineData(sac, HOME / "data/offline.hdf5", 50, 13, 14),
        "data/replay.hdf5": OfflineData(sac, HOME / "data/replay.hdf5", 50, 0, None),
        "train/sac": Train(HOME / "train/sac", long),
        "train/iql": TrainOffline(HOME / "train/iql", iql),
        "select/wcsac": Train(HOME / "select/wcsac", short),
        "train/wcsac": Train(
            HOME / "train/wcsac", replace(long, method=wcsac), chosen_for("wcsac")
        ),
    } | {
        f"select/{method}/threshold.json": ChooseThreshold(
            HOME / "select" / method, sac, chosen_for(method), 0.8
        )
        for method in (*FORMS, "wcsac")
    }


def commands_with_trained_filters() -> dict[str, object]:
    """Plugged together, and on the real task; names from the task's folder on."""
    plugged = {
        f"plug/{policy}+{form}": Evaluate(
            HOME / "train" / policy,
            HOME / "plug" / f"{policy}+{form}",
            HOME / "pretrain" / form,
            threshold_from=chosen_for(form),
        )
        for form in ("rrl", "dea-rrl", "dea-rrl-annealed")
        for policy in ("sac", "iql")
    }
    real = TrainConfig(task="real:brake", seeds=(7,), steps=130_000, episodes=16)
    place = Path("o/real-brake/train")
    return {
        **plugged,
        "../real-brake/train/sac": Train(place / "sac", real),
        **{
            f"../real-brake/train/{form}": Train(
                place / form, replace(real, safety=HOME / "pretrain" / form), chosen_for(form)
            )
            for form in ("rrl", "dea-rrl", "dea-rrl-annealed")
        },
    }


def test_every_number_of_a_study_reaches_its_commands() -> None:
    expected = other_commands() | commands_with_trained_filters()
    for form in FORMS:
        expected |= commands_of_a_form(form)
    found = {
        job.name.removeprefix("brake/").replace("real-", "../real-"): parse(job.command)
        for job in study_jobs(OTHER)
    }
    assert found == expected


def test_a_job_is_finished_when_its_last_file_is_there() -> None:
    for job in study_jobs(OTHER):
        command = parse(job.command)
        if isinstance(command, Pretrain):
            last = "filters/seed50.safetensors"  # filters are written in the seeds' order
            assert job.result == command.out / last
        elif isinstance(command, Train | TrainOffline | Evaluate):
            assert job.result == command.out / "result.json"


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


def test_rules_reach_what_steps_an_environment_of_gymnasium() -> None:
    rules = Rules("cost > 2", True, 30)
    tasks = ("gym:Pendulum-v1", "brake")
    config = StudyConfig(out=Path("s"), tasks=tasks, methods=("sac", "wcsac"), rules=rules)
    for job in study_jobs(config):
        command = parse(job.command)
        if isinstance(command, Train):
            gym = command.run_config.task.startswith("gym:")
            assert command.run_config.rules == (rules if gym else NO_RULES)
    offline = StudyConfig(
        out=Path("s"), tasks=tasks[:1], methods=("iql",), rules=replace(rules, violation=None)
    )
    (iql,) = [
        c
        for c in map(parse, (j.command for j in study_jobs(offline)))
        if isinstance(c, TrainOffline)
    ]
    assert iql.run_config.rules == offline.rules
    with pytest.raises(
        ValueError, match="^violation is of the costs that an environment reports; iql"
    ):
        replace(offline, rules=rules)


def test_configurations_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="there is no method 'ppo'; there are sac, wcsac, rrl"):
        StudyConfig(out=Path("s"), methods=("ppo",))
    with pytest.raises(ValueError, match=r"^seeds: no seed twice, not \[0, 0\]$"):
        StudyConfig(out=Path("s"), seeds=(0, 0))
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
    for name in ("candidates", "horizon_candidates", "limits"):
        with pytest.raises(ValueError, match=f"{name}: 2 for 4 selection_seeds: give one each"):
            StudyConfig(out=Path("s"), **{name: (0.1, 0.3)})  # type: ignore[arg-type]  # by name
