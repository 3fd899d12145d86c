"""IQL, implicit Q-learning (Kostrikov et al., 2021): a task policy from offline data alone.

With twin critics, an expectile tau and m = 1 - terminal, on transitions (s, a, r, s'):

    value   E L_2^tau(min(Q1', Q2')(s, a) - V(s)),    L_2^tau(u) = |tau - 1(u < 0)| u^2
    policy  -E min(exp(beta (min(Q1', Q2')(s, a) - V(s))), 100) log pi(a|s)
    critic  E (r + gamma m V(s') - Q_i(s, a))^2

Nothing is asked of actions that the data do not show. A timeout is no terminal state. It
knows no costs: what it avoids, it avoids because reward ends there. The policy is SAC's
tanh-Gaussian (the published one has the same deviation in all states), and all learning
rates slide as SAC's do (the published one lets only the policy's fall, along a cosine).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar

import torch

from deep.nn.losses import advantage_weighted_regression, q_loss, v_loss
from deep.nn.networks import ActionValue, GaussianPolicy, TaskValue, adam, copy_slowly, minimise
from deep.tasks.task import Sizes
from deep.train.learner import TaskBatch, TaskLearner, TaskLosses, TaskSettings

__all__ = ["Iql", "IqlSettings"]


@dataclass(frozen=True)
class IqlSettings(TaskSettings):
    """The published settings for locomotion, whose returns are scaled to about 1000 as well.

    Attributes:
        expectile: tau, the weight of data actions that are better than V, in (0, 1).
        beta: how strongly better data actions are preferred.
    """

    expectile: float = 0.7
    beta: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.expectile < 1:
            raise ValueError(f"expectile must lie in (0, 1), not {self.expectile}")
        if self.beta < 0:
            raise ValueError(f"beta must not be negative, not {self.beta}")


class Iql(TaskLearner):
    """K seeds of IQL."""

    name: ClassVar[str] = "iql"

    def __init__(self, settings: IqlSettings, sizes: Sizes, seeds: Sequence[int]) -> None:
        super().__init__(seeds)
        self.settings: IqlSettings = settings
        self.critic = ActionValue(seeds, *sizes, settings.hidden)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.value = TaskValue(seeds, sizes.observation, settings.hidden)
        self.policy = GaussianPolicy(seeds, *sizes, settings.hidden, name="task policy")
        self._optimizers = tuple(
            adam(module, settings.learning_rate)
            for module in (self.value, self.policy, self.critic)
        )

    def update(self, batch: TaskBatch) -> TaskLosses:
        """One step of the value, one of the policy, one of the critics and their targets."""
        settings = self.settings
        s, a = batch.observation, batch.action
        value_optimizer, policy_optimizer, critic_optimizer = self._optimizers

        q = self.critic_target.least(s, a)
        minimise(value_optimizer, v_loss(q, self.value(s), settings.expectile))

        with torch.no_grad():
            baseline = self.value(s)
            target = settings.reward_scale * batch.reward + settings.gamma * (
                1 - batch.terminal
            ) * self.value(batch.next_observation)
        # The regression is written for costs: the negative of what is good.
        policy_loss = minimise(
            policy_optimizer,
            advantage_weighted_regression(
                -q, -baseline, self.policy.log_prob(s, a), settings.beta, torch.ones_like(q)
            ),
        )

        critic_loss = minimise(critic_optimizer, q_loss(self.critic(s, a), target))
        copy_slowly(self.critic, self.critic_target, settings.polyak)
        return TaskLosses(critic_loss, policy_loss)

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """Value, policy, critics."""
        return self._optimizers
