"""What the task policies' learners share: settings, batches, and the policy itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, TypeAlias

import torch
from torch import Tensor, nn

from deep.data.normalisation import Normalisation
from deep.nn.networks import GaussianPolicy

__all__ = ["NormalisationOf", "TaskBatch", "TaskLearner", "TaskLosses", "TaskSettings"]


@dataclass(frozen=True)
class TaskSettings:
    """Common settings; the defaults are the authors' but for small networks' size and rate.

    Attributes:
        gamma: discount of the reward.
        hidden: widths of the hidden layers (the authors: 256, 256).
        learning_rate: Adam's, at first (the authors: 3e-4).
        final_rate: what is left of it at the end, after a linear slide over the second
            half of training (the authors: 1, a constant rate).
        batch_size: transitions a seed and update (the authors: 256).
        polyak: share of the online network that enters its target each update.
        reward_scale: factor on rewards in training; results are in raw rewards.
    """

    gamma: float = 0.99
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    final_rate: float = 0.05
    batch_size: int = 64
    polyak: float = 0.005
    reward_scale: float = 100.0

    def __post_init__(self) -> None:
        for name in ("gamma", "polyak", "final_rate"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in (0, 1], not {getattr(self, name)}")
        for name in ("learning_rate", "batch_size", "reward_scale"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")

    def rate(self, progress: float) -> float:
        """What is left of the learning rate after this part of training, in [0, 1]."""
        slid = max(progress - 0.5, 0.0) / 0.5
        return 1 - slid * (1 - self.final_rate)


NormalisationOf: TypeAlias = Callable[[float], Sequence[Normalisation]]
"""Sharpness -> each seed's normalisation of observations."""


class TaskBatch(NamedTuple):
    """B transitions for each of K seeds; float32.

    Attributes:
        observation, next_observation: (K, B, observation dim); raw in the replay buffer,
            normalised where a learner updates.
        action: (K, B, action dim), what the task policy proposed (the paper's relabelling).
        executed: (K, B, action dim), what was done: the proposal or the recovery action.
        reward: (K, B), unscaled.
        cost, terminal: (K, B), 0 or 1; a timeout is not terminal.
        noise, next_noise: (K, B, action dim), unit Gaussian, for policies that sample.
    """

    observation: Tensor
    action: Tensor
    executed: Tensor
    next_observation: Tensor
    reward: Tensor
    cost: Tensor
    terminal: Tensor
    noise: Tensor
    next_noise: Tensor


class TaskLosses(NamedTuple):
    """Each (K,), one number a seed."""

    critic: Tensor
    policy: Tensor


class TaskLearner(nn.Module, ABC):
    """A learner of task policies, for K seeds at once.

    Attributes:
        name: the method's name on the command line.
        settings: its settings.
        seeds: the K seeds.
        policy: pi_task.
    """

    name: ClassVar[str]
    settings: TaskSettings
    policy: GaussianPolicy

    def __init__(self, seeds: Sequence[int]) -> None:
        super().__init__()
        if not seeds or len(set(seeds)) != len(seeds) or min(seeds) < 0:
            raise ValueError(f"seeds must be distinct non-negative integers, not {list(seeds)}")
        self.seeds = tuple(seeds)

    def look(self, normalisation: NormalisationOf) -> None:
        """Observations are about to be normalised by ``normalisation(1)``; called once.

        For learners with networks that see them sharpened; ``normalisation(power)`` is how.
        """

    @property
    def limits(self) -> tuple[float, ...] | None:
        """What keeps each seed's policy safe by itself; None: nothing does."""
        return None

    def slow_down(self, progress: float) -> None:
        """Set the learning rates for this part of training in [0, 1)."""
        factor = self.settings.rate(progress)
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = factor * group.setdefault("initial_lr", group["lr"])

    @abstractmethod
    def update(self, batch: TaskBatch) -> TaskLosses:
        """One minibatch update."""

    @property
    @abstractmethod
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """All optimizers, in a fixed order: their states belong to a checkpoint."""
