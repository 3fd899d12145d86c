"""WCSAC: its losses by hand, its fixed points on small chains, its multiplier."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import deep.train.wcsac
from deep.data.normalisation import (
    Normalisation,
    TensorNormalisation,
    normalisation_of_observations,
)
from deep.runs.checkpoint import load_checkpoint, save_checkpoint
from deep.tasks.task import Sizes
from deep.train.config import (
    TrainConfig,
    build_task_learner,
    train_config_from_json,
    train_config_to_json,
)
from deep.train.learner import TaskBatch
from deep.train.sac import Sac, SacSettings
from deep.train.wcsac import (
    CostEstimate,
    Wcsac,
    WcsacSettings,
    tail_weight,
    variance_loss,
    variance_target,
)
from tests.deep.adam import went_down

Costs = Callable[[np.random.Generator, int], np.ndarray]
SIZES = Sizes(3, 1)
SMALL = WcsacSettings(
    gamma_safe=0.5,
    hidden=(32,),
    learning_rate=3e-3,
    batch_size=64,
    polyak=0.05,
    reward_scale=1.0,
)


def row(*values: float) -> Tensor:
    return torch.tensor([values])


def unconstrained(settings: WcsacSettings) -> SacSettings:
    """SAC's part of them."""
    return SacSettings(
        **{field.name: getattr(settings, field.name) for field in fields(SacSettings)}
    )


def random_batch(seed: int, size: int = 16) -> TaskBatch:
    """One seed's, with nothing to learn."""
    rng = np.random.default_rng(seed)

    def normal(width: int) -> Tensor:
        return torch.from_numpy(rng.standard_normal((1, size, width), dtype=np.float32))

    action = normal(1).tanh()
    cost = (normal(1)[..., 0] > 1).float()
    return TaskBatch(
        normal(3), action, action, normal(3), normal(1)[..., 0], cost, cost, normal(1), normal(1)
    )


def together(batches: list[TaskBatch]) -> TaskBatch:
    """Several seeds' as one."""
    return TaskBatch(*(torch.cat(columns) for columns in zip(*batches, strict=True)))


def chain(update: int, terminal_cost: Costs) -> TaskBatch:
    """s0 -> s1 -> the end, which looks like s0 and costs what ``terminal_cost`` says."""
    rng = np.random.default_rng(update)
    size = 64
    state = rng.integers(2, size=size)
    last = state == 1
    cost = last * terminal_cost(rng, size)
    following = np.where(last, 0, 1)
    noise = rng.standard_normal((3, 1, size, 1), dtype=np.float32)
    action = torch.from_numpy(np.tanh(noise[2]))
    states = torch.eye(3)
    return TaskBatch(
        states[state][None],
        action,
        action,
        states[following][None],
        torch.zeros(1, size),
        torch.from_numpy(cost.astype(np.float32))[None],
        torch.from_numpy(last.astype(np.float32))[None],
        *torch.from_numpy(noise[:2]),
    )


def always(_: np.random.Generator, size: int) -> np.ndarray:
    return np.ones(size)


def half_of_the_time(rng: np.random.Generator, size: int) -> np.ndarray:
    return rng.random(size) < 0.5


@pytest.fixture(scope="module")
def learned() -> tuple[Tensor, Tensor]:
    """Of two seeds, where the end costs always and half of the time: see :func:`learn`."""
    return learn([always, half_of_the_time])


def learn(costs: list[Costs]) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (seeds, 2) in s0 and s1, at the middle of the actions."""
    learner = Wcsac(SMALL, SIZES, range(len(costs)))
    for update in range(1000):
        learner.update(together([chain(update, cost) for cost in costs]))
    states = torch.eye(3)[:2].expand(len(costs), -1, -1)
    with torch.no_grad():
        estimate = learner.cost_critic(states, torch.zeros(len(costs), 2, 1))
    return estimate.mean, estimate.variance.sqrt()


@pytest.mark.parametrize("risk_level", [0.05, 0.1, 0.5, 0.9])
def test_the_tail_weight_is_the_mean_of_the_worst_share_of_a_unit_gaussian(
    risk_level: float,
) -> None:
    shares = (np.arange(100_000) + 0.5) / 100_000
    worst = [NormalDist().inv_cdf(1 - risk_level * share) for share in shares]
    assert tail_weight(risk_level) == pytest.approx(np.mean(worst), abs=1e-4)


def test_the_tail_weight_at_its_ends() -> None:
    assert tail_weight(1.0) == 0.0
    assert tail_weight(0.5) == pytest.approx(math.sqrt(2 / math.pi))
    estimate = CostEstimate(row(0.5), row(0.25))
    assert estimate.tail_mean(0.5).tolist() == [[0.75]]


def test_variance_targets_by_hand() -> None:
    # violation, goal, ordinary step, and one whose mean is estimated too high
    cost, terminal = row(1, 0, 0, 0), row(1, 1, 0, 0)
    following = CostEstimate(row(0.5, 0.5, 0.5, 0.0), row(0.2, 0.2, 0.2, 0.0))
    target = variance_target(cost, terminal, 0.9, following, row(0.6, 0.0, 0.3, 0.4))
    assert target.tolist()[0] == pytest.approx([1 - 0.36, 1e-8, 0.81 * 0.45 - 0.09, 1e-8])


def test_a_cost_that_does_not_end_the_episode_is_added_to_what_follows() -> None:
    # (1 + 0.9 C')^2 for C' in {0, 1} with equal chances, and 1.45 its mean.
    following = CostEstimate(row(0.5), row(0.25))
    target = variance_target(row(1.0), row(0.0), 0.9, following, row(1.45))
    assert target.item() == pytest.approx((1 + 1.9**2) / 2 - 1.45**2)


def test_mean_and_variance_loss_are_the_squared_wasserstein_distance() -> None:
    means, variances = (0.3, 0.7), (0.04, 0.25)
    shares = (np.arange(20_000) + 0.5) / 20_000
    quantiles = [
        np.array([NormalDist(mean, math.sqrt(variance)).inv_cdf(share) for share in shares])
        for mean, variance in zip(means, variances, strict=True)
    ]
    spread = variance_loss(row(variances[0]), row(variances[1]))
    assert spread.item() == pytest.approx((0.2 - 0.5) ** 2, abs=1e-6)
    distance = (means[0] - means[1]) ** 2 + spread.item()
    assert distance == pytest.approx(float(((quantiles[0] - quantiles[1]) ** 2).mean()), abs=1e-4)


def test_a_certain_violation_has_its_discounted_cost_and_no_variance(
    learned: tuple[Tensor, Tensor],
) -> None:
    mean, deviation = (part[0].tolist() for part in learned)
    assert mean == pytest.approx([0.5, 1.0], abs=0.03)
    assert max(deviation) < 0.05


def test_without_the_mask_the_violation_itself_gets_a_variance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def published(cost: Tensor, terminal: Tensor, *rest: object) -> Tensor:
        return variance_target(cost, torch.zeros_like(terminal), *rest)

    monkeypatch.setattr(deep.train.wcsac, "variance_target", published)
    mean, deviation = (part[0].tolist() for part in learn([always]))
    assert mean == pytest.approx([0.5, 1.0], abs=0.03)
    # The end looks like s0: W1 = 1 + 2 g Q0 + g^2 (W0 + Q0^2) - 1 and W0 = g^2 W1.
    wrong = (0.5 + 0.25 * 0.25) / (1 - 0.5**4)
    assert deviation == pytest.approx([0.5 * math.sqrt(wrong), math.sqrt(wrong)], abs=0.05)


def test_a_chance_of_violation_has_the_mean_root_of_its_sampled_variances(
    learned: tuple[Tensor, Tensor],
) -> None:
    mean, deviation = (part[1].tolist() for part in learned)
    assert mean == pytest.approx([0.25, 0.5], abs=0.04)
    last = 0.5 * math.sqrt(1 - 0.25) + 0.5 * math.sqrt(1e-8)
    assert last < 0.5  # which is the deviation: the published loss stays below it
    assert deviation == pytest.approx([0.5 * last, last], abs=0.04)


def test_while_the_multiplier_is_zero_it_is_sac() -> None:
    wcsac = Wcsac(replace(SMALL, cost_limit=(100.0,)), SIZES, (4,))
    sac = Sac(unconstrained(SMALL), SIZES, (4,))
    for update in range(5):
        losses = [learner.update(random_batch(update)) for learner in (wcsac, sac)]
        assert losses[0].critic.equal(losses[1].critic)
        assert losses[0].policy.equal(losses[1].policy)
    for ours, theirs in zip(wcsac.policy.parameters(), sac.policy.parameters(), strict=True):
        assert ours.equal(theirs)


def test_one_update_by_hand() -> None:
    learner, untouched = (Wcsac(SMALL, SIZES, (5,)) for _ in range(2))
    for one in (learner, untouched):  # targets that are not the critics, and a price
        with torch.no_grad():
            one.multiplier.fill_(0.5)
            for part in (*one.critic_target.parameters(), *one.cost_critic_target.parameters()):
                part += 0.1
    batch = random_batch(3)
    s, a, goes_on = batch.observation, batch.action, 1 - batch.terminal
    losses = learner.update(batch._replace(executed=torch.zeros_like(a)))
    with torch.no_grad():
        next_action, _ = untouched.policy.sample(batch.next_observation, batch.next_noise)
        after = untouched.cost_critic_target(batch.next_observation, next_action)
        ahead = after.mean.clamp(0, 1)
        # Every violation of the batch ends its episode.
        mean_target = batch.cost + 0.5 * goes_on * ahead
        square = batch.cost + 0.25 * goes_on * (after.variance + ahead**2)
        variance_wanted = (square - untouched.cost_critic(s, a).mean ** 2).clamp(min=1e-8)
    cost = untouched.cost_critic(s, a)
    cost_loss = ((cost.mean - mean_target) ** 2).mean()
    cost_loss += ((cost.variance.sqrt() - variance_wanted.sqrt()) ** 2).mean()
    # Policy and multiplier see the critics that have just learned, at the policy's own actions.
    action, log_prob = untouched.policy.sample(s, batch.noise)
    estimate = learner.cost_critic(s, action)
    tail = estimate.mean + math.sqrt(2 / math.pi) * estimate.variance.sqrt()
    policy_loss = (0.2 * log_prob - learner.critic.least(s, action) + 0.5 * tail).mean()
    assert losses.policy.item() == pytest.approx(policy_loss.item(), rel=1e-5)
    assert went_down(cost_loss, untouched.cost_critic, learner.cost_critic, SMALL.learning_rate)
    assert went_down(policy_loss, untouched.policy, learner.policy, SMALL.learning_rate)
    excess = tail.mean().item() - learner.limits[0]
    assert learner.multiplier.item() == pytest.approx(0.5 + math.copysign(0.05, excess))
    speed = learner.optimizers[-1].state[learner.multiplier]["exp_avg"]
    assert speed.item() == pytest.approx(-0.1 * excess, rel=1e-4)
    # The targets have followed by polyak.
    for start, online, target in zip(
        (*untouched.critic_target.parameters(), *untouched.cost_critic_target.parameters()),
        (*learner.critic.parameters(), *learner.cost_critic.parameters()),
        (*learner.critic_target.parameters(), *learner.cost_critic_target.parameters()),
        strict=True,
    ):
        assert torch.allclose(target, start + 0.05 * (online - start), atol=1e-6)


def test_the_multiplier_rises_where_the_limit_is_exceeded_and_falls_to_zero_elsewhere() -> None:
    learner = Wcsac(replace(SMALL, cost_limit=(0.2,)), SIZES, (0, 1))
    with torch.no_grad():
        learner.multiplier.fill_(0.1)
    for update in range(300):
        dangerous, harmless = chain(update, always), chain(update, lambda _, size: np.zeros(size))
        learner.update(together([dangerous, harmless]))
    assert learner.multiplier[0].item() > 1
    assert learner.multiplier[1].item() == 0.0


def test_the_policy_meets_the_limit_that_reward_speaks_against() -> None:
    def bandit(update: int) -> TaskBatch:
        """One step, worth the action; positive actions violate."""
        rng = np.random.default_rng(update)
        action = rng.uniform(-1, 1, (1, 64, 1)).astype(np.float32)
        noise = torch.from_numpy(rng.standard_normal((2, 1, 64, 1), dtype=np.float32))
        state = torch.eye(3)[torch.zeros(1, 64, dtype=torch.long)]
        a, one = torch.from_numpy(action), torch.ones(1, 64)
        cost = (a[..., 0] > 0).float()
        return TaskBatch(state, a, a, state, a[..., 0], cost, one, *noise)

    def violating_share(learner: Sac | Wcsac) -> float:
        """Averaged over updates, since the multiplier's way to its place is a spiral."""
        noise = torch.from_numpy(np.random.default_rng(1).standard_normal((1, 256, 1))).float()
        states = torch.eye(3)[torch.zeros(1, 256, dtype=torch.long)]
        shares = []
        for update in range(900):
            learner.update(bandit(update))
            with torch.no_grad():
                shares.append(float((learner.policy.sample(states, noise)[0] > 0).float().mean()))
        return float(np.mean(shares[300:]))

    settings = replace(SMALL, risk_level=1.0, cost_limit=(0.2,), multiplier_rate=0.01)
    constrained = Wcsac(settings, SIZES, (0,))
    assert violating_share(Sac(unconstrained(settings), SIZES, (0,))) > 0.8
    assert 0.02 < violating_share(constrained) < 0.25
    assert constrained.multiplier.item() > 0.5


def test_no_error_of_the_next_mean_below_zero_or_above_one_is_learned() -> None:
    def taught(bias: float) -> Wcsac:
        """One update from a target network whose mean is about ``bias`` everywhere."""
        learner = Wcsac(SMALL, SIZES, (4,))
        with torch.no_grad():
            learner.cost_critic_target.both.mlp.biases[-1][0] = bias
        learner.update(random_batch(0))
        return learner

    found = {bias: taught(bias).cost_critic.state_dict() for bias in (-90, -9, 0.5, 9, 90)}
    for name, tensor in found[-9].items():
        assert tensor.equal(found[-90][name])
        assert found[9][name].equal(found[90][name])
    weights = "both.mlp.biases.0"
    assert not found[-9][weights].equal(found[0.5][weights])
    assert not found[9][weights].equal(found[0.5][weights])
    assert not found[9][weights].equal(found[-9][weights])


def test_every_seed_can_have_a_limit_of_its_own() -> None:
    learner = Wcsac(replace(SMALL, cost_limit=(0.0, 2.0)), SIZES, (0, 1))
    assert learner.limits == (0.0, 2.0)
    assert Wcsac(replace(SMALL, cost_limit=(0.3,)), SIZES, (0, 1)).limits == (0.3, 0.3)
    with torch.no_grad():
        learner.multiplier.fill_(0.5)
    for update in range(100):
        learner.update(together([chain(update, always)] * 2))
    assert learner.multiplier[0].item() > 1
    assert learner.multiplier[1].item() == 0.0
    with pytest.raises(ValueError, match="^2 cost limits for 3 seeds: give one, or one each$"):
        Wcsac(replace(SMALL, cost_limit=(0.1, 0.2)), SIZES, (0, 1, 2))


def lidar_like(sharpness: float) -> Sequence[Normalisation]:
    """Two seeds' normalisations of (a speed, a closeness, a closeness)."""
    rng = np.random.default_rng(5)
    seen = [rng.random((50, 3)) * [-4, 1, 1] for _ in range(2)]
    return [normalisation_of_observations(x.astype(np.float32), 1, sharpness) for x in seen]


def test_the_cost_critic_sees_closenesses_to_a_power() -> None:
    learner = Wcsac(replace(SMALL, sharpness=8.0), SIZES, (0, 1))
    raw = torch.tensor([[[-3.0, 0.5, 0.9]], [[-1.0, 0.0, 1.0]]])
    standardised = TensorNormalisation(lidar_like(1.0)).observation(raw)
    assert learner.view(standardised).equal(standardised)  # before it is told
    learner.look(lidar_like)
    expected = TensorNormalisation(lidar_like(8.0)).observation(raw)
    assert learner.view(standardised).numpy() == pytest.approx(expected.numpy(), abs=1e-4)
    assert not learner.view(standardised)[..., 1:].allclose(standardised[..., 1:], atol=0.01)
    again = Wcsac(replace(SMALL, sharpness=8.0), SIZES, (0, 1))
    again.load_state_dict(learner.state_dict())  # as a resumed run does
    assert again.view(standardised).equal(learner.view(standardised))


def test_a_closeness_below_zero_counts_as_zero_to_any_power() -> None:
    learner = Wcsac(replace(SMALL, sharpness=2.5), SIZES, (0, 1))
    learner.look(lidar_like)
    raw = torch.tensor([[[-3.0, -0.2, 0.0]], [[-1.0, -1e-7, 0.5]]])
    found = learner.view(TensorNormalisation(lidar_like(1.0)).observation(raw))
    expected = TensorNormalisation(lidar_like(2.5)).observation(raw)
    assert found.numpy() == pytest.approx(expected.numpy(), abs=1e-4)


def test_only_the_cost_critic_sees_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the multiplier is zero nothing else changes, and with sharpness 1 nothing at all."""
    harmless = replace(SMALL, cost_limit=(100.0,))
    sharp, plain = (Wcsac(replace(harmless, sharpness=s), SIZES, (4,)) for s in (8.0, 1.0))
    for learner in (sharp, plain):
        learner.look(lambda sharpness: lidar_like(sharpness)[:1])
    untouched = Wcsac(harmless, SIZES, (4,))
    for update in range(3):
        batch = random_batch(update)
        losses = [learner.update(batch) for learner in (sharp, plain, untouched)]
        assert losses[0].policy.equal(losses[1].policy)
    s, a = random_batch(9).observation, random_batch(9).action
    means = [learner.cost_critic(s, a).mean for learner in (sharp, plain, untouched)]
    assert not means[0].equal(means[1])
    assert means[1].equal(means[2])
    seen: list[Tensor] = []
    forward = sharp.cost_critic.forward

    def watched(observation: Tensor, action: Tensor) -> CostEstimate:
        seen.append(observation)
        return forward(observation, action)

    for critic in (sharp.cost_critic, sharp.cost_critic_target):
        monkeypatch.setattr(critic, "forward", watched)
    batch = random_batch(10)
    sharp.update(batch)
    views = [sharp.view(batch.observation), sharp.view(batch.next_observation)]
    assert [x.equal(views[0]) for x in seen] == [True, False, True]  # s, s', and s once more
    assert seen[1].equal(views[1])


def test_a_seed_learns_the_same_alone() -> None:
    both = Wcsac(replace(SMALL, cost_limit=(0.0,)), SIZES, (3, 8))
    alone = Wcsac(replace(SMALL, cost_limit=(0.0,)), SIZES, (8,))
    for update in range(10):
        own = random_batch(100 + update)
        both.update(together([random_batch(update), own]))
        alone.update(own)
    assert alone.multiplier.item() > 0
    for name, tensor in alone.state_dict().items():
        found = both.state_dict()[name].reshape(2, -1)[1]  # seeds come first in every tensor
        assert found.tolist() == pytest.approx(tensor.flatten().tolist(), abs=1e-5), name


def test_a_checkpoint_holds_the_multiplier_and_its_speed(tmp_path: Path) -> None:
    settings = replace(SMALL, cost_limit=(0.0,))
    whole, first, second = (Wcsac(settings, SIZES, (3,)) for _ in range(3))
    for update in range(6):
        whole.update(random_batch(update))
    for update in range(3):
        first.update(random_batch(update))
    save_checkpoint(first, 3, tmp_path / "checkpoint.safetensors")
    assert load_checkpoint(second, tmp_path / "checkpoint.safetensors")[0] == 3
    for update in range(3, 6):
        second.update(random_batch(update))
    for name, tensor in whole.state_dict().items():
        assert tensor.equal(second.state_dict()[name]), name


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"gamma_safe": 0.0}, r"gamma_safe must lie in \(0, 1\], not 0.0"),
        ({"risk_level": 0.0}, r"risk_level must lie in \(0, 1\], not 0.0"),
        ({"risk_level": 1.5}, r"risk_level must lie in \(0, 1\], not 1.5"),
        ({"cost_limit": (0.1, -0.1)}, r"cost_limit must not be negative, not \(0.1, -0.1\)"),
        ({"cost_limit": ()}, r"cost_limit must not be negative, not \(\)"),
        ({"sharpness": 0.5}, "sharpness must be at least 1 and finite, not 0.5"),
        ({"sharpness": math.inf}, "sharpness must be at least 1 and finite, not inf"),
        ({"multiplier_rate": 0.0}, "multiplier_rate must be positive, not 0.0"),
        ({"temperature": -1.0}, "temperature must not be negative, not -1.0"),
    ],
)
def test_settings_that_make_no_sense(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        WcsacSettings(**wrong)


def test_a_run_names_its_learner() -> None:
    for settings, kind in ((SMALL, Wcsac), (SacSettings(hidden=(8,)), Sac)):
        config = TrainConfig(task="point-goal1", method=settings, seeds=(1, 2))
        plain = train_config_to_json(config)
        assert plain["method"]["name"] == kind.name
        assert train_config_from_json(plain) == config
        learner = build_task_learner(config, SIZES)
        assert type(learner) is kind
        assert learner.seeds == (1, 2)
