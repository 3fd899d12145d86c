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


def _check_name(name: str) -> None:
    if name not in REAL_NAMES:
        raise ValueError(f"there is no real task {name!r}; there are {', '.join(REAL_NAMES)}")


class RealEnv(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """One copy of a Safety-Gymnasium task, as ``TaskEnv`` is of a vectorised one.

    ``info`` holds ``cost``: 1 at a violation, else 0. Call :meth:`close` to end its process.

    Raises:
        ValueError: if there is no such task, or as for :class:`Worker`.
    """

    def __init__(self, name: str, render_mode: str | None = None) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        _check_name(name)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
        self.name = name
        self.render_mode = render_mode
        self._worker = Worker(name, 1, render=render_mode is not None)
        self.observation_space, self.action_space = _spaces(self._worker)
        self._began = False

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  (Gymnasium's signature)
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        observation = self._worker.call("reset", 0, int(self.np_random.integers(SEEDS)))
        self._began = True
        return observation.astype(np.float32), {"cost": 0.0}

    def step(
        self, action: NDArray[np.floating]
    ) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """One step; call :meth:`reset` first."""
        if not self._began:
            raise ValueError(f"{self.name}: call reset() before step()")
        row = self._worker.call("step", np.asarray(action, dtype=np.float64)[None])
        terminated = bool(row["violation"][0] | row["success"][0])
        truncated = bool(row["timeout"][0]) and not terminated
        observation = row["observation"][0].astype(np.float32)
        info = {"cost": float(row["violation"][0])}
        return observation, float(row["reward"][0]), terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """uint8 (256, 256, 3), or None without ``render_mode="rgb_array"``."""
        if self.render_mode is None or not self._began:
            return None
        return np.asarray(self._worker.call("render", 0), dtype=np.uint8)

    def close(self) -> None:
        """End the simulator's process."""
        self._worker.close()


class RealVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """n copies that begin anew in the step that ends their episode, as ``TaskVectorEnv``.

    Raises:
        ValueError: if there is no such task, no copy, or as for :class:`Worker`.
    """

    def __init__(self, name: str, num_envs: int) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        _check_name(name)
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.name = name
        self.num_envs = num_envs
        self._worker = Worker(name, num_envs)
        self.single_observation_space, self.single_action_space = _spaces(self._worker)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._began = False

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  (Gymnasium's signature)
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin n episodes; one seed for all copies."""
        if isinstance(seed, list):
            raise ValueError("the copies share one generator: give one seed, not a list")
        super().reset(seed=seed)
        self._began = True
        return np.stack([self._begin(index) for index in range(self.num_envs)]), {}

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """One step of every copy; finished ones begin their next episode."""
        if not self._began:
            raise ValueError(f"{self.name}: call reset() before step()")
        rows = self._worker.call("step", np.asarray(actions, dtype=np.float64))
        observations = rows["observation"].astype(np.float32)
        terminated = rows["violation"] | rows["success"]
        truncated = rows["timeout"] & ~terminated
        info: dict[str, Any] = {"cost": rows["violation"].astype(np.float64)}
        done = terminated | truncated
        if done.any():
            final = np.zeros_like(observations)
            final[done] = observations[done]
            info |= {"final_obs": final, "_final_obs": done}
            for index in np.flatnonzero(done):
                observations[index] = self._begin(int(index))
        return observations, rows["reward"], terminated, truncated, info

    def _begin(self, index: int) -> Observations:
        seed = int(self.np_random.integers(SEEDS))
        return np.asarray(self._worker.call("reset", index, seed), dtype=np.float32)

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002  (Gymnasium's signature)
        """End the simulator's process."""
        self._worker.close()
