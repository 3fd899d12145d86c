"""``python -m deep grid``: a study's jobs, run on this machine or on a cluster."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Annotated

import tyro

from dead_ends.io.atomic import atomic_path
from deep.runs.folder import only_process, read_object
from deep.study.job_backends import BackendName
from deep.study.jobs import StudyConfig, study_jobs
from deep.study.schedule import JobsFailedError, failure_table, run_jobs
from deep.tasks.gym import NO_RULES

__all__ = ["Grid", "remember"]

WHICH_RUNS = ("out", "tasks", "methods", "real_tasks")
"""More of them may be asked for later; what else is set belongs to every run."""


@dataclass(frozen=True)
class Grid:
    """Run a study: tasks x methods x seeds, what is finished skipped.

    Attributes:
        config: the study.
        workers: jobs at once; by default as many as there are cores.
        backend: this machine, or a cluster through Ray.
        address: of a Ray cluster; by default one of its own on this machine.
    """

    config: Annotated[StudyConfig, tyro.conf.arg(name="")]
    workers: int | None = None
    backend: BackendName = "local"
    address: str | None = None

    def run(self) -> None:
        """Run, and say how many jobs there were.

        Raises:
            ValueError: if the folder holds a study with other settings.
            JobsFailedError: with the table of those that failed.
        """
        with only_process(self.config.out):
            remember(self.config)
        result = run_jobs(
            study_jobs(self.config),
            logs=self.config.out / "logs",
            workers=self.workers,
            backend=self.backend,
            address=self.address,
        )
        print(
            f"{self.config.out}: {len(result.finished)} jobs finished, "
            f"{len(result.skipped)} were finished before, {len(result.failed)} failed, "
            f"{len(result.blocked)} need a failed one"
        )
        if result.failed:
            raise JobsFailedError(failure_table(result))


def remember(config: StudyConfig) -> None:
    """Write the study's settings into its folder, or find the same ones there.

    Finished runs are skipped: with other settings they would pass for what was asked for.

    Raises:
        ValueError: naming a setting that differs.
    """
    path = config.out / "study.json"
    chosen = {name: value for name, value in asdict(config).items() if name not in WHICH_RUNS}
    plain = json.loads(json.dumps(chosen))
    if not path.exists():
        config.out.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(plain, indent=2) + "\n")
        return
    before_rules = {"rules": asdict(NO_RULES)}  # a study that was begun before there were any
    found = before_rules | read_object(path, *(plain.keys() - before_rules.keys()))
    for name, value in plain.items():
        if found[name] != value:
            raise ValueError(f"{config.out} holds a study with {name} {found[name]}, not {value}")
