"""DEA-RRL (annealed): this project's recipe, Algorithm 1 with its expectile driven to 0.

What differs from :mod:`deep.pretraining.dea_rrl`, and why:

* the expectile falls geometrically from 0.3 to ``final_expectile``, so that the fixed point
  tends to Q_c* (over data actions) while early training is as stable as the paper's;
* gamma_safe comes from the horizon, H / (H + 1): where the residual that a critic can
  afford is largest; with 0.99 a wrong value near the boundary takes hundreds of steps to
  fade;
* the critic minimises the cross-entropy, whose minimiser is the same but whose gradient
  does not vanish in a saturated sigmoid;
* V learns from the most pessimistic member of a larger ensemble: it errs to the safe side;
* the recovery policy has no entropy bonus and reaches the ends of the action range; the
  learning rate falls to 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar

import torch

from deep.data.minibatches import Batch
from deep.filter.thresholds import discount_from_horizon, low_threshold
from deep.nn.losses import advantage_policy_gradient, cross_entropy_q_loss, q_target, v_loss
from deep.nn.networks import Critic, GaussianPolicy, StateValue, adam, copy_slowly, minimise
from deep.pretraining.learner import Form, Learner, Losses, Settings
from deep.tasks.task import Sizes

__all__ = ["FORM", "DeaRrlAnnealed", "DeaRrlAnnealedSettings"]


@dataclass(frozen=True)
class DeaRrlAnnealedSettings(Settings):
    """The recipe's settings.

    Attributes:
        first_expectile, final_expectile: the schedule's ends, both in (0, 1).
        anneal: the part of training after which the final expectile is reached.
        final_rate: the learning rate's last value over its first.
        reach: of the recovery policy, see :class:`deep.nn.networks.GaussianPolicy`.
    """

    learning_rate: float = 1e-3
    polyak: float = 0.02
    members: int = 3
    violation_share: float | None = None
    entropy_weight: float = 0.0
    first_expectile: float = 0.3
    final_expectile: float = 0.01
    anneal: float = 0.5
    final_rate: float = 0.02
    reach: float = 1.1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("first_expectile", "final_expectile", "final_rate", "anneal"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in (0, 1], not {getattr(self, name)}")

    def expectile(self, progress: float) -> float:
        """The expectile after this part of training: a geometric slide, then constant."""
        slid = min(progress / self.anneal, 1.0)
        return float(self.first_expectile * (self.final_expectile / self.first_expectile) ** slid)

    def rate(self, progress: float) -> float:
        """The learning rate after this part of training: constant, then a geometric slide."""
        slid = max(progress - self.anneal, 0.0) / max(1 - self.anneal, 1e-9)
        return float(self.learning_rate * self.final_rate**slid)


class DeaRrlAnnealed(Learner):
    """K seeds of DEA-RRL (annealed)."""

    name: ClassVar[str] = "dea-rrl-annealed"

    def __init__(
        self, settings: DeaRrlAnnealedSettings, sizes: Sizes, seeds: Sequence[int]
    ) -> None:
        super().__init__(seeds)
        self.settings = settings
        self.critic = Critic(seeds, *sizes, settings.hidden, settings.members)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.value = StateValue(seeds, sizes.observation, settings.hidden)
        self.recovery = GaussianPolicy(seeds, *sizes, settings.hidden, settings.reach)
        self._optimizers = tuple(
            adam(module, settings.learning_rate)
            for module in (self.critic, self.value, self.recovery)
        )

    def update(self, batch: Batch, progress: float) -> Losses:
        """Lines 3 to 6 of Algorithm 1, on the schedule."""
        s, a, following, cost, terminal, noise, _ = batch
        settings = self.settings
        critic_optimizer, value_optimizer, recovery_optimizer = self._optimizers
        for optimizer in self._optimizers:
            for group in optimizer.param_groups:
                group["lr"] = settings.rate(progress)

        with torch.no_grad():
            target = q_target(cost, terminal, settings.gamma_safe, self.value(following))
        critic_loss = minimise(
            critic_optimizer, cross_entropy_q_loss(self.critic.logits(s, a), target)
        )

        with torch.no_grad():
            q = self.critic_target.worst(s, a)
        expectile = settings.expectile(progress)
        value_loss = minimise(value_optimizer, v_loss(q, self.value(s), expectile))

        action, log_prob = self.recovery.sample(s, noise)
        with torch.no_grad():
            baseline = self.value(s)
        recovery_loss = minimise(
            recovery_optimizer,
            advantage_policy_gradient(
                self.critic.worst(s, action),
                baseline,
                log_prob,
                1.0,
                settings.entropy_weight,
                weight=1 - cost,
            ),
        )
        copy_slowly(self.critic, self.critic_target, settings.polyak)
        return Losses(critic_loss, value_loss, recovery_loss)

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """Critic, value, recovery."""
        return self._optimizers


FORM = Form(
    settings=DeaRrlAnnealedSettings,
    learner=DeaRrlAnnealed,
    discount=discount_from_horizon,
    threshold=low_threshold,
    threshold_rule="gamma^H/4",
)
