"""What the forms of Algorithm 1 share: their settings' common part, their nets, their row."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from deep.data.minibatches import Batch
from deep.filter.thresholds import paper_threshold
from deep.nn.networks import Critic, GaussianPolicy
from deep.tasks.task import Sizes

__all__ = ["Form", "Learner", "Losses", "Settings"]


@dataclass(frozen=True)
class Settings:
    """Common settings; the defaults are the authors' but for the size of the networks.

    Attributes:
        gamma_safe: discount of the cost.
        hidden: widths of the hidden layers (the authors: 256, 256).
        learning_rate: Adam's.
        batch_size: transitions a seed and update.
        polyak: share of the online network that enters its target each update.
        members: networks in the critic's ensemble; the largest value counts.
        violation_share: part of each batch drawn from violating transitions.
        entropy_weight: weight of log pi in the recovery loss (not in the paper).
    """

    gamma_safe: float = 0.99
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 3e-4
    batch_size: int = 256
    polyak: float = 0.005
    members: int = 2
    violation_share: float | None = 0.5
    entropy_weight: float = 0.2

    def __post_init__(self) -> None:
        _within("gamma_safe", self.gamma_safe, 0, 1)
        _within("polyak", self.polyak, 0, 1)
        if self.violation_share is not None:
            _within("violation_share", self.violation_share, 0, 1)
        for name in ("learning_rate", "batch_size", "members"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.entropy_weight < 0:
            raise ValueError(f"entropy_weight must not be negative, not {self.entropy_weight}")


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} must lie in [{low}, {high}], not {value}")


class Losses(NamedTuple):
    """Each (K,), one number a seed; ``value`` is 0 for forms without a V network."""

    critic: Tensor
    value: Tensor
    recovery: Tensor


class Learner(nn.Module, ABC):
    """One form of Algorithm 1, for K seeds at once.

    Attributes:
        name: the form's name on the command line.
        seeds: the K seeds.
        critic: Q_c; the gate uses the largest member.
        recovery: pi_rec; behavior correction executes its mean.
    """

    name: ClassVar[str]
    critic: Critic
    recovery: GaussianPolicy

    def __init__(self, seeds: Sequence[int]) -> None:
        super().__init__()
        if not seeds or len(set(seeds)) != len(seeds) or min(seeds) < 0:
            raise ValueError(f"seeds must be distinct non-negative integers, not {list(seeds)}")
        self.seeds = tuple(seeds)

    @abstractmethod
    def update(self, batch: Batch, progress: float) -> Losses:
        """One minibatch update; ``progress`` in [0, 1) is the part of training done."""

    @property
    @abstractmethod
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """All optimizers, in a fixed order: their states belong to a checkpoint."""


@dataclass(frozen=True)
class Form:
    """What a form is made of; the study's side of it is a row of :mod:`deep.runs.forms`.

    Attributes:
        settings: what can be chosen, with the defaults.
        learner: settings, sizes and seeds -> the K learners; its ``name`` is the form's.
        discount: H -> gamma_safe; None: the settings' own, the same for every task.
        threshold: gamma_safe and H -> epsilon, where none is given.
        threshold_rule: the same in a table's words.
    """

    settings: type[Settings]
    learner: type[Learner]
    discount: Callable[[int], float] | None = None
    threshold: Callable[[float, int], float] = paper_threshold
    threshold_rule: str = "gamma^(H+1/2)"

    @property
    def name(self) -> str:
        """The form's name on the command line and in files."""
        return self.learner.name

    def build(self, settings: Settings, sizes: Sizes, seeds: Sequence[int]) -> Learner:
        """K learners, freshly initialised."""
        build: Callable[..., Learner] = self.learner
        return build(settings, sizes, seeds)
