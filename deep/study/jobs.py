"""The paper's experiments as jobs: tasks x methods x seeds, and what they need before.

For each task, in ``STUDY/<task>/``:

    data/sac        SAC on a seed of its own, whose replay buffer is the offline data
    data/*.hdf5     before violations (with random actions) for the critics; all for IQL
    pretrain/FORM   Algorithm 1 in each form, on the same data
    select/METHOD   short runs, one candidate of epsilon (WCSAC: of its cost limit) a seed, on
                    seeds of their own
    train/METHOD    Algorithm 2 in each form, and the baselines
    plug/A+B        trained policies behind filters that they have never met
    ablation/FORM   the forms of Algorithm 1 at one epsilon (on one task)

and in ``STUDY/real-<task>/train/METHOD`` short runs on Safety-Gymnasium's own task, behind what
was pretrained on its vectorised twin.

A job is one command of ``python -m deep``; :mod:`deep.study.schedule` runs them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep.runs.forms import FORM_ROWS
from deep.study.saved_runs import METHODS
from deep.study.schedule import Job
from deep.tasks import make_task
from deep.tasks.gym import NO_RULES, Rules
from deep.tasks.vectorised import GYM, REAL
from deep.train.config import TrainConfig

__all__ = ["StudyConfig", "study_jobs"]

FEW_UPDATES = ("--learning-rate", "1e-3", "--batch-size", "128")
"""The authors' half a million updates at 3e-4, of 256 transitions, would take days here."""
PLUGGED = tuple(name for name, form in FORM_ROWS.items() if form.plugged)


@dataclass(frozen=True)
class StudyConfig:
    """What is run, and how much of it.

    Raises:
        ValueError: for unknown tasks or methods, seeds that choose and are judged, or numbers
            that do not go together.

    Attributes:
        out: the study's folder.
        tasks: their names.
        rules: what environments of "gym:" among them leave open.
        methods: sac, wcsac, iql, and forms of Algorithm 1.
        seeds: of the results, trained side by side in one process.
        selection_seeds: of the runs that choose thresholds, one a candidate; the first one is
            pretrained, and its SAC run gives the offline data.
        steps: environment steps of a training run and seed.
        selection_steps: of a run that chooses epsilon.
        limit_selection_steps: of the one that chooses WCSAC's cost limit: it is not pretrained.
        pretrain_updates: of Algorithm 1.
        iql_updates: of IQL.
        random: transitions with random actions among the offline data, before the filter.
        keep: offline data are so many steps before violations (the paper: 100, with which
            every state in the data is soon lost).
        sharpness: of all safety critics' view of lidars, WCSAC's too, see
            :class:`deep.pretraining.config.PretrainConfig`.
        horizon: H of the tasks, the most steps from a dead-end to the violation: a Point
            at top speed brakes to a stand in 18 steps.
        candidates: of epsilon, for the critics with gamma_safe 0.99.
        horizon_candidates: of epsilon, for the forms whose gamma_safe follows from H.
        limits: candidates of WCSAC's cost limit.
        safety_share: chosen is the largest one with at most this share of SAC's violations.
        ablation_task: where the forms are compared at one epsilon, if it is among the tasks.
        ablation_threshold: that epsilon (the paper's).
        ablation_steps: environment steps of those runs.
        real_tasks: of the tasks, those that are run on Safety-Gymnasium's own too.
        real_steps: environment steps of those runs, of one seed.
        real_episodes: whole evaluation episodes of those runs.
    """

    out: Path
    tasks: tuple[str, ...] = ("point-goal1", "static-env", "dynamic-env")
    rules: Annotated[Rules, tyro.conf.arg(name="")] = NO_RULES
    methods: tuple[str, ...] = tuple(METHODS)
    seeds: tuple[int, ...] = (0, 1, 2, 3)
    selection_seeds: tuple[int, ...] = (100, 101, 102, 103)
    steps: int = 1_000_000
    selection_steps: int = 100_000
    limit_selection_steps: int = 300_000
    pretrain_updates: int = 15_000
    iql_updates: int = 50_000
    random: int = 400_000
    keep: int = 400
    sharpness: float = 24.0
    horizon: int = 20
    candidates: tuple[float, ...] = (0.3, 0.5, 0.7, 0.8)
    horizon_candidates: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2)
    limits: tuple[float, ...] = (0.005, 0.01, 0.02, 0.045)
    safety_share: float = 0.05
    ablation_task: str = "point-goal1"
    ablation_threshold: float = 0.7
    ablation_steps: int = 300_000
    real_tasks: tuple[str, ...] = ()
    real_steps: int = 100_000
    real_episodes: int = 100

    def __post_init__(self) -> None:
        for task in self.tasks:
            if not task.startswith((REAL, GYM)):
                make_task(task)
        alien = [task for task in self.real_tasks if task not in self.tasks]
        if alien:
            raise ValueError(f"real_tasks: {alien[0]!r} is not one of the study's tasks")
        unknown = [method for method in self.methods if method not in METHODS]
        if unknown:
            raise ValueError(f"there is no method {unknown[0]!r}; there are {', '.join(METHODS)}")
        for name in ("seeds", "selection_seeds"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ValueError(f"{name}: no seed twice, not {list(getattr(self, name))}")
        if self.rules.violation is not None and "iql" in self.methods:
            raise ValueError(
                "violation is of the costs that an environment reports; iql learns from a file, "
                "where they are 0 or 1 already: leave it out of the methods"
            )
        if set(self.seeds) & set(self.selection_seeds):
            raise ValueError("thresholds must be chosen on other seeds than the results'")
        log_every = TrainConfig.log_every
        for name in ("selection_steps", "limit_selection_steps"):
            steps = getattr(self, name)
            if not 0 < steps <= self.steps or steps % log_every:
                raise ValueError(
                    f"{name} must be a multiple of {log_every}, where SAC's violations are "
                    f"written down, and at most steps ({self.steps}), not {steps}"
                )
        for name in ("candidates", "horizon_candidates", "limits"):
            if len(getattr(self, name)) != len(self.selection_seeds):
                raise ValueError(
                    f"{name}: {len(getattr(self, name))} for "
                    f"{len(self.selection_seeds)} selection_seeds: give one each"
                )


def study_jobs(config: StudyConfig) -> tuple[Job, ...]:
    """All jobs, those of the same stage side by side over the tasks."""
    stages = [_task_jobs(config, task) for task in config.tasks]
    return tuple(job for stage in range(len(stages[0])) for jobs in stages for job in jobs[stage])


def _task_jobs(config: StudyConfig, task: str) -> list[list[Job]]:
    """A task's jobs, stage by stage."""
    forms = [form for form in FORM_ROWS if form in config.methods]
    sac, wcsac, iql = ([m] if m in config.methods else [] for m in ("sac", "wcsac", "iql"))
    chosen = [*forms, *wcsac]
    make = _Jobs(config, task)
    return [
        [make.data_run()],
        [make.offline_data("offline", config.random, config.keep)],
        [make.pretrain(form) for form in forms],
        [make.train_sac() for _ in sac],
        [make.select(form) for form in forms] + [make.select_limit() for _ in wcsac],
        [make.choose(method) for method in chosen],
        [make.train(method) for method in chosen],
        [make.offline_data("replay", 0, None) for _ in iql],
        [make.iql() for _ in iql],
        [
            make.plug(policy, form)
            for form in PLUGGED
            for policy in ("sac", "iql")
            if {policy, form} <= set(config.methods)
        ],
        [make.ablation(form) for form in forms if not FORM_ROWS[form].from_horizon]
        if task == config.ablation_task
        else [],
        [make.real(method) for method in ("sac", *PLUGGED) if method in config.methods]
        if task in config.real_tasks
        else [],
    ]


class _Jobs:
    """Commands for one task."""

    def __init__(self, config: StudyConfig, task: str) -> None:
        self.config = config
        self.task = task
        self.folder = config.out / task

    def _name(self, *parts: str) -> str:
        return "/".join((self.task, *parts))

    def _job(
        self, part: str, needs: tuple[str, ...], *command: str, result: str = "result.json"
    ) -> Job:
        return Job(
            self._name(part),
            command,
            self.folder / part / result if result else self.folder / part,
            tuple(self._name(need) for need in needs),
        )

    def _train(
        self, part: str, needs: tuple[str, ...], seeds: tuple[int, ...], steps: int, *more: str
    ) -> Job:
        return self._job(
            part, needs, "train", "--task", self.task, "--out", str(self.folder / part),
            "--seeds", *map(str, seeds), "--steps", str(steps), *self._rules(), *more,
        )  # fmt: skip

    def _rules(self) -> tuple[str, ...]:
        """The options of an environment of "gym:"."""
        rules, options = self.config.rules, list[str]()
        if not self.task.startswith(GYM):
            return ()
        if rules.violation is not None:
            options += ["--violation", rules.violation]
        if rules.termination_is_violation:
            options += ["--termination-is-violation"]
        if rules.time_limit is not None:
            options += ["--time-limit", str(rules.time_limit)]
        return tuple(options)

    def data_run(self) -> Job:
        first = self.config.selection_seeds[:1]
        return self._train("data/sac", (), first, self.config.steps, "--keep-replay", "sac")

    def offline_data(self, name: str, random: int, keep: int | None) -> Job:
        part = f"data/{name}.hdf5"
        return self._job(
            part, ("data/sac",), "offline-data", "--run-folder", str(self.folder / "data/sac"),
            "--out", str(self.folder / part), "--seed", str(self.config.selection_seeds[0]),
            "--random", str(random), "--keep", str(keep), result="",
        )  # fmt: skip

    def pretrain(self, form: str) -> Job:
        seeds = (*self.config.seeds, self.config.selection_seeds[0])
        part = f"pretrain/{form}"
        return self._job(
            part, ("data/offline.hdf5",), "pretrain", "--data",
            str(self.folder / "data/offline.hdf5"), "--out", str(self.folder / part),
            "--seeds", *map(str, seeds), "--horizon", str(self.config.horizon),
            "--sharpness", str(self.config.sharpness),
            "--updates", str(self.config.pretrain_updates), form,
            *FEW_UPDATES, *FORM_ROWS[form].study,
            result=f"filters/seed{seeds[-1]}.safetensors",
        )  # fmt: skip

    def _safety(self, form: str) -> tuple[str, ...]:
        return ("--safety", str(self.folder / "pretrain" / form))

    def select(self, form: str) -> Job:
        config = self.config
        own = not FORM_ROWS[form].from_horizon
        candidates = config.candidates if own else config.horizon_candidates
        same = [str(config.selection_seeds[0])] * len(config.selection_seeds)
        return self._train(
            f"select/{form}", (f"pretrain/{form}",), config.selection_seeds,
            config.selection_steps, *self._safety(form), "--safety-seeds", *same,
            "--threshold", *map(str, candidates), "sac",
        )  # fmt: skip

    def select_limit(self) -> Job:
        config = self.config
        return self._train(
            "select/wcsac", (), config.selection_seeds, config.limit_selection_steps,
            *self._wcsac(), "--cost-limit", *map(str, config.limits),
        )  # fmt: skip

    def _wcsac(self) -> tuple[str, ...]:
        return ("wcsac", "--sharpness", str(self.config.sharpness))

    def choose(self, method: str) -> Job:
        part = f"select/{method}/threshold.json"
        return self._job(
            part, (f"select/{method}", "data/sac"), "choose-threshold",
            "--run-folder", str(self.folder / "select" / method),
            "--baseline", str(self.folder / "data/sac"), "--out", str(self.folder / part),
            "--share", str(self.config.safety_share), result="",
        )  # fmt: skip

    def train_sac(self) -> Job:
        return self._train("train/sac", (), self.config.seeds, self.config.steps, "sac")

    def train(self, method: str) -> Job:
        """Behind what was chosen for a form, or under the limit that was chosen for WCSAC."""
        form = method != "wcsac"
        chosen = f"select/{method}/threshold.json"
        return self._train(
            f"train/{method}", (*((f"pretrain/{method}",) if form else ()), chosen),
            self.config.seeds, self.config.steps, *(self._safety(method) if form else ()),
            "--threshold-from", str(self.folder / chosen), *(("sac",) if form else self._wcsac()),
        )  # fmt: skip

    def ablation(self, form: str) -> Job:
        config = self.config
        return self._train(
            f"ablation/{form}", (f"pretrain/{form}",), config.seeds, config.ablation_steps,
            *self._safety(form), "--threshold", str(config.ablation_threshold), "sac",
        )  # fmt: skip

    def real(self, method: str) -> Job:
        config = self.config
        folder = config.out / f"real-{self.task}" / "train" / method
        command = [
            "train", "--task", f"real:{self.task}", "--out", str(folder),
            "--seeds", str(config.seeds[0]), "--steps", str(config.real_steps),
            "--episodes", str(config.real_episodes),
        ]  # fmt: skip
        needs: tuple[str, ...] = ()
        if method in FORM_ROWS:
            chosen = f"select/{method}/threshold.json"
            needs = (self._name("pretrain", method), self._name(chosen))
            command += [*self._safety(method), "--threshold-from", str(self.folder / chosen)]
        name = f"real-{self.task}/train/{method}"
        return Job(name, (*command, "sac"), folder / "result.json", needs)

    def iql(self) -> Job:
        part = "train/iql"
        return self._job(
            part, ("data/replay.hdf5",), "train-offline", "--task", self.task,
            "--data", str(self.folder / "data/replay.hdf5"), "--out", str(self.folder / part),
            "--seeds", *map(str, self.config.seeds), "--updates", str(self.config.iql_updates),
            *self._rules(),
        )  # fmt: skip

    def plug(self, policy: str, form: str) -> Job:
        part, chosen = f"plug/{policy}+{form}", f"select/{form}/threshold.json"
        return self._job(
            part, (f"train/{policy}", f"pretrain/{form}", chosen), "evaluate",
            "--policy", str(self.folder / "train" / policy), *self._safety(form),
            "--threshold-from", str(self.folder / chosen), "--out", str(self.folder / part),
        )  # fmt: skip
