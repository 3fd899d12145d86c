"""What happens during training, counted for each seed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep.tasks.vectorised import Arrived

__all__ = ["Counts"]


@dataclass
class Counts:
    """What has happened to K seeds since the start, and since the last row of the log."""

    episodes: NDArray[np.int64]
    violations: NDArray[np.int64]
    interventions: NDArray[np.int64]
    logged_interventions: NDArray[np.int64]
    logged_steps: int
    returns: list[list[float]]
    lengths: list[list[int]]
    running_return: NDArray[np.float64]
    running_length: NDArray[np.int64]
    seconds: float

    @classmethod
    def zero(cls, seeds: int, copies: int) -> Counts:
        def zeros() -> NDArray[np.int64]:
            return np.zeros(seeds, dtype=np.int64)

        return cls(
            zeros(), zeros(), zeros(), zeros(), 0,
            [[] for _ in range(seeds)], [[] for _ in range(seeds)],
            np.zeros((seeds, copies)), np.zeros((seeds, copies), dtype=np.int64), 0.0,
        )  # fmt: skip

    def add(self, arrived: Arrived, intervened: NDArray[np.bool_]) -> None:
        """One step of all copies."""
        self.running_return += arrived.reward
        self.running_length += 1
        self.interventions += intervened.sum(axis=1)
        self.violations += (arrived.cost > 0).sum(axis=1)
        for k, n in np.argwhere(arrived.terminal | arrived.timeout):
            self.episodes[k] += 1
            self.returns[k].append(float(self.running_return[k, n]))
            self.lengths[k].append(int(self.running_length[k, n]))
            self.running_return[k, n] = self.running_length[k, n] = 0

    def row(self, k: int, step: int) -> tuple[object, ...]:
        """From episodes to length, of seed k at environment step ``step``."""
        since = self.interventions[k] - self.logged_interventions[k]
        ended = bool(self.returns[k])
        return (
            int(self.episodes[k]),
            int(self.violations[k]),
            f"{since / (step - self.logged_steps):.6g}",
            f"{np.mean(self.returns[k]):.6g}" if ended else "",
            f"{np.mean(self.lengths[k]):.6g}" if ended else "",
        )

    def begin_row(self, step: int) -> None:
        """What the next row counts begins here."""
        self.logged_steps = step
        self.logged_interventions = self.interventions.copy()
        for k in range(len(self.returns)):
            self.returns[k], self.lengths[k] = [], []

    def to_json(self) -> dict[str, Any]:
        """Plain lists."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in plain.items()}

    @classmethod
    def from_json(cls, plain: dict[str, Any]) -> Counts:
        """What :meth:`to_json` gave."""
        lists = {"returns", "lengths", "logged_steps", "seconds"}
        entries: dict[str, Any] = {k: v if k in lists else np.array(v) for k, v in plain.items()}
        return cls(**entries)
