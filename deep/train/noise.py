"""The randomness of a run's actions, as a function of seed and step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ActionNoise"]

ACTION_STREAM = 9
BLOCK = 64


class ActionNoise:
    """Draws for N copies of each of K seeds, in blocks of steps."""

    def __init__(self, seeds: tuple[int, ...], copies: int, action_dim: int) -> None:
        self._seeds = seeds
        self._shape = (BLOCK, copies, action_dim)
        self._block = -1
        self._noise = self._uniform = np.empty(0, dtype=np.float32)

    def draw(self, step: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Unit Gaussian noise and uniform actions in [-1, 1], each (K, N, a)."""
        if step // BLOCK != self._block:
            self._block = step // BLOCK
            streams = [
                np.random.default_rng((seed, ACTION_STREAM, self._block)) for seed in self._seeds
            ]
            noise = [rng.standard_normal(self._shape, dtype=np.float32) for rng in streams]
            uniform = [2 * rng.random(self._shape, dtype=np.float32) - 1 for rng in streams]
            self._noise, self._uniform = np.stack(noise, axis=1), np.stack(uniform, axis=1)
        return self._noise[step % BLOCK], self._uniform[step % BLOCK]
