"""Minibatches as a function of seed and update number.

Update t of seed k always sees the same rows and the same noise, whatever else is trained
beside it and wherever training was interrupted: nothing but t has to be remembered.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deep.data.transitions import Transitions

__all__ = ["Batch", "Batches"]

BLOCK = 64


class Batch(NamedTuple):
    """B transitions for each of K seeds; float32.

    Attributes:
        observation, next_observation: (K, B, observation dim).
        action: (K, B, action dim).
        cost, terminal: (K, B), 0 or 1.
        noise, next_noise: (K, B, action dim), unit Gaussian, for policies that sample.
    """

    observation: Tensor
    action: Tensor
    next_observation: Tensor
    cost: Tensor
    terminal: Tensor
    noise: Tensor
    next_noise: Tensor


class _Draw(NamedTuple):
    """The rows (BLOCK, B) and noises (2, BLOCK, B, action dim) of BLOCK updates of a seed."""

    rows: NDArray[np.int64]
    noise: NDArray[np.float32]


class Batches:
    """Draws the minibatches.

    Args:
        data: one data set for all seeds, or one a seed.
        seeds: the K seeds.
        size: B.
        violation_share: the part of each batch that is drawn from violating transitions;
            None: as many as there are among all.
        device: where the tensors go.

    Raises:
        ValueError: if the numbers of data sets and seeds do not match.
    """

    def __init__(
        self,
        data: Sequence[Transitions],
        seeds: Sequence[int],
        size: int,
        violation_share: float | None,
        device: torch.device,
    ) -> None:
        if len(data) not in (1, len(seeds)):
            raise ValueError(f"{len(data)} data sets for {len(seeds)} seeds: give one, or one each")
        self.seeds = tuple(seeds)
        self.size = size
        self.violation_share = violation_share
        self._device = device
        # Rows of seed k are offset[k] + index: one gather for all seeds.
        lengths = [len(part) for part in data]
        starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self._offsets = starts if len(data) == len(seeds) else np.zeros(len(seeds), dtype=np.int64)
        self._lengths = lengths if len(data) == len(seeds) else lengths * len(seeds)
        violating = [np.flatnonzero(part.costs == 1) for part in data]
        self._violating = violating if len(data) == len(seeds) else violating * len(seeds)
        self._columns = tuple(
            torch.from_numpy(np.concatenate([np.asarray(getattr(part, name)) for part in data]))
            .to(torch.float32)
            .to(device)
            for name in (
                "observations",
                "actions",
                "next_observations",
                "costs",
                "terminals",
                "rewards",
            )
        )
        self._action_dim = data[0].actions.shape[1]
        self._block = -1
        self._draws: list[_Draw] = []

    def get(self, update: int) -> Batch:
        """The batch of this update (0, 1, ...)."""
        index = self._rows(update)
        observation, action, following, cost, terminal = (c[index] for c in self._columns[:5])
        noise = np.stack([draw.noise[:, update % BLOCK] for draw in self._draws], axis=1)
        first, second = torch.from_numpy(noise).to(self._device)
        return Batch(observation, action, following, cost, terminal, first, second)

    def rewards(self, update: int) -> Tensor:
        """The rewards (K, B) of the same transitions, for learners of task policies."""
        return self._columns[5][self._rows(update)]

    def _rows(self, update: int) -> Tensor:
        """Which transitions (K, B) the update gets."""
        block, place = divmod(update, BLOCK)
        if block != self._block:
            self._draws = [self._draw(k, block) for k in range(len(self.seeds))]
            self._block = block
        rows = np.stack([draw.rows[place] for draw in self._draws])
        return torch.from_numpy(rows).to(self._device)

    def _draw(self, k: int, block: int) -> _Draw:
        rng = np.random.default_rng((self.seeds[k], block))
        rows = rng.integers(self._lengths[k], size=(BLOCK, self.size))
        if self.violation_share is not None:
            share = round(self.violation_share * self.size)
            picked = rng.integers(len(self._violating[k]), size=(BLOCK, share))
            rows[:, :share] = self._violating[k][picked]
        shape = (2, BLOCK, self.size, self._action_dim)
        return _Draw(rows + self._offsets[k], rng.standard_normal(shape, dtype=np.float32))
