"""Soft actor-critic, the task policy's learner in Algorithm 2 (line 17: maximise J(pi)).

For K seeds at once, with a fixed temperature alpha and twin critics Q1, Q2:

    target  r + gamma (1 - terminal) (min(Q1', Q2')(s', a') - alpha log pi(a'|s')),  a' ~ pi(s')
    critic  E (target - Q_i(s, a))^2
    policy  E alpha log pi(a|s) - min(Q1, Q2)(s, a),                                 a ~ pi(s)

(Haarnoja et al., 2018). ``a`` is the task policy's own action, also where behavior
correction executed another one, so that the correction is a part of the environment. A
timeout is no terminal state: the target bootstraps through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from deep.nn.losses import q_loss
from deep.nn.networks import ActionValue, GaussianPolicy, adam, copy_slowly, minimise
from deep.tasks.task import Sizes
from deep.train.learner import TaskBatch, TaskLearner, TaskLosses, TaskSettings

__all__ = ["Sac", "SacSettings", "soft_target"]


@dataclass(frozen=True)
class SacSettings(TaskSettings):
    """The authors' settings (their code: temperature 0.2, rewards times 100).

    Attributes:
        temperature: alpha, the weight of the entropy; fixed.
    """

    temperature: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.temperature < 0:
            raise ValueError(f"temperature must not be negative, not {self.temperature}")


class Sac(TaskLearner):
    """K seeds of SAC."""

    name: ClassVar[str] = "sac"

    def __init__(self, settings: SacSettings, sizes: Sizes, seeds: Sequence[int]) -> None:
        super().__init__(seeds)
        self.settings: SacSettings = settings
        self.critic = ActionValue(seeds, *sizes, settings.hidden)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.policy = GaussianPolicy(seeds, *sizes, settings.hidden, name="task policy")
        self._optimizers = tuple(
            adam(module, settings.learning_rate) for module in (self.critic, self.policy)
        )

    def update(self, batch: TaskBatch) -> TaskLosses:
        """One step of the critics, one of the policy, one of the targets."""
        settings = self.settings
        critic_optimizer, policy_optimizer = self._optimizers

        with torch.no_grad():
            next_action, next_log_prob = self.policy.sample(
                batch.next_observation, batch.next_noise
            )
            next_value = self.critic_target.least(batch.next_observation, next_action)
            target = soft_target(batch, settings, next_value, next_log_prob)
        q = self.critic(batch.observation, batch.action)
        critic_loss = minimise(critic_optimizer, q_loss(q, target))

        action, log_prob = self.policy.sample(batch.observation, batch.noise)
        value = self.critic.least(batch.observation, action)
        policy_loss = minimise(
            policy_optimizer, (settings.temperature * log_prob - value).mean(dim=-1)
        )
        copy_slowly(self.critic, self.critic_target, settings.polyak)
        return TaskLosses(critic_loss, policy_loss)

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """Critic, policy."""
        return self._optimizers


def soft_target(
    batch: TaskBatch, settings: SacSettings, next_value: Tensor, next_log_prob: Tensor
) -> Tensor:
    """r + gamma (1 - terminal) (Q'(s', a') - alpha log pi(a'|s')), with scaled r; (K, B)."""
    soft_value = next_value - settings.temperature * next_log_prob
    reward = settings.reward_scale * batch.reward
    return reward + settings.gamma * (1 - batch.terminal) * soft_value
