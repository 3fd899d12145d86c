"""The losses, by hand and by their minimisers."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from deep.nn.losses import (
    advantage_policy_gradient,
    advantage_weighted_regression,
    cross_entropy_q_loss,
    q_loss,
    q_target,
    recovery_objective,
    safety_critic_loss,
    v_loss,
)


def row(*values: float) -> Tensor:
    return torch.tensor([values])


def test_the_target_stops_at_violations_and_goals_and_goes_on_through_timeouts() -> None:
    # violation, goal, ordinary step (a truncated one looks the same: it is not terminal)
    target = q_target(row(1, 0, 0), row(1, 1, 0), 0.9, row(0.5, 0.5, 0.5))
    assert target.tolist()[0] == pytest.approx([1.0, 0.0, 0.45])


@pytest.mark.parametrize("expectile", [0.1, 0.3, 0.5, 0.8])
def test_v_loss_is_least_at_the_expectile(expectile: float) -> None:
    q = torch.tensor([[0.1, 0.1, 0.7, 1.0]])
    values = torch.linspace(0, 1, 10_001)
    losses = torch.stack([v_loss(q, torch.full((1, 1), float(v)), expectile)[0] for v in values])
    best = float(values[losses.argmin()])
    # First-order condition of the expectile: tau E(Q - V)+ = (1 - tau) E(V - Q)+.
    above = (q - best).clamp(min=0).mean()
    below = (best - q).clamp(min=0).mean()
    assert float(expectile * above) == pytest.approx(float((1 - expectile) * below), abs=1e-4)


def test_v_loss_by_hand() -> None:
    assert v_loss(row(1.0, 0.0), row(0.5, 0.5), 0.3).tolist() == pytest.approx([0.125])
    assert v_loss(row(1.0), row(0.0), 0.3).tolist() == pytest.approx([0.3])
    assert v_loss(row(0.0), row(1.0), 0.3).tolist() == pytest.approx([0.7])


def test_q_losses_by_hand() -> None:
    q = torch.tensor([[[0.5, 0.0], [1.0, 0.0]]])  # one seed, two members, two transitions
    target = row(1.0, 1.0)
    assert q_loss(q, target).tolist() == pytest.approx([0.625 + 0.5])
    assert safety_critic_loss(q, target).tolist() == pytest.approx([0.5625])


def test_cross_entropy_has_the_same_minimiser_and_no_vanishing_gradient() -> None:
    targets = row(0.2, 0.4, 0.9)  # their mean is 0.5, logit 0
    logits = torch.zeros(1, 1, 1, requires_grad=True)
    cross_entropy_q_loss(logits.expand(1, 1, 3), targets).sum().backward()
    assert float(logits.grad) == pytest.approx(0, abs=1e-7)  # type: ignore[arg-type]  # it was just computed
    saturated = torch.full((1, 1, 1), -20.0, requires_grad=True)
    (by_entropy,) = torch.autograd.grad(cross_entropy_q_loss(saturated, row(1.0)).sum(), saturated)
    (by_square,) = torch.autograd.grad(q_loss(torch.sigmoid(saturated), row(1.0)).sum(), saturated)
    assert float(by_entropy) == pytest.approx(-1)
    assert abs(float(by_square)) < 1e-7


def test_recovery_losses_by_hand() -> None:
    q, value, log_prob = row(0.2, 0.6), row(0.1, 0.1), row(-1.0, -3.0)
    everything, first = row(1.0, 1.0), row(1.0, 0.0)
    assert recovery_objective(q, log_prob, 0.0, everything).tolist() == pytest.approx([0.4])
    assert recovery_objective(q, log_prob, 0.2, first).tolist() == pytest.approx([0.0])
    assert advantage_policy_gradient(q, value, log_prob, 10.0, 0.2, everything).tolist() == (
        pytest.approx([10 * 0.3 - 0.4])
    )


def test_advantage_weights_prefer_low_cost_and_are_capped() -> None:
    q, value, log_prob = row(0.0, 1.0), row(0.5, 0.5), row(-1.0, -1.0)
    expected = (math.exp(5) + math.exp(-5)) / 2
    loss = advantage_weighted_regression(q, value, log_prob, 10.0, row(1.0, 1.0))
    assert min(expected, 1e9) > 50  # the first weight is e^5 = 148, cut to 100
    assert loss.tolist() == pytest.approx([(100 + math.exp(-5)) / 2])


def test_no_transition_to_learn_from_gives_no_loss() -> None:
    assert recovery_objective(row(0.2), row(0.0), 0.2, row(0.0)).tolist() == [0.0]


def test_seeds_do_not_mix() -> None:
    q = torch.tensor([[0.1, 0.2], [0.8, 0.9]])
    value = torch.zeros(2, 2)
    together = v_loss(q, value, 0.3)
    alone = torch.cat([v_loss(q[k : k + 1], value[k : k + 1], 0.3) for k in range(2)])
    assert torch.equal(together, alone)
