"""The paper's losses as pure functions of tensors; each names its equation.

Shapes: K seeds, M members of an ensemble, B transitions. A loss keeps the seed axis, (K,):
the sum over K is what is minimised, so no seed's gradient touches another's weights.
"""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = [
    "advantage_policy_gradient",
    "advantage_weighted_regression",
    "cross_entropy_q_loss",
    "q_loss",
    "q_target",
    "recovery_objective",
    "safety_critic_loss",
    "v_loss",
]

MAX_ADVANTAGE_WEIGHT = 100.0


def q_target(cost: Tensor, terminal: Tensor, gamma_safe: float, next_value: Tensor) -> Tensor:
    """c + (1 - c) gamma_safe V(s'), the target in Equations (obj_safe_critic) and (q_loss).

    ``terminal`` marks every end of an episode that is none by the clock: violations, and
    goals, after which nothing costs any more. A truncated episode goes on: bootstrap.
    All (K, B).
    """
    return cost + (1 - terminal) * gamma_safe * next_value


def v_loss(q: Tensor, value: Tensor, expectile: float) -> Tensor:
    """Equation (v_loss): E L_2^tau(Q(s,a) - V(s)), with L_2^tau(u) = |tau - 1(u < 0)| u^2.

    ``expectile`` is the weight where Q > V; towards 0 the minimiser tends to the least Q
    in the data. q, value: (K, B) -> (K,).
    """
    difference = q - value
    weight = torch.where(difference > 0, expectile, 1 - expectile)
    return (weight * difference**2).mean(dim=-1)


def q_loss(q: Tensor, target: Tensor) -> Tensor:
    """Equation (q_loss): E (target - Q)^2, summed over the members.

    q: (K, M, B); target: (K, B) -> (K,).
    """
    return ((target.unsqueeze(1) - q) ** 2).mean(dim=-1).sum(dim=-1)


def safety_critic_loss(q: Tensor, target: Tensor) -> Tensor:
    """Equation (obj_safe_critic): E 1/2 (Q - target)^2, summed over the members.

    q: (K, M, B); target: (K, B) -> (K,).
    """
    return q_loss(q, target) / 2


def cross_entropy_q_loss(logits: Tensor, target: Tensor) -> Tensor:
    """E of the cross-entropy between target and sigmoid(logits), summed over the members.

    Not in the paper. Its minimiser is Equation (q_loss)'s, the mean target; its gradient
    does not vanish where the sigmoid is saturated. logits: (K, M, B) -> (K,).
    """
    repeated = target.unsqueeze(1).expand_as(logits)
    loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, repeated, reduction="none")
    return loss.mean(dim=-1).sum(dim=-1)


def recovery_objective(
    q: Tensor, log_prob: Tensor, entropy_weight: float, weight: Tensor
) -> Tensor:
    """Minus Equation (obj_rec_p), E Q(s, pi_rec(s)), plus ``entropy_weight`` E log pi.

    The entropy is the authors' code's, not the paper's (0 leaves it out). ``weight`` is
    the share of each transition in the mean, 0 for those left out. All (K, B) -> (K,).
    """
    return _weighted_mean(q + entropy_weight * log_prob, weight)


def advantage_policy_gradient(
    q: Tensor, value: Tensor, log_prob: Tensor, scale: float, entropy_weight: float, weight: Tensor
) -> Tensor:
    """DEA-RRL's recovery loss: E [entropy_weight log pi + scale (Q(s, a_pi) - V(s))].

    The paper calls it advantage policy gradient; V(s) does not depend on the policy.
    All (K, B) -> (K,).
    """
    return _weighted_mean(scale * (q - value) + entropy_weight * log_prob, weight)


def advantage_weighted_regression(
    q: Tensor, value: Tensor, log_prob: Tensor, beta: float, weight: Tensor
) -> Tensor:
    """IQL's extraction: -E [min(exp(beta (V(s) - Q(s,a))), 100) log pi(a|s)], a from data.

    Costs are bad, so the advantage is V - Q. All (K, B) -> (K,).
    """
    advantage = torch.exp(beta * (value - q)).clamp(max=MAX_ADVANTAGE_WEIGHT)
    return -_weighted_mean(advantage * log_prob, weight)


def _weighted_mean(x: Tensor, weight: Tensor) -> Tensor:
    return (weight * x).sum(dim=-1) / weight.sum(dim=-1).clamp(min=1)
