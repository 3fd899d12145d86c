"""DEARRL (IQL): DEA-RRL's critic, with the recovery policy extracted from data actions.

The critic is that of :mod:`deep.pretraining.dea_rrl`. The policy is fitted by
advantage-weighted regression, so it only ever proposes what the data show: where no data
action is safe it cannot be safe either (the paper's ablation).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar

import torch

from deep.data.minibatches import Batch
from deep.nn.losses import advantage_weighted_regression, q_loss, q_target, v_loss
from deep.nn.networks import Critic, GaussianPolicy, StateValue, adam, copy_slowly, minimise
from deep.pretraining.learner import Form, Learner, Losses, Settings
from deep.tasks.task import Sizes

__all__ = ["FORM", "DearrlIql", "DearrlIqlSettings"]


@dataclass(frozen=True)
class DearrlIqlSettings(Settings):
    """The authors' settings (expectile 0.3, beta 10).

    Attributes:
        expectile: weight of data actions that are worse than V, in [0, 1).
        beta: how strongly better data actions are preferred.
    """

    expectile: float = 0.3
    beta: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.expectile < 1:
            raise ValueError(f"expectile must lie in [0, 1), not {self.expectile}")


class DearrlIql(Learner):
    """K seeds of DEARRL (IQL)."""

    name: ClassVar[str] = "dearrl-iql"

    def __init__(self, settings: DearrlIqlSettings, sizes: Sizes, seeds: Sequence[int]) -> None:
        super().__init__(seeds)
        self.settings = settings
        self.critic = Critic(seeds, *sizes, settings.hidden, settings.members)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.value = StateValue(seeds, sizes.observation, settings.hidden)
        self.recovery = GaussianPolicy(seeds, *sizes, settings.hidden)
        self._optimizers = tuple(
            adam(module, settings.learning_rate)
            for module in (self.critic, self.value, self.recovery)
        )

    def update(self, batch: Batch, progress: float) -> Losses:  # noqa: ARG002  (no schedule here)
        """Lines 3 to 6 of Algorithm 1, line 6 by regression."""
        s, a, following, cost, terminal, _, _ = batch
        settings = self.settings
        critic_optimizer, value_optimizer, recovery_optimizer = self._optimizers

        with torch.no_grad():
            target = q_target(cost, terminal, settings.gamma_safe, self.value(following))
        critic_loss = minimise(critic_optimizer, q_loss(self.critic(s, a), target))

        with torch.no_grad():
            q = self.critic_target.worst(s, a)
        value_loss = minimise(value_optimizer, v_loss(q, self.value(s), settings.expectile))

        with torch.no_grad():
            baseline = self.value(s)
        log_prob = self.recovery.log_prob(s, a)
        recovery_loss = minimise(
            recovery_optimizer,
            advantage_weighted_regression(q, baseline, log_prob, settings.beta, weight=1 - cost),
        )
        copy_slowly(self.critic, self.critic_target, settings.polyak)
        return Losses(critic_loss, value_loss, recovery_loss)

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """Critic, value, recovery."""
        return self._optimizers


FORM = Form(
    settings=DearrlIqlSettings,
    learner=DearrlIql,
)
