"""DEA-RRL: the paper's Algorithm 1.

The critic is learned by expectile regression on data actions alone (Equations (v_loss)
and (q_loss)), the recovery policy by the advantage policy gradient, which may try actions
that no data show. Its fixed point is an expectile of Q_c, not Q_c*: the smaller the
expectile, the nearer.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar

import torch

from deep.data.minibatches import Batch
from deep.nn.losses import advantage_policy_gradient, q_loss, q_target, v_loss
from deep.nn.networks import Critic, GaussianPolicy, StateValue, adam, copy_slowly, minimise
from deep.pretraining.learner import Form, Learner, Losses, Settings
from deep.tasks.task import Sizes

__all__ = ["FORM", "DeaRrl", "DeaRrlSettings"]


@dataclass(frozen=True)
class DeaRrlSettings(Settings):
    """The authors' settings (their code: expectile 0.3, advantage scale 10).

    Attributes:
        expectile: weight of data actions that are worse than V, in [0, 1).
        advantage_scale: weight of the advantage against the entropy.
    """

    expectile: float = 0.3
    advantage_scale: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.expectile < 1:
            raise ValueError(f"expectile must lie in [0, 1), not {self.expectile}")


class DeaRrl(Learner):
    """K seeds of DEA-RRL."""

    name: ClassVar[str] = "dea-rrl"

    def __init__(self, settings: DeaRrlSettings, sizes: Sizes, seeds: Sequence[int]) -> None:
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
        """Lines 3 to 6 of Algorithm 1."""
        s, a, following, cost, terminal, noise, _ = batch
        settings = self.settings
        critic_optimizer, value_optimizer, recovery_optimizer = self._optimizers

        with torch.no_grad():
            target = q_target(cost, terminal, settings.gamma_safe, self.value(following))
        critic_loss = minimise(critic_optimizer, q_loss(self.critic(s, a), target))

        with torch.no_grad():
            q = self.critic_target.worst(s, a)
        value_loss = minimise(value_optimizer, v_loss(q, self.value(s), settings.expectile))

        action, log_prob = self.recovery.sample(s, noise)
        with torch.no_grad():
            baseline = self.value(s)
        recovery_loss = minimise(
            recovery_optimizer,
            advantage_policy_gradient(
                self.critic.worst(s, action),
                baseline,
                log_prob,
                settings.advantage_scale,
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
    settings=DeaRrlSettings,
    learner=DeaRrl,
)
