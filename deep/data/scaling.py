"""Normalisation of K seeds' observations and actions, each with its own numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from deep.data.normalisation import Normalisation

__all__ = ["Scaling", "columns"]


class Scaling:
    """What networks see of raw tensors (K, B, .).

    Args:
        normalisation: one a seed.
    """

    def __init__(self, normalisation: Sequence[Normalisation]) -> None:
        self.normalisation = tuple(normalisation)
        self._centre = columns(n.observation_centre for n in normalisation)
        self._scale = columns(n.observation_scale for n in normalisation)
        self._action_centre = columns(n.action_centre for n in normalisation)
        self._action_scale = columns(n.action_scale for n in normalisation)
        ones = (1.0,) * self._centre.shape[-1]
        self._power = columns(n.observation_power or ones for n in normalisation)
        self._sharp = bool((self._power != 1).any())

    def observation(self, raw: Tensor) -> Tensor:
        """(raw ** power - centre) / scale, as :meth:`Normalisation.powered` has it."""
        if self._sharp:
            raw = torch.where(self._power != 1, raw.clamp(min=0) ** self._power, raw)
        return (raw - self._centre) / self._scale

    def action(self, raw: Tensor) -> Tensor:
        """(raw - centre) / scale."""
        return (raw - self._action_centre) / self._action_scale

    def raw_action(self, action: Tensor) -> Tensor:
        """The inverse of :meth:`action`."""
        return action * self._action_scale + self._action_centre


def columns(rows: Iterable[Sequence[float]]) -> Tensor:
    """(K, 1, n) from K rows."""
    return torch.tensor(list(rows), dtype=torch.float32)[:, None]
