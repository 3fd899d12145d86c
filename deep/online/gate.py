"""Who corrects during online training (Algorithm 2, lines 9 to 14).

    a = a_task if Q_c(s, a_task) < epsilon, else the mean of pi_rec(s)

DEA-RRL's critic and recovery policy stay as pretrained, which gives the task policy a
stable environment; RRL's go on learning, because the critic it needs is the task policy's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deep.batches import Batch, Batches
from deep.networks import GaussianPolicy
from deep.online.learner import TaskBatch
from deep.pretrain import Learner, Rrl
from deep.pretrain.extract import extract_filter
from deep.safety_filter import Normalisation, SafetyFilter

__all__ = ["FinetunedGate", "FrozenGate", "Gate", "Gated", "OpenGate"]

Floats = NDArray[np.float32]


class Gated(NamedTuple):
    """What was made of N actions of K seeds.

    Attributes:
        executed: float32 (K, N, a).
        intervened: bool (K, N).
    """

    executed: Floats
    intervened: NDArray[np.bool_]


class Gate(Protocol):
    """Behavior correction for K seeds, each with its own critic."""

    def correct(self, observation: Floats, action: Floats) -> Gated:
        """Correct raw actions (K, N, a) in raw observations (K, N, o)."""

    def learn(self, update: int, batch: TaskBatch, policy: GaussianPolicy) -> None:
        """Finetune on the task learner's batch, after its own update."""

    def filters(self) -> tuple[SafetyFilter, ...]:
        """The filters as they are now, one a seed; none where nothing is corrected."""


class OpenGate:
    """No correction: SAC and WCSAC."""

    def correct(self, observation: Floats, action: Floats) -> Gated:  # noqa: ARG002  (a Gate)
        """The actions."""
        return Gated(action, np.zeros(action.shape[:2], dtype=np.bool_))

    def learn(self, update: int, batch: TaskBatch, policy: GaussianPolicy) -> None:
        """Nothing."""

    def filters(self) -> tuple[SafetyFilter, ...]:
        """None."""
        return ()


class FrozenGate:
    """DEA-RRL and its forms: one pretrained filter a seed."""

    def __init__(self, filters: Sequence[SafetyFilter]) -> None:
        self._filters = tuple(filters)

    def correct(self, observation: Floats, action: Floats) -> Gated:
        """Equation (behavior_correction) of every seed's filter."""
        done = [f.correct(s, a) for f, s, a in zip(self._filters, observation, action, strict=True)]
        return Gated(
            np.stack([part.executed for part in done]), np.stack([part.intervened for part in done])
        )

    def learn(self, update: int, batch: TaskBatch, policy: GaussianPolicy) -> None:
        """Nothing: the correction is a fixed part of the environment."""

    def filters(self) -> tuple[SafetyFilter, ...]:
        """The filters."""
        return self._filters


class FinetunedGate:
    """RRL and RRL (MSDP): the learner goes on, on half offline and half online data.

    Args:
        learner: pretrained; changed in place.
        thresholds: one a seed.
        normalisation: one a seed.
        gamma_safe: the learner's discount of the cost.
        offline: the pretraining's data, half of the batch size at a time.
    """

    def __init__(
        self,
        learner: Learner,
        thresholds: Sequence[float],
        normalisation: Sequence[Normalisation],
        gamma_safe: float,
        offline: Batches,
    ) -> None:
        self.learner = learner
        self._gamma_safe = gamma_safe
        self._thresholds = tuple(thresholds)
        self._limits = torch.tensor(thresholds, dtype=torch.float32)[:, None]
        self._normalisation = tuple(normalisation)
        self._offline = offline
        self._centre = _columns(n.observation_centre for n in normalisation)
        self._scale = _columns(n.observation_scale for n in normalisation)
        self._action_centre = _columns(n.action_centre for n in normalisation)
        self._action_scale = _columns(n.action_scale for n in normalisation)

    @torch.no_grad()
    def correct(self, observation: Floats, action: Floats) -> Gated:
        """Equation (behavior_correction) with the critic of the moment."""
        s = (torch.from_numpy(observation) - self._centre) / self._scale
        a = torch.from_numpy(action)
        intervened = ~(self.learner.critic.worst(s, self._scaled(a)) < self._limits)
        recovery = self.learner.recovery.mean_action(s) * self._action_scale + self._action_centre
        return Gated(torch.where(intervened[..., None], recovery, a).numpy(), intervened.numpy())

    def learn(self, update: int, batch: TaskBatch, policy: GaussianPolicy) -> None:
        """One update of critic and recovery policy; RRL's critic is that of ``policy``."""
        if isinstance(self.learner, Rrl):
            self.learner.task_policy = lambda s, noise: self._scaled(policy.sample(s, noise)[0])
        fresh = batch._replace(executed=self._scaled(batch.executed))
        self.learner.update(_joined(self._offline.get(update), fresh), 0.0)

    def _scaled(self, action: Tensor) -> Tensor:
        return (action - self._action_centre) / self._action_scale

    def filters(self) -> tuple[SafetyFilter, ...]:
        """Copies of the networks of the moment."""
        return tuple(
            extract_filter(self.learner, seed, threshold, self._gamma_safe, normalisation)
            for seed, threshold, normalisation in zip(
                self.learner.seeds, self._thresholds, self._normalisation, strict=True
            )
        )


def _joined(offline: Batch, online: TaskBatch) -> Batch:
    """Offline transitions and as many online ones, with the actions that were executed."""
    half = offline.cost.shape[1]
    fresh = Batch(
        online.observation,
        online.executed,
        online.next_observation,
        online.cost,
        online.terminal,
        online.noise,
        online.next_noise,
    )
    return Batch(*(_halves(old, new[:, :half]) for old, new in zip(offline, fresh, strict=True)))


def _columns(rows: Iterable[Sequence[float]]) -> Tensor:
    """(K, 1, n) from K rows."""
    return torch.tensor(list(rows), dtype=torch.float32)[:, None]


def _halves(first: Tensor, second: Tensor) -> Tensor:
    return torch.cat([first, second], dim=1)
