"""One job as a process of its own: its lock, its log, how it ended, and a polite end before that.

The same function runs in a thread of the command and in a task of a Ray cluster.
"""

from __future__ import annotations

import os
import shlex
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from enum import Enum, auto
from pathlib import Path
from typing import BinaryIO

from deep.runs.lock import JobLock, LockHeldError

__all__ = ["Ending", "JobProcess", "Outcome", "run_process"]

POLL = 0.05  # seconds between two looks at the process
PATIENCE = ((signal.SIGINT, 120.0), (signal.SIGTERM, 10.0))  # seconds before the next, then SIGKILL
TAIL = 8192  # bytes of the log in which the last line is looked for


class Ending(Enum):
    """What came of a job."""

    FINISHED = auto()
    SKIPPED = auto()
    FAILED = auto()
    BLOCKED = auto()
    ELSEWHERE = auto()


@dataclass(frozen=True)
class Outcome:
    """What came of a job, and the reason where there is one to give.

    Attributes:
        ending: what came of it.
        reason: why it failed, or who else has it; else empty.
        last_line: of a failed job's log.
    """

    ending: Ending
    reason: str = ""
    last_line: str = ""


@dataclass(frozen=True)
class JobProcess:
    """What it takes to run a job on any machine that sees the same files.

    Attributes:
        arguments: program and arguments.
        folder: where it runs.
        result: exists exactly when the job is finished.
        log: gets a header and what the program prints; the lock lies beside it.
    """

    arguments: tuple[str, ...]
    folder: Path
    result: Path
    log: Path

    @property
    def lock(self) -> Path:
        """The lock file."""
        return self.log.with_name(f"{self.log.name.removesuffix('.log')}.lock")


def run_process(job: JobProcess, urgency: Callable[[], int] = lambda: 0) -> Outcome:
    """Run a job to its end, unless somebody else does or did.

    Args:
        job: the job.
        urgency: asked all the time. 0: go on; 1: end it so that it can save its state
            (SIGINT first); 2: end it at once.

    Raises:
        KeyboardInterrupt: if it had to end before its time.
        ValueError: if the file system knows no locks.
    """
    job.log.parent.mkdir(parents=True, exist_ok=True)
    try:
        lock = JobLock(job.lock)
    except LockHeldError as held:
        return Outcome(Ending.ELSEWHERE, str(held))
    with lock, job.log.open("ab") as log:
        if job.result.exists():
            return Outcome(Ending.SKIPPED)
        time_now = datetime.now().astimezone().isoformat(timespec="seconds")
        header = f"# {time_now} {socket.gethostname()}: {shlex.join(job.arguments)}\n"
        log.write(header.encode())
        log.flush()
        begin = log.tell()
        status = _status(job, log, lock, urgency)
    if status == 0 and job.result.exists():
        return Outcome(Ending.FINISHED)
    reason = f"exit status {status}" if status else f"ended without {job.result}"
    return Outcome(Ending.FAILED, reason, _last_line(job.log, begin))


def _status(job: JobProcess, log: BinaryIO, lock: JobLock, urgency: Callable[[], int]) -> int:
    """The exit status; whatever happens, no process is left behind."""
    with _interruptible():
        process = subprocess.Popen(
            job.arguments,
            cwd=job.folder,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            pass_fds=(lock.handle,),
            start_new_session=True,  # Ctrl-C in the terminal reaches it once, through _end
        )
    try:
        lock.sign(process.pid)
        while (status := process.poll()) is None:
            if urgency():
                raise KeyboardInterrupt
            time.sleep(POLL)
        return status
    finally:
        _end(process, urgency)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Processes started here hear SIGINT, which Ray's workers have blocked."""
    before = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(process: subprocess.Popen[bytes], urgency: Callable[[], int]) -> None:
    """End the process if it has not ended, at last with force, and all that it started."""
    for number, seconds in PATIENCE:
        if process.poll() is not None:
            break
        process.send_signal(number)
        deadline = time.monotonic() + seconds
        while process.poll() is None and urgency() < 2 and time.monotonic() < deadline:
            time.sleep(POLL)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _last_line(log: Path, begin: int) -> str:
    """The last line that was written after ``begin`` and says something; no line of a frame."""
    with log.open("rb") as file:
        file.seek(max(begin, log.stat().st_size - TAIL))
        text = file.read().decode(errors="replace")
    lines = reversed(text.splitlines())  # splits at \r too
    return next((line.strip() for line in lines if any(map(str.isalnum, line))), "")
