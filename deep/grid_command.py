"""The command ``python -m deep grid``: a study's jobs, run on this machine or on a cluster."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from deep.grid import JobsFailedError, failure_table, run_jobs
from deep.job_backends import BackendName
from deep.study import StudyConfig, study_jobs

__all__ = ["Grid"]


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
            JobsFailedError: with the table of those that failed.
        """
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
