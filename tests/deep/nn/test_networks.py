"""Batched networks: the seeds are independent, the policy's density is a density."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from deep.data.collect import collect, random_policy
from deep.data.minibatches import BLOCK, Batches
from deep.nn.networks import Critic, GaussianPolicy, StateValue, copy_slowly
from deep.pretraining import FORMS, Sizes, build_learner
from deep.tasks import Brake

CPU = torch.device("cpu")


@pytest.mark.parametrize("method", FORMS)
def test_a_seed_in_a_batch_learns_what_it_learns_alone(method: str) -> None:
    data = [
        collect(Brake(), random_policy(Brake()), np.random.default_rng(seed), 2000)
        for seed in (3, 5, 8)
    ]
    settings = FORMS[method].settings(hidden=(16, 16), batch_size=32)
    together = build_learner(settings, Sizes(2, 1), (3, 5, 8))
    alone = build_learner(settings, Sizes(2, 1), (5,))
    many = Batches(data, (3, 5, 8), 32, settings.violation_share, CPU)
    one = Batches(data[1:2], (5,), 32, settings.violation_share, CPU)
    for update in range(BLOCK + 10):
        together.update(many.get(update), update / 100)
        alone.update(one.get(update), update / 100)
    observation = torch.rand(1, 50, 2) * 2 - 1
    action = torch.rand(1, 50, 1) * 2 - 1
    with torch.no_grad():
        q = together.critic(observation.expand(3, -1, -1), action.expand(3, -1, -1))
        a = together.recovery.mean_action(observation.expand(3, -1, -1))
        assert torch.allclose(q[1], alone.critic(observation, action)[0], atol=1e-4)
        assert torch.allclose(a[1], alone.recovery.mean_action(observation)[0], atol=1e-4)
        assert not torch.allclose(q[0], q[1], atol=1e-2)


def test_initial_weights_depend_on_the_seed_alone() -> None:
    first, second = Critic((4, 7), 3, 1, (8,)), Critic((7,), 3, 1, (8,))
    assert torch.equal(first.mlp.weights[0][2:], second.mlp.weights[0])
    assert not torch.equal(second.mlp.weights[0][0], second.mlp.weights[0][1])  # twins differ
    bound = math.sqrt(6 / (4 + 8))
    assert float(first.mlp.weights[0].detach().abs().max()) <= bound


def test_the_worst_member_counts() -> None:
    critic = Critic((0, 1), 2, 1, (8,), members=3)
    observation, action = torch.rand(2, 5, 2), torch.rand(2, 5, 1)
    values = critic(observation, action)
    assert values.shape == (2, 3, 5)
    assert ((values > 0) & (values < 1)).all()
    assert torch.equal(critic.worst(observation, action), values.amax(dim=1))


def test_state_values_are_shares() -> None:
    value = StateValue((0,), 2, (8,))(torch.rand(1, 5, 2))
    assert value.shape == (1, 5)
    assert ((value > 0) & (value < 1)).all()


def test_the_policy_density_integrates_to_one() -> None:
    policy = GaussianPolicy((0,), 2, 1, (8,))
    edges = torch.tanh(torch.linspace(-6, 6, 20_001, dtype=torch.float64))
    middles, widths = (edges[1:] + edges[:-1]) / 2, edges.diff()
    inside = middles.abs() < 1 - 1e-4
    action = middles[inside].float().view(1, -1, 1)
    observation = torch.full((1, action.shape[1], 2), 0.3)
    with torch.no_grad():
        density = policy.log_prob(observation, action).exp()[0].double()
    assert float((density * widths[inside]).sum()) == pytest.approx(1, abs=2e-2)


def test_sampled_actions_have_the_density_that_is_reported() -> None:
    policy = GaussianPolicy((0,), 2, 2, (8,))
    observation = torch.rand(1, 20, 2)
    with torch.no_grad():
        action, log_prob = policy.sample(observation, torch.randn(1, 20, 2))
        assert torch.allclose(policy.log_prob(observation, action), log_prob, atol=1e-3)
        noiseless, _ = policy.sample(observation, torch.zeros(1, 20, 2))
        assert torch.equal(policy.mean_action(observation), noiseless)


def test_reach_makes_the_ends_of_the_range_attainable() -> None:
    plain, reaching = GaussianPolicy((0,), 1, 1, ()), GaussianPolicy((0,), 1, 1, (), reach=1.1)
    observation = torch.full((1, 1, 1), 1.0)
    for policy in (plain, reaching):
        with torch.no_grad():
            policy.mlp.weights[0][0, 0, 0] = 2.0
    with torch.no_grad():
        assert 0.9 < float(plain.mean_action(observation)) < 1
        assert float(reaching.mean_action(observation)) == 1
    with pytest.raises(ValueError, match="reach must be at least 1, not 0.5"):
        GaussianPolicy((0,), 1, 1, (), reach=0.5)


def test_polyak_averaging() -> None:
    source, target = StateValue((0,), 1, ()), StateValue((1,), 1, ())
    before = target.mlp.weights[0].clone()
    copy_slowly(source, target, 0.25)
    expected = 0.75 * before + 0.25 * source.mlp.weights[0]
    assert torch.allclose(target.mlp.weights[0], expected)
    copy_slowly(source, target, 1.0)
    assert torch.equal(target.mlp.weights[0], source.mlp.weights[0])


def test_batches_are_a_function_of_seed_and_update() -> None:
    data = collect(Brake(), random_policy(Brake()), np.random.default_rng(0), 3000)
    first = Batches([data], (1, 2), 16, None, CPU)
    second = Batches([data], (1, 2), 16, None, CPU)
    first.get(0)
    for update in (BLOCK + 3, 5, 3 * BLOCK):
        for a, b in zip(first.get(update), second.get(update), strict=True):
            assert torch.equal(a, b)
    batch = first.get(7)
    assert not torch.equal(batch.observation[0], batch.observation[1])
    assert not torch.equal(batch.noise, batch.next_noise)


def test_violations_fill_their_share_of_a_batch() -> None:
    data = collect(Brake(), random_policy(Brake()), np.random.default_rng(0), 3000)
    batch = Batches([data], (0,), 64, 0.5, CPU).get(0)
    assert (batch.cost[0, :32] == 1).all()
    assert batch.cost[0, 32:].mean() < 0.6
    with pytest.raises(ValueError, match="2 data sets for 3 seeds"):
        Batches([data, data], (0, 1, 2), 8, None, CPU)
