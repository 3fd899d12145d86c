"""Has a critic learned anything? Diverged and saturated ones are found and named."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import torch

from deep.batches import Batch
from deep.pretrain.learner import Learner, Losses

__all__ = ["CriticHealth", "Status", "check_critics", "check_losses"]

SATURATION = 1e-3


class Status(StrEnum):
    """What is wrong with a critic, if anything."""

    SOUND = "sound"
    DIVERGED = "diverged (NaN or infinite)"
    ALL_ZERO = "saturated: it calls everything safe"
    ALL_ONE = "saturated: it calls everything lost"


@dataclass(frozen=True)
class CriticHealth:
    """One seed's critic on a batch of data.

    Attributes:
        seed: the seed.
        status: what is wrong with it.
        lowest, mean, highest: of Q_c over the batch.
    """

    seed: int
    status: Status
    lowest: float
    mean: float
    highest: float

    def __str__(self) -> str:
        values = f"Q from {self.lowest:.3g} to {self.highest:.3g}, mean {self.mean:.3g}"
        return f"seed {self.seed}: {self.status} ({values})"


@torch.no_grad()
def check_critics(learner: Learner, batch: Batch) -> tuple[CriticHealth, ...]:
    """The health of every seed's critic on the batch."""
    q = learner.critic.worst(batch.observation, batch.action)
    return tuple(
        _health(seed, float(row.min()), float(row.mean()), float(row.max()))
        for seed, row in zip(learner.seeds, q, strict=True)
    )


def _health(seed: int, lowest: float, mean: float, highest: float) -> CriticHealth:
    if not torch.isfinite(torch.tensor([lowest, mean, highest])).all():
        status = Status.DIVERGED
    elif highest < SATURATION:
        status = Status.ALL_ZERO
    elif lowest > 1 - SATURATION:
        status = Status.ALL_ONE
    else:
        status = Status.SOUND
    return CriticHealth(seed, status, lowest, mean, highest)


def check_losses(learner: Learner, losses: Losses, update: int) -> None:
    """Stop at a loss that is not a number.

    Raises:
        FloatingPointError: naming the update, the loss and the seed.
    """
    for name, loss in zip(Losses._fields, losses, strict=True):
        bad = ~torch.isfinite(loss)
        if bad.any():
            seed = learner.seeds[int(bad.int().argmax())]
            raise FloatingPointError(
                f"update {update}: the {name} loss of seed {seed} is {float(loss[bad][0])}; "
                "try a smaller learning rate, and look at the data's range"
            )
