"""The real Safety-Gymnasium tasks behind the interface of the vectorised ones.

The simulator runs in a process of its own (``worker.py``), with the Python that
``DEAD_ENDS_SAFETY_PYTHON`` names; ``scripts/install_safety_gymnasium.sh`` makes it. As in
the vectorised tasks an episode ends at its first violation, and at StaticEnv's goal.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import weakref
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from deep.tasks.task import Bools, Floats, Observations

__all__ = ["REAL_NAMES", "RealEnv", "RealVectorEnv", "Worker", "worker_python"]

REAL_NAMES = ("static-env", "dynamic-env", "point-goal1", "car-goal1", "doggo-goal1")
VARIABLE = "DEAD_ENDS_SAFETY_PYTHON"
SEEDS = 2**31


def worker_python() -> str | None:
    """The Python that can import Safety-Gymnasium, or None where none is named."""
    return os.environ.get(VARIABLE)


class Worker:
    """A process with n copies of a task; its methods are those of ``worker.Copies``.

    Raises:
        ValueError: if no Python is named, or it cannot run Safety-Gymnasium.
    """

    def __init__(self, name: str, count: int, *, render: bool = False) -> None:
        python = worker_python()
        if python is None:
            raise ValueError(
                f"{VARIABLE} does not name a Python with Safety-Gymnasium; "
                "scripts/install_safety_gymnasium.sh FOLDER makes FOLDER/bin/python"
            )
        script = Path(__file__).with_name("worker.py")
        try:
            self._process = subprocess.Popen(
                [python, str(script)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError as error:
            raise ValueError(f"{VARIABLE}: {python} cannot be run ({error.strerror})") from error
        self._finish = weakref.finalize(self, _end, self._process)
        self.spaces: dict[str, Any] = self.call("make", name, count, render)

    def call(self, method: str, *arguments: Any) -> Any:
        """The result of a method of ``worker.Copies``.

        Raises:
            ValueError: if the worker reports an error or has ended.
        """
        requests, answers = self._process.stdin, self._process.stdout
        assert requests is not None
        assert answers is not None
        try:
            pickle.dump((method, arguments), requests)
            requests.flush()
            done, result = pickle.load(answers)
        except (EOFError, BrokenPipeError) as error:
            raise ValueError(
                f"the Safety-Gymnasium process of {worker_python()} has ended; "
                "run it on deep/tasks/safety_gym/worker.py to see why"
            ) from error
        if not done:
            raise ValueError(f"Safety-Gymnasium: {result}")
        return result

    def close(self) -> None:
        """End the process."""
        self._finish()


def _end(process: subprocess.Popen[bytes]) -> None:
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    process.terminate()
    process.wait()


def _spaces(worker: Worker) -> tuple[spaces.Space[NDArray[Any]], spaces.Space[NDArray[Any]]]:
    low = np.asarray(worker.spaces["observation_low"], dtype=np.float32)
    high = np.asarray(worker.spaces["observation_high"], dtype=np.float32)
    action_dim = worker.spaces["action_dim"]
    return spaces.Box(low, high, dtype=np.float32), spaces.Box(-1.0, 1.0, (action_dim,), np.float32)
