"""Small networks for K seeds at once: one batched matrix product a layer.

Every tensor carries a leading seed axis K. The seeds share nothing: each has its own
weights, initialised from its own number, and its own loss, so that seed k of a batch
learns what the same seed learns alone (up to the rounding of a batched product). Layers
are Xavier-uniform with zero biases, as in the authors' code.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

__all__ = [
    "ActionValue",
    "BatchedMLP",
    "Critic",
    "GaussianPolicy",
    "StateValue",
    "TaskValue",
    "copy_slowly",
]

LOG_STD_RANGE = (-20.0, 2.0)


class BatchedMLP(nn.Module):
    """K independent perceptrons with ReLU between their layers.

    Attributes:
        weights: one (K, in, out) a layer.
        biases: one (K, 1, out) a layer.
    """

    def __init__(self, sizes: Sequence[int], generators: Sequence[np.random.Generator]) -> None:
        super().__init__()
        self.sizes = tuple(sizes)
        pairs = list(pairwise(sizes))
        self.weights = nn.ParameterList(_xavier(a, b, generators) for a, b in pairs)
        self.biases = nn.ParameterList(
            nn.Parameter(torch.zeros(len(generators), 1, b)) for _, b in pairs
        )

    def forward(self, x: Tensor) -> Tensor:
        """(K, B, in) -> (K, B, out)."""
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, x, weight)
            if layer < last:
                x = torch.relu(x)
        return x


def _xavier(inputs: int, outputs: int, generators: Sequence[np.random.Generator]) -> nn.Parameter:
    bound = math.sqrt(6 / (inputs + outputs))
    drawn = [generator.uniform(-bound, bound, (inputs, outputs)) for generator in generators]
    return nn.Parameter(torch.tensor(np.stack(drawn), dtype=torch.float32))


def _generators(seeds: Sequence[int], network: str, members: int) -> Iterator[np.random.Generator]:
    """One generator a seed and member, independent of which other seeds are in the batch."""
    salt = int.from_bytes(network.encode(), "big")
    for seed in seeds:
        for member in range(members):
            yield np.random.default_rng((seed, salt, member))


class ActionValue(nn.Module):
    """Q(s, a) of K seeds, each with an ensemble of ``members`` networks (twins: 2).

    The output is any real number: a task policy's return, or a logit (:class:`Critic`).
    """

    def __init__(
        self,
        seeds: Sequence[int],
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int],
        members: int = 2,
        name: str = "task critic",
    ) -> None:
        super().__init__()
        self.members = members
        generators = list(_generators(seeds, name, members))
        self.mlp = BatchedMLP([observation_dim + action_dim, *hidden, 1], generators)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """(K, B, o) and (K, B, a) -> (K, members, B)."""
        x = torch.cat([observation, action], dim=-1)
        repeated = x.repeat_interleave(self.members, dim=0)
        output: Tensor = self.mlp(repeated)
        return output.view(len(x), self.members, -1)

    def least(self, observation: Tensor, action: Tensor) -> Tensor:
        """(K, B): the smallest member's, against overestimation."""
        values: Tensor = self(observation, action)
        return values.amin(dim=1)


class Critic(ActionValue):
    """Q_c(s, a): the sigmoid of an action value, a discounted probability of failing."""

    def __init__(
        self,
        seeds: Sequence[int],
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int],
        members: int = 2,
    ) -> None:
        super().__init__(seeds, observation_dim, action_dim, hidden, members, name="critic")

    def logits(self, observation: Tensor, action: Tensor) -> Tensor:
        """(K, B, o) and (K, B, a) -> (K, members, B), before the sigmoid."""
        return super().forward(observation, action)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """The values (K, members, B), in (0, 1)."""
        return torch.sigmoid(self.logits(observation, action))

    def worst(self, observation: Tensor, action: Tensor) -> Tensor:
        """(K, B): the most pessimistic member, which the gate uses."""
        return torch.sigmoid(self.logits(observation, action).amax(dim=1))


class TaskValue(nn.Module):
    """V(s) of K seeds; the output is any real number, a task policy's return."""

    def __init__(
        self,
        seeds: Sequence[int],
        observation_dim: int,
        hidden: Sequence[int],
        name: str = "task value",
    ) -> None:
        super().__init__()
        generators = list(_generators(seeds, name, 1))
        self.mlp = BatchedMLP([observation_dim, *hidden, 1], generators)

    def forward(self, observation: Tensor) -> Tensor:
        """(K, B, o) -> (K, B)."""
        output: Tensor = self.mlp(observation)
        return output.squeeze(-1)


class StateValue(TaskValue):
    """V_c(s) of K seeds, in (0, 1): the sigmoid of a value."""

    def __init__(self, seeds: Sequence[int], observation_dim: int, hidden: Sequence[int]) -> None:
        super().__init__(seeds, observation_dim, hidden, name="value")

    def forward(self, observation: Tensor) -> Tensor:
        """(K, B, o) -> (K, B)."""
        return torch.sigmoid(super().forward(observation))


class GaussianPolicy(nn.Module):
    """A policy of K seeds: tanh of a Gaussian, executed as ``reach * tanh(mean)``.

    ``reach`` = 1 is the usual squashing, which only tends to the ends of the action
    range. With ``reach`` > 1 what lies outside [-1, 1] is cut off, so that full braking
    can be executed exactly.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int],
        reach: float = 1.0,
        name: str = "policy",
    ) -> None:
        super().__init__()
        if reach < 1:
            raise ValueError(f"reach must be at least 1, not {reach}")
        self.reach = reach
        self.action_dim = action_dim
        generators = list(_generators(seeds, name, 1))
        self.mlp = BatchedMLP([observation_dim, *hidden, 2 * action_dim], generators)

    def distribution(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation before the squashing, each (K, B, a)."""
        mean, log_std = self.mlp(observation).split(self.action_dim, dim=-1)
        return mean, log_std.clamp(*LOG_STD_RANGE)

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (K, B, a) from unit ``noise`` of that shape, and log pi (K, B)."""
        mean, log_std = self.distribution(observation)
        raw = mean + noise * log_std.exp()
        log_prob = _gaussian_log_prob(raw, mean, log_std) - _log_tanh_slope(raw)
        return self._squash(raw), log_prob.sum(dim=-1)

    def log_prob(self, observation: Tensor, action: Tensor) -> Tensor:
        """log pi(a|s), (K, B), of actions in [-1, 1] (density of the plain tanh-Gaussian)."""
        mean, log_std = self.distribution(observation)
        raw = torch.atanh(action.clamp(-1 + 1e-4, 1 - 1e-4))
        return (_gaussian_log_prob(raw, mean, log_std) - _log_tanh_slope(raw)).sum(dim=-1)

    def mean_action(self, observation: Tensor) -> Tensor:
        """(K, B, a): what behavior correction executes."""
        mean, _ = self.distribution(observation)
        return self._squash(mean)

    def _squash(self, raw: Tensor) -> Tensor:
        squashed = torch.tanh(raw)
        return squashed if self.reach == 1 else (self.reach * squashed).clamp(-1, 1)


def _gaussian_log_prob(raw: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    scaled = (raw - mean) * torch.exp(-log_std)
    return -0.5 * scaled**2 - log_std - 0.5 * math.log(2 * math.pi)


def _log_tanh_slope(raw: Tensor) -> Tensor:
    """log(1 - tanh(x)^2), stable for large |x|."""
    return 2 * (math.log(2) - raw - nn.functional.softplus(-2 * raw))


@torch.no_grad()
def copy_slowly(source: nn.Module, target: nn.Module, share: float) -> None:
    """Polyak averaging: target <- (1 - share) target + share source; share 1 copies."""
    torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), share)


def adam(module: nn.Module, learning_rate: float) -> torch.optim.Adam:
    """Adam, one fused kernel for all parameters."""
    return torch.optim.Adam(module.parameters(), lr=learning_rate, fused=True)


def minimise(optimizer: torch.optim.Optimizer, loss: Tensor) -> Tensor:
    """One step down the sum of the seeds' losses (K,), which it returns detached."""
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    optimizer.zero_grad(set_to_none=True)
    # Only these: a recovery loss runs through the critic, whose gradients nobody needs.
    torch.autograd.backward(loss.sum(), inputs=parameters)
    optimizer.step()
    return loss.detach()
