"""WCSAC, worst-case soft actor-critic (Yang et al., 2021): a safe baseline without correction.

SAC's reward critics, and beside them the discounted cost of an episode as a Gaussian, with
mean Q_c(s, a) and variance W(s, a), whose upper tail is held under a limit d. With c = 1 at
a violation, m = 1 - terminal, and a' ~ pi(s'):

    mean      E (c + gamma_c m Q_c'(s', a') - Q_c)^2
    variance  E W + W* - 2 sqrt(W W*),      the squared 2-Wasserstein distance's part,
              W* = c^2 + 2 gamma_c c m Q_c' + gamma_c^2 m (W' + Q_c'^2) - Q_c^2, at least 1e-8
    CVaR      Q_c + phi(Phi^-1(alpha)) / alpha sqrt(W): the mean of the worst share alpha
    policy    E temperature log pi - min(Q1, Q2) + lambda CVaR,      a ~ pi(s)
    lambda    <- max(0, lambda + a step along E CVaR - d)

The published variance target lacks m: it bootstraps through the violation, although the
episode ends there, so that even a certain violation would have a positive variance. Three more
things differ from the published code: the multiplier is projected instead of a softplus; it
looks at the policy's actions of the moment, not at the recorded ones; and Q_c' in the targets is
clipped to [0, 1]. A policy that seeks small Q_c finds where the network errs downwards, and
unclipped the error feeds itself: on PointGoal1 Q_c fell below 0, the multiplier with it to 0,
and 71% to 92% of the episodes of the final policies ended in a violation.

Kept as published is that W* is a single sample, at least 1e-8: where the next state is random,
sqrt(W) tends to E sqrt(W*) instead of the standard deviation. A violation now with probability
p, and none otherwise, has p sqrt(1 - p^2) instead of sqrt(p (1 - p)): less if p < 0.618.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from statistics import NormalDist
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from deep.data.normalisation import Normalisation, columns
from deep.nn.losses import q_loss, q_target
from deep.nn.networks import ActionValue, GaussianPolicy, adam, copy_slowly, minimise
from deep.tasks.task import Sizes
from deep.train.learner import NormalisationOf, TaskBatch, TaskLearner, TaskLosses
from deep.train.sac import SacSettings, soft_target

__all__ = [
    "CostEstimate",
    "DistributionalCritic",
    "Sharpened",
    "Wcsac",
    "WcsacSettings",
    "tail_weight",
    "variance_loss",
    "variance_target",
]

LEAST_VARIANCE = 1e-8


@dataclass(frozen=True)
class WcsacSettings(SacSettings):
    """SAC's settings and the constraint's; risk level and rate are the published code's.

    The cost of an episode is gamma_safe^T with a violation after T steps, else 0, so CVaR
    and ``cost_limit`` are discounted probabilities of a violation, averaged over states
    from the replay buffer. A policy that violates in a share v of episodes of L steps has
    a mean Q_c of about v / (L (1 - gamma_safe)): 0.005 at v = 5% and L = 1000. The tail at
    risk level 0.5 adds 0.8 standard deviations, which comes to about 0.045: the default.
    States from which a violation cannot be avoided count as well, with CVaR near 1; where
    they are a greater share of the buffer than the limit, no policy meets it.

    Attributes:
        gamma_safe: gamma_c, discount of the cost.
        risk_level: alpha in (0, 1], the worst share of episodes that counts; 1: all.
        cost_limit: d, one for all seeds or one each.
        sharpness: the cost critic sees coordinates in [0, 1], such as lidars' closenesses,
            to this power, as the safety critics of Algorithm 1 can
            (:class:`deep.pretraining.config.PretrainConfig`).
        multiplier_rate: Adam's learning rate of lambda, which weighs CVaR against scaled
            rewards and begins at 0; it slides like the others.
    """

    gamma_safe: float = 0.99
    risk_level: float = 0.5
    cost_limit: tuple[float, ...] = (0.045,)
    sharpness: float = 1.0
    multiplier_rate: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("gamma_safe", "risk_level"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in (0, 1], not {getattr(self, name)}")
        if not self.cost_limit or min(self.cost_limit) < 0:
            raise ValueError(f"cost_limit must not be negative, not {self.cost_limit}")
        if not 1 <= self.sharpness < math.inf:
            raise ValueError(f"sharpness must be at least 1 and finite, not {self.sharpness}")
        if self.multiplier_rate <= 0:
            raise ValueError(f"multiplier_rate must be positive, not {self.multiplier_rate}")


class CostEstimate(NamedTuple):
    """The discounted cost as a Gaussian: mean Q_c and variance W, each (K, B)."""

    mean: Tensor
    variance: Tensor

    def in_range(self) -> CostEstimate:
        """With the mean clipped to [0, 1], where a discounted probability lies."""
        return self._replace(mean=self.mean.clamp(0, 1))

    def tail_mean(self, weight: float) -> Tensor:
        """CVaR (K, B), with ``weight`` from :func:`tail_weight`."""
        return self.mean + weight * self.variance.sqrt()


def tail_weight(risk_level: float) -> float:
    """phi(Phi^-1(alpha)) / alpha: how many deviations the worst share's mean lies above."""
    if risk_level == 1:
        return 0.0
    normal = NormalDist()
    return normal.pdf(normal.inv_cdf(risk_level)) / risk_level


class Sharpened(nn.Module):
    """Standardised observations (K, B, o) -> the same with closenesses raised to a power.

    What standardised them is undone, and the powers are standardised. Nothing is changed until
    both are known; they belong to a checkpoint.
    """

    scale: Tensor
    centre: Tensor
    power: Tensor
    sharp_scale: Tensor
    sharp_centre: Tensor

    def __init__(self, seeds: int, dim: int) -> None:
        super().__init__()
        for name in ("scale", "power", "sharp_scale"):
            self.register_buffer(name, torch.ones(seeds, 1, dim))
        for name in ("centre", "sharp_centre"):
            self.register_buffer(name, torch.zeros(seeds, 1, dim))

    def set(self, plain: Sequence[Normalisation], sharp: Sequence[Normalisation]) -> None:
        """Each seed's normalisation of what comes, and of what is wanted."""
        self.scale.copy_(columns(n.observation_scale for n in plain))
        self.centre.copy_(columns(n.observation_centre for n in plain))
        self.power.copy_(columns(n.observation_power for n in sharp))
        self.sharp_scale.copy_(columns(n.observation_scale for n in sharp))
        self.sharp_centre.copy_(columns(n.observation_centre for n in sharp))

    def forward(self, observation: Tensor) -> Tensor:
        """(K, B, o) -> (K, B, o)."""
        raw = observation * self.scale + self.centre
        powered = torch.where(self.power != 1, raw.clamp(min=0) ** self.power, raw)
        return (powered - self.sharp_centre) / self.sharp_scale


class DistributionalCritic(nn.Module):
    """Q_c(s, a) and W(s, a) of K seeds: two networks of the same shape, side by side."""

    def __init__(self, seeds: Sequence[int], sizes: Sizes, hidden: Sequence[int]) -> None:
        super().__init__()
        self.both = ActionValue(seeds, *sizes, hidden, members=2, name="cost critic")

    def forward(self, observation: Tensor, action: Tensor) -> CostEstimate:
        """(K, B, o) and (K, B, a) -> mean and variance."""
        mean, raw = self.both(observation, action).unbind(dim=1)
        # A sum: clipping from below would stop the gradient where the variance is too small.
        return CostEstimate(mean, nn.functional.softplus(raw) + LEAST_VARIANCE)


def variance_target(
    cost: Tensor, terminal: Tensor, gamma_safe: float, following: CostEstimate, mean: Tensor
) -> Tensor:
    """W*: E (c + gamma_c m C')^2 - Q_c^2 for C' ~ N(Q_c', W'), at least 1e-8. All (K, B)."""
    goes_on = 1 - terminal
    second_moment = following.variance + following.mean**2
    square = (
        cost**2
        + 2 * gamma_safe * cost * goes_on * following.mean
        + gamma_safe**2 * goes_on * second_moment
    )
    return (square - mean**2).clamp(min=LEAST_VARIANCE)


def variance_loss(variance: Tensor, target: Tensor) -> Tensor:
    """E W + W* - 2 sqrt(W W*) = E (sqrt(W) - sqrt(W*))^2. (K, B) -> (K,)."""
    return (variance + target - 2 * (variance * target).sqrt()).mean(dim=-1)


class Wcsac(TaskLearner):
    """K seeds of WCSAC, each with its own multiplier.

    Attributes:
        cost_critic: mean and variance of the discounted cost.
        view: of observations, the cost critic's.
        multiplier: lambda, (K,).
    """

    name: ClassVar[str] = "wcsac"

    def __init__(self, settings: WcsacSettings, sizes: Sizes, seeds: Sequence[int]) -> None:
        super().__init__(seeds)
        if len(settings.cost_limit) not in (1, len(seeds)):
            raise ValueError(
                f"{len(settings.cost_limit)} cost limits for {len(seeds)} seeds: give one, "
                "or one each"
            )
        self.settings: WcsacSettings = settings
        self.view = Sharpened(len(seeds), sizes.observation)
        self.critic = ActionValue(seeds, *sizes, settings.hidden)
        self.critic_target = deepcopy(self.critic).requires_grad_(False)
        self.cost_critic = DistributionalCritic(seeds, sizes, settings.hidden)
        self.cost_critic_target = deepcopy(self.cost_critic).requires_grad_(False)
        self.policy = GaussianPolicy(seeds, *sizes, settings.hidden, name="task policy")
        self.multiplier = nn.Parameter(torch.zeros(len(seeds)))
        self._tail_weight = tail_weight(settings.risk_level)
        self._limit = torch.tensor(self.limits)
        trained = (self.critic, self.cost_critic, self.policy)
        self._optimizers = (
            *(adam(module, settings.learning_rate) for module in trained),
            torch.optim.Adam([self.multiplier], lr=settings.multiplier_rate),
        )

    def look(self, normalisation: NormalisationOf) -> None:
        """Sharpen what the cost critic sees."""
        if self.settings.sharpness != 1:
            self.view.set(normalisation(1.0), normalisation(self.settings.sharpness))

    def update(self, batch: TaskBatch) -> TaskLosses:
        """One step of both critics, of the policy, of lambda, and of the targets."""
        settings = self.settings
        s, a, following = batch.observation, batch.action, batch.next_observation
        critic_optimizer, cost_optimizer, policy_optimizer, multiplier_optimizer = self._optimizers

        with torch.no_grad():
            next_action, next_log_prob = self.policy.sample(following, batch.next_noise)
            next_value = self.critic_target.least(following, next_action)
            target = soft_target(batch, settings, next_value, next_log_prob)
        critic_loss = minimise(critic_optimizer, q_loss(self.critic(s, a), target))

        seen = self.view(s)
        cost = self.cost_critic(seen, a)
        with torch.no_grad():
            after = self.cost_critic_target(self.view(following), next_action).in_range()
            mean_target = q_target(batch.cost, batch.terminal, settings.gamma_safe, after.mean)
            spread_target = variance_target(
                batch.cost, batch.terminal, settings.gamma_safe, after, cost.mean
            )
        minimise(
            cost_optimizer,
            q_loss(cost.mean.unsqueeze(1), mean_target)
            + variance_loss(cost.variance, spread_target),
        )

        action, log_prob = self.policy.sample(s, batch.noise)
        value = self.critic.least(s, action)
        tail = self.cost_critic(seen, action).tail_mean(self._tail_weight)
        penalty = self.multiplier.detach()[:, None] * tail
        policy_loss = minimise(
            policy_optimizer, (settings.temperature * log_prob - value + penalty).mean(dim=-1)
        )

        excess = tail.detach().mean(dim=-1) - self._limit
        minimise(multiplier_optimizer, -self.multiplier * excess)
        with torch.no_grad():
            self.multiplier.clamp_(min=0)
        copy_slowly(self.critic, self.critic_target, settings.polyak)
        copy_slowly(self.cost_critic, self.cost_critic_target, settings.polyak)
        return TaskLosses(critic_loss, policy_loss)

    @property
    def limits(self) -> tuple[float, ...]:
        """d of each seed."""
        given = self.settings.cost_limit
        return given * (len(self.seeds) // len(given))

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """Critics, cost critic, policy, multiplier."""
        return self._optimizers
