"""SAC: losses against numpy, fixed points in closed form, and who sees which action."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from deep.nn.networks import BatchedMLP
from deep.tasks.task import Sizes
from deep.train.learner import TaskBatch, TaskSettings
from deep.train.sac import Sac, SacSettings

SIZES = Sizes(3, 2)
SMALL = SacSettings(hidden=(7, 5), batch_size=9, gamma=0.8, polyak=0.3, reward_scale=10.0)
FAST = SacSettings(
    gamma=0.5, hidden=(32,), learning_rate=3e-3, batch_size=64, polyak=0.05,
    reward_scale=1.0, temperature=0.0,
)  # fmt: skip
Array = NDArray[np.float64]


def random_batch(seeds: int, size: int, seed: int = 0) -> TaskBatch:
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> Tensor:
        return torch.from_numpy(rng.standard_normal((seeds, size, *shape), dtype=np.float32))

    return TaskBatch(
        observation=normal(3),
        action=normal(2).tanh(),
        executed=normal(2).tanh(),
        next_observation=normal(3),
        reward=normal(),
        cost=(normal() > 1).float(),
        terminal=(normal() > 0.5).float(),
        noise=normal(2),
        next_noise=normal(2),
    )


def one_step(update: int, terminal: float, seeds: int = 1) -> TaskBatch:
    """Always the same state, uniform actions, no reward yet."""
    rng = np.random.default_rng(update)
    size = FAST.batch_size
    action = torch.from_numpy(rng.uniform(-1, 1, (seeds, size, 1)).astype(np.float32))
    noise = torch.from_numpy(rng.standard_normal((2, seeds, size, 1), dtype=np.float32))
    state, zero = torch.zeros(seeds, size, 1), torch.zeros(seeds, size)
    end = torch.full((seeds, size), terminal)
    return TaskBatch(state, action, action, state, zero, zero, end, noise[0], noise[1])


def copied(mlp: BatchedMLP) -> list[tuple[Array, Array]]:
    """Weights (K, in, out) and biases (K, 1, out) as they are now."""
    return [
        (w.detach().numpy().astype(float), b.detach().numpy().astype(float))
        for w, b in zip(mlp.weights, mlp.biases, strict=True)
    ]


def perceptron(layers: list[tuple[Array, Array]], k: int, x: Array) -> Array:
    for i, (weights, biases) in enumerate(layers):
        x = x @ weights[k] + biases[k]
        if i < len(layers) - 1:
            x = np.maximum(x, 0)
    return x


def least(layers: list[tuple[Array, Array]], k: int, s: Array, a: Array) -> Array:
    x = np.concatenate([s, a], axis=-1)
    return np.minimum(perceptron(layers, 2 * k, x), perceptron(layers, 2 * k + 1, x))[:, 0]


def sampled(layers: list[tuple[Array, Array]], k: int, s: Array, noise: Array) -> tuple[Array, ...]:
    """tanh of a Gaussian, and its density by the change of variables."""
    mean, log_std = np.split(perceptron(layers, k, s), 2, axis=-1)
    raw = mean + np.exp(log_std) * noise
    gaussian = np.exp(-(noise**2) / 2) / np.sqrt(2 * np.pi) / np.exp(log_std)
    density = (gaussian / (1 - np.tanh(raw) ** 2)).prod(axis=-1)
    return np.tanh(raw), np.log(density)


def policy_loss(
    policy: list[tuple[Array, Array]], critic: list[tuple[Array, Array]], k: int, batch: TaskBatch
) -> float:
    s, noise = batch.observation[k].double().numpy(), batch.noise[k].double().numpy()
    action, log_prob = sampled(policy, k, s, noise)
    return float(np.mean(SMALL.temperature * log_prob - least(critic, k, s, action)))


def test_losses_targets_and_the_first_step_against_numpy() -> None:
    learner = Sac(SMALL, SIZES, (0, 4))
    with torch.no_grad():  # a target that is not the critic
        for parameter in learner.critic_target.parameters():
            parameter += 0.1
    critic, target, policy = (
        copied(module.mlp) for module in (learner.critic, learner.critic_target, learner.policy)
    )
    batch = random_batch(2, 9)
    losses = learner.update(batch)
    updated = copied(learner.critic.mlp)
    for k in range(2):
        s, a, following, reward, terminal, next_noise = (
            getattr(batch, name)[k].double().numpy()
            for name in (
                "observation", "action", "next_observation", "reward", "terminal", "next_noise"
            )
        )  # fmt: skip
        next_action, next_log_prob = sampled(policy, k, following, next_noise)
        soft = least(target, k, following, next_action) - 0.2 * next_log_prob
        y = 10 * reward + 0.8 * np.where(terminal == 1, 0, soft)
        x = np.concatenate([s, a], axis=-1)
        squares = [np.mean((perceptron(critic, 2 * k + i, x)[:, 0] - y) ** 2) for i in range(2)]
        assert float(losses.critic[k]) == pytest.approx(sum(squares), rel=1e-5)
        # The policy is improved on the critic that has just learned.
        assert float(losses.policy[k]) == pytest.approx(
            policy_loss(policy, updated, k, batch), rel=1e-5
        )
        # Adam's first step is the learning rate against the sign of the gradient.
        bias = policy[-1][1]
        for j in range(4):
            around = []
            for shift in (1e-6, -1e-6):
                moved = bias.copy()
                moved[k, 0, j] += shift
                around.append(
                    policy_loss([*policy[:-1], (policy[-1][0], moved)], updated, k, batch)
                )
            slope = (around[0] - around[1]) / 2e-6
            step = float(learner.policy.mlp.biases[-1][k, 0, j].detach()) - bias[k, 0, j]
            assert abs(slope) > 1e-4
            assert step == pytest.approx(-SMALL.learning_rate * np.sign(slope), rel=1e-3)
    for (w, b), (w0, b0), (w1, b1) in zip(
        copied(learner.critic_target.mlp), target, updated, strict=True
    ):
        assert w == pytest.approx(0.7 * w0 + 0.3 * w1, abs=1e-6)
        assert b == pytest.approx(0.7 * b0 + 0.3 * b1, abs=1e-6)


def test_the_learner_sees_what_it_proposed_not_what_was_executed() -> None:
    batch = random_batch(1, 9)
    other = torch.zeros_like(batch.action)
    results = []
    for seen in (batch, batch._replace(executed=other), batch._replace(action=other)):
        learner = Sac(SMALL, SIZES, (0,))
        results.append((learner.update(seen).critic, learner.critic.mlp.weights[0].detach()))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])
    assert not torch.equal(results[0][0], results[2][0])


def test_without_a_temperature_the_mean_policy_finds_the_best_action() -> None:
    learner = Sac(FAST, Sizes(1, 1), (0,))
    for update in range(1000):  # the policy overshoots at first
        batch = one_step(update, terminal=1.0)
        learner.update(batch._replace(reward=-((batch.action[..., 0] - 0.5) ** 2)))
    mean = float(learner.policy.mean_action(torch.zeros(1, 1, 1)).detach())
    assert mean == pytest.approx(0.5, abs=0.05)


def test_a_constant_reward_has_its_geometric_sum() -> None:
    learner = Sac(FAST, Sizes(1, 1), (0, 1))
    for update in range(400):
        batch = one_step(update, terminal=0.0, seeds=2)
        end = torch.stack([torch.zeros(FAST.batch_size), torch.ones(FAST.batch_size)])
        learner.update(batch._replace(reward=torch.ones_like(end), terminal=end))
    q = learner.critic.least(torch.zeros(2, 1, 1), torch.zeros(2, 1, 1))[:, 0].tolist()
    assert q == pytest.approx([2.0, 1.0], abs=0.05)


def objective(mean: Array, std: Array, slope: float, temperature: float) -> Array:
    """E [slope a - temperature log pi(a)] of tanh-Gaussians, by a sum over quantiles."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    raw = mean[..., None] + std[..., None] * nodes
    log_slope = 2 * (np.log(2) - raw - np.logaddexp(0, -2 * raw))
    gaussian = -(nodes**2) / 2 - np.log(std[..., None]) - 0.5 * np.log(2 * np.pi)
    values = slope * np.tanh(raw) - temperature * (gaussian - log_slope)
    return np.asarray(values @ weights / np.sqrt(2 * np.pi))


def test_the_soft_value_of_a_linear_reward() -> None:
    slope, temperature = 1.0, 0.5
    learner = Sac(replace(FAST, temperature=temperature), Sizes(1, 1), (2,))
    for update in range(900):
        batch = one_step(update, terminal=0.0)
        learner.update(batch._replace(reward=slope * batch.action[..., 0]))
    means, stds = np.meshgrid(np.linspace(-1, 3, 161), np.linspace(0.2, 3, 141))
    best = float(objective(means, stds, slope, temperature).max())
    # No density on [-1, 1] does better than the one proportional to exp(slope a / temperature).
    bound = temperature * math.log(2 * temperature / slope * math.sinh(slope / temperature))
    assert bound - 0.02 < best < bound
    state = torch.zeros(1, 1, 1)
    mean, log_std = (float(x.detach()) for x in learner.policy.distribution(state))
    found = float(objective(np.array(mean), np.exp(np.array(log_std)), slope, temperature))
    assert found == pytest.approx(best, abs=0.02)
    assert objective(np.array(mean), np.array(0.1), slope, temperature) < best - 0.1
    # V = J + gamma V, and Q(a) = slope a + gamma V.
    value = best / (1 - 0.5)
    actions = torch.tensor([[[-0.5], [0.5]]])
    q = learner.critic.least(torch.zeros(1, 2, 1), actions)[0].tolist()
    assert q == pytest.approx([-0.5 + 0.5 * value, 0.5 + 0.5 * value], abs=0.08)


def test_the_rates_slide_down_in_the_second_half() -> None:
    learner = Sac(replace(SMALL, learning_rate=0.1, final_rate=0.2), SIZES, (0,))
    for progress, rate in ((0.0, 0.1), (0.5, 0.1), (0.75, 0.06), (1.0, 0.02), (0.2, 0.1)):
        learner.slow_down(progress)
        for optimizer in learner.optimizers:
            assert [group["lr"] for group in optimizer.param_groups] == pytest.approx([rate])


def test_a_seed_in_a_batch_learns_what_it_learns_alone() -> None:
    together, alone = Sac(SMALL, SIZES, (2, 5)), Sac(SMALL, SIZES, (5,))
    for update in range(10):
        batch = random_batch(2, 9, update)
        both = together.update(batch)
        one = alone.update(TaskBatch(*(part[1:] for part in batch)))
        assert both.critic[1].item() == pytest.approx(one.critic.item(), rel=1e-4)
        assert both.policy[1].item() == pytest.approx(one.policy.item(), rel=1e-3, abs=1e-4)
    for name, tensor in alone.state_dict().items():
        half = len(together.state_dict()[name]) // 2
        assert torch.allclose(together.state_dict()[name][half:], tensor, atol=1e-5), name


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"gamma": 0.0}, r"gamma must lie in \(0, 1\], not 0.0"),
        ({"gamma": 1.1}, r"gamma must lie in \(0, 1\], not 1.1"),
        ({"polyak": 0.0}, r"polyak must lie in \(0, 1\], not 0.0"),
        ({"final_rate": 0.0}, r"final_rate must lie in \(0, 1\], not 0.0"),
        ({"learning_rate": 0.0}, "learning_rate must be positive, not 0.0"),
        ({"batch_size": 0}, "batch_size must be positive, not 0"),
        ({"reward_scale": -1.0}, "reward_scale must be positive, not -1.0"),
        ({"temperature": -0.1}, "temperature must not be negative, not -0.1"),
    ],
)
def test_settings_that_make_no_sense(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        SacSettings(**wrong)  # type: ignore[arg-type]  # one of several types
    assert TaskSettings(gamma=1.0, polyak=1.0).gamma == 1.0


@pytest.mark.parametrize("seeds", [(), (1, 1), (-1, 2)])
def test_seeds_that_cannot_be(seeds: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="^seeds must be distinct non-negative integers, not "):
        Sac(SMALL, SIZES, seeds)
