"""The replay buffer D_task of K seeds, in one memory-mapped file.

The file is what makes a run resumable: it outlives the process, and it has ``slack`` rows
more than the window that is sampled from, so that rows written after the last checkpoint
never lie over rows that the resumed run has still to sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from deep.data.normalisation import Normalisation, normalisation_of_observations
from deep.data.transitions import Transitions
from deep.train.learner import TaskBatch

__all__ = ["Arrival", "Replay"]

BLOCK = 64
BATCH_STREAM = 11


class Arrival(NamedTuple):
    """One step of N copies of each of K seeds' environments.

    Attributes:
        observation, next_observation: (K, N, observation dim); the next one is the
            episode's last where it ended, not the first of the one after.
        action, executed: (K, N, action dim), the task policy's and what was done.
        reward, cost, terminal, timeout: (K, N).
    """

    observation: NDArray[Any]
    action: NDArray[Any]
    executed: NDArray[Any]
    next_observation: NDArray[Any]
    reward: NDArray[Any]
    cost: NDArray[Any]
    terminal: NDArray[Any]
    timeout: NDArray[Any]


class Replay:
    """The last ``capacity`` transitions of each seed.

    Args:
        path: the file; made if it is absent.
        seeds: the K seeds.
        copies: N, environments a seed.
        capacity: steps of the N copies that are kept.
        slack: steps between two checkpoints, at most.
        observation_dim, action_dim: widths.
    """

    def __init__(
        self,
        path: Path,
        seeds: Sequence[int],
        copies: int,
        capacity: int,
        slack: int,
        observation_dim: int,
        action_dim: int,
    ) -> None:
        self.path = path
        self.seeds = tuple(seeds)
        self.copies = copies
        self.capacity = capacity
        self.size = capacity + slack
        self._dims = (observation_dim, action_dim)
        o, a = self._dims
        # The order of Arrival's fields.
        self._edges = np.cumsum([0, o, a, a, o, 1, 1, 1, 1]).tolist()
        shape = (len(seeds), self.size * copies, self._edges[-1])
        if path.exists() and path.stat().st_size != 4 * np.prod(shape):
            raise ValueError(f"{path}: not the replay buffer of this run")
        mode: Any = "r+" if path.exists() else "w+"
        self._rows = np.memmap(path, dtype=np.float32, mode=mode, shape=shape)
        self._block = -1
        self._draws: list[tuple[NDArray[np.float64], NDArray[np.float32]]] = []

    def add(self, step: int, arrival: Arrival) -> None:
        """Write the N transitions a seed of step ``step`` (0, 1, ...)."""
        first = step % self.size * self.copies
        target = self._rows[:, first : first + self.copies]
        for part, low, high in zip(arrival, self._edges, self._edges[1:], strict=False):
            target[..., low:high] = part if part.ndim == 3 else part[..., None]

    def sample(self, update: int, steps: int, size: int) -> TaskBatch:
        """The minibatch of ``update``, from the last ``capacity`` of ``steps`` steps, raw.

        Rows and noise are functions of seed and update alone.
        """
        draws = self._draw(update, size)
        window = min(steps, self.capacity) * self.copies
        begin = max(steps - self.capacity, 0) * self.copies
        length = self._rows.shape[1]
        picked = np.stack([draw[0][update % BLOCK] for draw in draws])
        index = (begin + (picked * window).astype(np.int64)) % length
        index += (np.arange(len(self.seeds)) * length)[:, None]
        rows = self._rows.reshape(-1, self._edges[-1]).take(index, axis=0)
        parts = [rows[..., a:b] for a, b in zip(self._edges, self._edges[1:], strict=False)]
        observation, action, executed, following, reward, cost, terminal, _ = parts
        noise = np.stack([draw[1][update % BLOCK] for draw in draws], axis=1)
        tensors = (
            observation,
            action,
            executed,
            following,
            reward[..., 0],
            cost[..., 0],
            terminal[..., 0],
            noise[0],
            noise[1],
        )
        return TaskBatch(*(torch.from_numpy(np.ascontiguousarray(x)) for x in tensors))

    def cut(self, steps: int) -> None:
        """The episodes of the last of ``steps`` steps do not go on in the next, as if timed out."""
        first = (steps - 1) % self.size * self.copies
        last = self._rows[:, first : first + self.copies]
        terminal, timeout = (Arrival._fields.index(name) for name in ("terminal", "timeout"))
        last[..., self._edges[timeout]] = 1 - last[..., self._edges[terminal]]

    def flush(self) -> None:
        """Hand what was written to the disk."""
        self._rows.flush()

    def normalisation(self, steps: int, sharpness: float = 1.0) -> tuple[Normalisation, ...]:
        """Each seed's, from its observations; actions as they are.

        With closenesses to the power ``sharpness``, see :mod:`deep.data.normalisation`.

        Of the last ``capacity`` of the first ``steps`` steps: older rows may be those of a
        stretch that was lost.
        """
        o, a = self._dims
        kept = np.arange(max(steps - self.capacity, 0) * self.copies, steps * self.copies)
        seen = self._rows[:, kept % self._rows.shape[1], :o]
        return tuple(normalisation_of_observations(rows, a, sharpness) for rows in seen)

    def transitions(self, seed: int, steps: int) -> Transitions:
        """A seed's transitions of the first ``steps`` steps, copy by copy, raw.

        Raises:
            ValueError: if the buffer has begun to forget.
        """
        if steps > self.size:
            raise ValueError(f"the replay buffer holds {self.size} steps, not {steps}")
        k = self.seeds.index(seed)
        rows = self._rows[k, : steps * self.copies]
        by_copy = rows.reshape(steps, self.copies, -1).swapaxes(0, 1).reshape(len(rows), -1)
        parts = [by_copy[:, a:b] for a, b in zip(self._edges, self._edges[1:], strict=False)]
        observation, _, executed, following, reward, cost, terminal, timeout = parts
        ended = terminal[:, 0].astype(np.bool_)
        cut = timeout[:, 0].astype(np.bool_)
        cut.reshape(self.copies, steps)[:, -1] |= True  # the recording ends there
        return Transitions(
            observation,
            executed,
            following,
            reward[:, 0],
            cost[:, 0],
            ended,
            cut & ~ended,
        )

    def _draw(self, update: int, size: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Of every seed: BLOCK updates' places in [0, 1) and noises (2, BLOCK, size, a)."""
        block = update // BLOCK
        if block != self._block:
            self._draws = []
            for seed in self.seeds:
                rng = np.random.default_rng((seed, BATCH_STREAM, block))
                places = rng.random((BLOCK, size))
                shape = (BLOCK, 2, size, self._dims[1])
                self._draws.append((places, rng.standard_normal(shape, dtype=np.float32)))
            self._block = block
        return self._draws
