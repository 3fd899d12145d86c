"""RRL (MSDP): RRL with the bootstrap on its own recovery policy.

Equation (obj_safe_critic) with pi = pi_rec: multi-step dynamic programming, whose fixed
point is Q_c* if pi_rec is greedy. It asks the critic about actions that no data show.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar

import torch

from deep.data.minibatches import Batch
from deep.nn.losses import q_target, recovery_objective, safety_critic_loss
from deep.nn.networks import Critic, GaussianPolicy, adam, copy_slowly, minimise
from deep.pretraining.learner import Form, Learner, Losses, Settings
from deep.tasks.task import Sizes

__all__ = ["FORM", "RrlMsdp", "RrlMsdpSettings"]


@dataclass(frozen=True)
class RrlMsdpSettings(Settings):
    """The authors' settings."""


class RrlMsdp(Learner):
    """K seeds of RRL (MSDP)."""

    name: ClassVar[str] = "rrl-msdp"

    def __init__(self, settings: RrlMsdpSettings, sizes: Sizes, seeds: Sequence[int]) -> None:
        super().__init__(seeds)
        self.settings = settings
        self.critic = Critic(seeds, *sizes, settings.hidden, settings.members)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.recovery = GaussianPolicy(seeds, *sizes, settings.hidden)
        self._optimizers = tuple(
            adam(module, settings.learning_rate) for module in (self.critic, self.recovery)
        )

    def update(self, batch: Batch, progress: float) -> Losses:  # noqa: ARG002  (no schedule here)
        """Evaluate pi_rec by one step, improve it by one step."""
        s, a, following, cost, terminal, noise, next_noise = batch
        settings = self.settings
        critic_optimizer, recovery_optimizer = self._optimizers

        with torch.no_grad():
            next_action, _ = self.recovery.sample(following, next_noise)
            next_value = self.critic_target.worst(following, next_action)
            target = q_target(cost, terminal, settings.gamma_safe, next_value)
        critic_loss = minimise(critic_optimizer, safety_critic_loss(self.critic(s, a), target))

        action, log_prob = self.recovery.sample(s, noise)
        recovery_loss = minimise(
            recovery_optimizer,
            recovery_objective(
                self.critic.worst(s, action), log_prob, settings.entropy_weight, weight=1 - cost
            ),
        )
        copy_slowly(self.critic, self.critic_target, settings.polyak)
        return Losses(critic_loss, torch.zeros_like(critic_loss), recovery_loss)

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """Critic, recovery."""
        return self._optimizers


FORM = Form(
    settings=RrlMsdpSettings,
    learner=RrlMsdp,
)
