"""Many runs: each a process of its own, as many at once as there are cores, and none twice.

A job is a command and the file that exists exactly when the job is finished. It runs when
what it needs is finished, and is skipped if it is finished itself; so the same call goes on
after an interrupt. A failed job stops only those that need it.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath
from types import FrameType
from typing import Any

from tqdm import tqdm

from deep.study.job_backends import BackendName, Runner, open_runner
from deep.study.job_process import Ending, JobProcess, Outcome

__all__ = ["Failure", "GridResult", "Job", "JobsFailedError", "failure_table", "run_jobs"]

PROGRAM = (sys.executable, "-m", "deep")
DONE = (Ending.FINISHED, Ending.SKIPPED)
LOST = (Ending.FAILED, Ending.BLOCKED)
TICK = 0.2  # seconds between two looks at what has ended
ELSEWHERE_PAUSE = 2.0  # seconds until a job that another command runs is looked at again


class JobsFailedError(Exception):
    """Some jobs failed; the message is the table of them."""


@dataclass(frozen=True)
class Job:
    """One command of many.

    Attributes:
        name: unique; with slashes it is a path, that of its log.
        command: arguments of ``python -m deep``.
        result: exists exactly when the job is finished.
        needs: names of the jobs that must be finished first.
    """

    name: str
    command: tuple[str, ...]
    result: Path
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Failure:
    """A job that failed.

    Attributes:
        name: the job's.
        reason: its exit status, or what is missing.
        last_line: of its log; empty if it printed nothing.
        log: the file.
    """

    name: str
    reason: str
    last_line: str
    log: Path


@dataclass(frozen=True)
class GridResult:
    """What came of the jobs, in their order.

    Attributes:
        finished: names of those that ran to their end.
        skipped: names of those that were finished before, or meanwhile by another command.
        failed: those that failed.
        blocked: names of those that need, perhaps through others, a failed one.
    """

    finished: tuple[str, ...]
    skipped: tuple[str, ...]
    failed: tuple[Failure, ...]
    blocked: tuple[str, ...]


def run_jobs(
    jobs: Sequence[Job],
    *,
    logs: Path,
    workers: int | None = None,
    backend: BackendName = "local",
    address: str | None = None,
    quiet: bool = False,
    program: Sequence[str] = PROGRAM,
) -> GridResult:
    """Run all jobs that are not finished.

    Ctrl-C, SIGTERM and SIGHUP end the running ones, SIGINT first, so that they can save
    their state; the same again ends them at once.

    Args:
        jobs: what is to be run; of those that are ready the first ones go first.
        logs: the folder of the logs, one file a job, and of the lock files beside them.
        workers: jobs at once; None: as many as there are cores.
        backend: this machine, or a cluster through Ray with a file system that all share.
        address: of a Ray cluster; None: one of its own on this machine.
        quiet: without progress bar and messages.
        program: what gets each job's command as its arguments.

    Raises:
        ValueError: if names are equal or no paths, needs unknown or cyclic, there is less than
            one worker, or Ray is wanted and missing.
        KeyboardInterrupt: if it was interrupted; no process is left.
    """
    _check(jobs, workers, backend, address)
    grid = _Grid(jobs, logs.absolute(), tuple(program), quiet)
    if grid.open:
        with open_runner(backend, workers, address) as runner, _Interrupts() as interrupts:
            grid.run(runner, interrupts)
    return grid.result()


def failure_table(result: GridResult) -> str:
    """One line a failed job, with the last line of its log, and one a blocked job."""
    width = max(len(name) for name in (*(f.name for f in result.failed), *result.blocked))
    failed = (f"{f.name:{width}}  failed   {_sentence(f)}" for f in result.failed)
    blocked = (f"{name:{width}}  blocked  a job that it needs failed" for name in result.blocked)
    return "\n".join((*failed, *blocked))


def _sentence(failure: Failure) -> str:
    said = failure.last_line or "its log is empty"
    return f"{failure.reason}: {said} ({failure.log})"


def _check(
    jobs: Sequence[Job], workers: int | None, backend: BackendName, address: str | None
) -> None:
    """One sentence about the first thing that is wrong."""
    names: set[str] = set()
    for job in jobs:
        parts = PurePosixPath(job.name)
        if str(parts) != job.name or not parts.parts or parts.is_absolute() or ".." in parts.parts:
            raise ValueError(f"job {job.name!r}: its name must be a relative path")
        if job.name in names:
            raise ValueError(f"two jobs are named {job.name!r}")
        names.add(job.name)
    for job in jobs:
        for need in job.needs:
            if need not in names:
                raise ValueError(f"job {job.name!r} needs {need!r}, and there is no such job")
    try:
        TopologicalSorter({job.name: job.needs for job in jobs}).prepare()
    except CycleError as error:
        circle = " needs ".join(repr(name) for name in reversed(error.args[1]))
        raise ValueError(f"no job of a circle can be first: {circle}") from None
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    if address is not None and backend != "ray":
        raise ValueError("an address is that of a Ray cluster: it needs the backend ray")


class _Interrupts:
    """Counts requests to stop while the ``with`` block runs; outside the main thread: none."""

    NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self.count = 0
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> _Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = {n: signal.signal(n, self._ask) for n in self.NUMBERS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002  (a handler's signature)
        self.count += 1


class _Grid:
    """Which jobs are open, which run, and what came of the others."""

    def __init__(
        self, jobs: Iterable[Job], logs: Path, program: tuple[str, ...], quiet: bool
    ) -> None:
        self.jobs = {job.name: job for job in jobs}
        self.logs = logs
        self.program = program
        self.quiet = quiet
        self.endings: dict[str, Ending] = {}
        self.failures: dict[str, Failure] = {}
        self.running: dict[Future[Outcome], str] = {}
        self.elsewhere: dict[str, float] = {}  # when to look again at what others run
        for job in self.jobs.values():
            if job.result.exists():
                self.endings[job.name] = Ending.SKIPPED
        self.bar: Any = None
        self.shown = ""

    @property
    def open(self) -> list[Job]:
        """Jobs that have not ended, in their order."""
        return [job for job in self.jobs.values() if job.name not in self.endings]

    def run(self, runner: Runner, interrupts: _Interrupts) -> None:
        """Until every job has ended, or an interrupt."""
        with tqdm(
            total=len(self.jobs), initial=len(self.endings), unit="job", disable=self.quiet
        ) as self.bar:
            while self.open:
                if not interrupts.count:
                    self._start_ready(runner)
                elif self.running:
                    runner.interrupt(interrupts.count)
                else:
                    raise KeyboardInterrupt
                self._show()
                self._collect(interrupts)
            self._show()

    def _start_ready(self, runner: Runner) -> None:
        self._block()
        busy = set(self.running.values())
        for job in self.open:
            if len(self.running) >= runner.workers:
                return
            if job.name not in busy and self._ready(job):
                self.running[runner.submit(self._process(job))] = job.name

    def _ready(self, job: Job) -> bool:
        waited = time.monotonic() >= self.elsewhere.get(job.name, 0.0)
        return waited and all(self.endings.get(need) in DONE for need in job.needs)

    def _block(self) -> None:
        """Give up what needs a job that failed; what needs that follows the next time."""
        for job in self.open:
            if any(self.endings.get(need) in LOST for need in job.needs):
                self._ended(job.name, Ending.BLOCKED)

    def _process(self, job: Job) -> JobProcess:
        return JobProcess(
            (*self.program, *job.command), Path.cwd(), job.result.absolute(), self._log(job.name)
        )

    def _log(self, name: str) -> Path:
        return self.logs / f"{name}.log"

    def _collect(self, interrupts: _Interrupts) -> None:
        """Take in what has ended, or wait a moment for it."""
        if not self.running:
            time.sleep(TICK)
        done, _ = wait(self.running, timeout=TICK, return_when=FIRST_COMPLETED)
        for future in done:
            name = self.running.pop(future)
            error = future.exception()
            if error is None:
                self._take(name, future.result())
            elif not interrupts.count:
                text = " ".join(str(error).split()) or type(error).__name__
                self._take(name, Outcome(Ending.FAILED, text))

    def _take(self, name: str, outcome: Outcome) -> None:
        if outcome.ending is Ending.ELSEWHERE:
            if name not in self.elsewhere:
                self._say(f"{name} waits: {outcome.reason}")
            self.elsewhere[name] = time.monotonic() + ELSEWHERE_PAUSE
            return
        if outcome.ending is Ending.FAILED:
            failure = Failure(name, outcome.reason, outcome.last_line, self._log(name))
            self.failures[name] = failure
            self._say(f"{name} failed: {_sentence(failure)}")
        self._ended(name, outcome.ending)

    def _ended(self, name: str, ending: Ending) -> None:
        """The bar counts only what is there: it is full when every job is finished."""
        self.endings[name] = ending
        if ending in DONE:
            self.bar.update()

    def _say(self, line: str) -> None:
        if not self.quiet:
            self.bar.write(line, file=sys.stderr)

    def _show(self) -> None:
        """How many jobs are lost, and the names of the running ones, beside the bar."""
        counts = [(what, sum(e is what for e in self.endings.values())) for what in LOST]
        lost = [f"{count} {what.name.lower()}" for what, count in counts if count]
        text = ", ".join((*lost, *self.running.values()))
        if text != self.shown:
            self.shown = text
            self.bar.set_postfix_str(text)

    def result(self) -> GridResult:
        """What came of the jobs, in their order."""

        def names(ending: Ending) -> tuple[str, ...]:
            return tuple(name for name in self.jobs if self.endings[name] is ending)

        return GridResult(
            finished=names(Ending.FINISHED),
            skipped=names(Ending.SKIPPED),
            failed=tuple(self.failures[name] for name in names(Ending.FAILED)),
            blocked=names(Ending.BLOCKED),
        )
