"""RRL (Recovery RL): the critic evaluates the task policy.

Equation (obj_safe_critic) with the bootstrap on pi_task, Equation (obj_rec_p) for the
recovery policy, which is thus one greedy step on Q_c of pi_task. A careless task policy
makes safe states look lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import torch
from torch import Tensor

from deep.data.minibatches import Batch
from deep.nn.losses import q_target, recovery_objective, safety_critic_loss
from deep.nn.networks import Critic, GaussianPolicy, adam, copy_slowly, minimise
from deep.pretraining.learner import Form, Learner, Losses, Settings
from deep.tasks.task import Sizes

__all__ = ["FORM", "Rrl", "RrlSettings", "TaskPolicy", "uniform_task_policy"]

TaskPolicy: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Observations (K, B, o) and unit Gaussian noise (K, B, a) -> actions (K, B, a)."""


def uniform_task_policy(_: Tensor, noise: Tensor) -> Tensor:
    """An untrained task policy: uniform actions, from the noise by its own distribution."""
    return torch.erf(noise / 2**0.5)


@dataclass(frozen=True)
class RrlSettings(Settings):
    """The authors' settings."""


class Rrl(Learner):
    """K seeds of RRL, against one task policy."""

    name: ClassVar[str] = "rrl"

    def __init__(
        self,
        settings: RrlSettings,
        sizes: Sizes,
        seeds: Sequence[int],
        task_policy: TaskPolicy = uniform_task_policy,
    ) -> None:
        super().__init__(seeds)
        self.settings = settings
        self.task_policy = task_policy
        self.critic = Critic(seeds, *sizes, settings.hidden, settings.members)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.recovery = GaussianPolicy(seeds, *sizes, settings.hidden)
        self._optimizers = tuple(
            adam(module, settings.learning_rate) for module in (self.critic, self.recovery)
        )

    def update(self, batch: Batch, progress: float) -> Losses:  # noqa: ARG002  (no schedule here)
        """Evaluate pi_task by one step, improve pi_rec by one step."""
        s, a, following, cost, terminal, noise, next_noise = batch
        settings = self.settings
        critic_optimizer, recovery_optimizer = self._optimizers

        with torch.no_grad():
            next_action = self.task_policy(following, next_noise)
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
    settings=RrlSettings,
    learner=Rrl,
)
