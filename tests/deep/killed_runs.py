"""A run that is killed again and again: ``python -m tests.deep.killed_runs CONFIG OUT``.

OUT/whole is left alone. In OUT/killed each moment is one process, which goes on from what the
one before left and kills itself.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

import deep.train.run
from deep.filter.task_policy import TrainedPolicy
from deep.runs.folder import CsvLog
from deep.train.config import train_config_from_json
from deep.train.replay import Replay
from deep.train.run import train

MOMENTS = (
    ("step", 0),  # nothing has happened yet
    ("step", 13),  # before the first checkpoint, among random actions
    ("step", 17),  # after it
    ("row", 2),  # a row of the log is written by half
    ("checkpoint", 0),  # not written yet
    ("step", 44),  # the replay buffer has begun to forget
    ("step", 59),  # the last step
    ("policy", 0),  # the first is in its file, the result is not
)


def die() -> None:
    """As by the machine: nothing is cleaned up."""
    os.kill(os.getpid(), signal.SIGKILL)


def die_at(kind: str, number: int) -> None:
    """Arrange to be killed at a moment of the run's."""
    if kind == "step":
        _die_after(Replay, "add", lambda _, step, __: step == number)
    elif kind == "checkpoint":
        calls = iter(range(number))
        _die_before(deep.train.run, "save_checkpoint", lambda *_: next(calls, None) is None)
    elif kind == "row":
        _half_a_row(number)
    else:
        _die_after(TrainedPolicy, "save", lambda *_: True)


def _die_before(place: Any, name: str, moment: Callable[..., bool]) -> None:
    function = getattr(place, name)

    def killed(*arguments: Any) -> Any:
        if moment(*arguments):
            die()
        return function(*arguments)

    setattr(place, name, killed)


def _die_after(place: Any, name: str, moment: Callable[..., bool]) -> None:
    function = getattr(place, name)

    def killed(*arguments: Any) -> None:
        function(*arguments)
        if moment(*arguments):
            die()

    setattr(place, name, killed)


def _half_a_row(number: int) -> None:
    write = CsvLog.write
    calls = iter(range(number))

    def killed(self: CsvLog, rows: Any) -> None:
        if next(calls, None) is None:
            with self._path.open("a") as file:
                file.write("9999,3,1")
            die()
        write(self, rows)

    CsvLog.write = killed  # type: ignore[method-assign]  # in a process of its own


def main(config: str, out: str) -> None:
    """Run through once, then through the moments to the end."""
    torch.set_num_threads(1)
    run = train_config_from_json(json.loads(config))
    folder = Path(out) / "killed"
    train(run, Path(out) / "whole", quiet=True)
    for kind, number in MOMENTS:
        process = os.fork()
        if process == 0:
            die_at(kind, number)
            train(run, folder, quiet=True)
            os._exit(0)
        _, status = os.waitpid(process, 0)
        if not os.WIFSIGNALED(status) or os.WTERMSIG(status) != signal.SIGKILL:
            raise SystemExit(f"{kind} {number} never came")
    train(run, folder, quiet=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
