"""Who corrects during online training (Algorithm 2, lines 9 to 14), by Equation
(behavior_correction).

All actions are in the environment's own units. What is executed is finite and within the
bounds by the rules of :mod:`deep.filter.safety_filter`, finetuned or not.

DEA-RRL's critic and recovery policy stay as pretrained, which gives the task policy a
stable environment; RRL's go on learning, because the critic it needs is the task policy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deep.data.minibatches import Batch, Batches
from deep.data.normalisation import Ranges, TensorNormalisation, columns
from deep.filter.safety_filter import SafetyFilter, Watch, inner_ends
from deep.pretraining import Learner, Rrl, TaskPolicy
from deep.pretraining.health import check_losses
from deep.pretraining.trained_filter import trained_filter
from deep.train.learner import TaskBatch

__all__ = [
    "Corrected",
    "FinetunedCorrection",
    "FrozenCorrection",
    "NoCorrection",
    "TrainingCorrection",
]

Floats = NDArray[np.float32]


class Corrected(NamedTuple):
    """What was made of N actions of K seeds.

    Attributes:
        executed: float32 (K, N, a).
        intervened: bool (K, N).
    """

    executed: Floats
    intervened: NDArray[np.bool_]


def corrected_tensors(
    proposed: Tensor, critic: Tensor, threshold: Tensor, recovery: Tensor
) -> tuple[Tensor, Tensor]:
    """Equation (behavior_correction) in torch, as :func:`deep.filter.equation.corrected` has it.

    Args:
        proposed, recovery: (K, N, a), the agents' and the recovery policies' actions.
        critic: (K, N), Q_c of what is proposed; what is a NaN is blocked.
        threshold: (K, 1).
    """
    intervened = ~(critic < threshold)
    return torch.where(intervened[..., None], recovery, proposed), intervened


class TrainingCorrection(Protocol):
    """Who corrects during training: K seeds, each with its own critic."""

    def correct(self, observation: Floats, action: Floats) -> Corrected:
        """Correct raw actions (K, N, a) in raw observations (K, N, o)."""

    def learn(self, update: int, batch: TaskBatch, task_policy: TaskPolicy) -> None:
        """Finetune on the task learner's batch, raw, after its own update.

        ``task_policy`` takes raw observations and noise and gives actions.
        """

    def filters(self) -> tuple[SafetyFilter, ...]:
        """The filters as they are now, one a seed; none where nothing is corrected."""


class NoCorrection:
    """No correction: SAC and WCSAC."""

    def correct(self, observation: Floats, action: Floats) -> Corrected:  # noqa: ARG002  (a TrainingCorrection)
        """The actions."""
        return Corrected(action, np.zeros(action.shape[:2], dtype=np.bool_))

    def learn(self, update: int, batch: TaskBatch, task_policy: TaskPolicy) -> None:
        """Nothing."""

    def filters(self) -> tuple[SafetyFilter, ...]:
        """None."""
        return ()


class FrozenCorrection:
    """DEA-RRL and its forms: one pretrained filter a seed.

    Attributes:
        watch: counts of what the filters did and met, over all seeds.
    """

    def __init__(self, filters: Sequence[SafetyFilter]) -> None:
        self._filters = tuple(filters)
        self.watch = Watch()

    def correct(self, observation: Floats, action: Floats) -> Corrected:
        """Equation (behavior_correction) of every seed's filter."""
        done = [f.correct(s, a) for f, s, a in zip(self._filters, observation, action, strict=True)]
        for safety, seen, correction in zip(self._filters, observation, done, strict=True):
            self.watch.add(safety, seen, correction)
        return Corrected(
            np.stack([part.executed for part in done]), np.stack([part.intervened for part in done])
        )

    def learn(self, update: int, batch: TaskBatch, task_policy: TaskPolicy) -> None:
        """Nothing: the correction is a fixed part of the environment."""

    def filters(self) -> tuple[SafetyFilter, ...]:
        """The filters."""
        return self._filters


class FinetunedCorrection:
    """RRL and RRL (MSDP): the learner goes on, on half offline and half online data.

    Args:
        learner: pretrained; changed in place.
        thresholds: one a seed.
        normalisation: what the learner's networks see.
        ranges: of the pretraining's data, one a seed; the action bounds are the task's.
        gamma_safe: the learner's discount of the cost.
        offline: the pretraining's data as recorded, half of the batch size at a time.
    """

    def __init__(
        self,
        learner: Learner,
        thresholds: Sequence[float],
        normalisation: TensorNormalisation,
        ranges: Sequence[Ranges],
        gamma_safe: float,
        offline: Batches,
    ) -> None:
        self.learner = learner
        self._gamma_safe = gamma_safe
        self._thresholds = tuple(thresholds)
        self._limits = torch.tensor(thresholds, dtype=torch.float32)[:, None]
        self._normalisation = normalisation
        self._ranges = tuple(ranges)
        ends = [inner_ends(own.actions) for own in ranges]
        self._low, self._high = (
            columns(x.tolist() for x in end) for end in zip(*ends, strict=True)
        )
        self._offline = offline

    @torch.no_grad()
    def correct(self, observation: Floats, action: Floats) -> Corrected:
        """Equation (behavior_correction) with the critic of the moment."""
        raw, proposed = torch.from_numpy(observation), torch.from_numpy(action)
        s = self._normalisation.observation(raw)
        seen = raw.isfinite() & s.isfinite()
        s = torch.where(seen, s, 0.0)
        a = proposed.clamp(self._low, self._high)
        logits = self.learner.critic.logits(s, self._normalisation.action(a))
        known = seen.all(dim=-1) & proposed.isfinite().all(dim=-1) & logits.isfinite().all(dim=1)
        critic = torch.where(known, torch.sigmoid(logits.amax(dim=1)), 1.0)
        unit = self.learner.recovery.mean_action(s).nan_to_num(nan=0.0)
        recovery = self._normalisation.raw_action(unit).clamp(self._low, self._high)
        executed, intervened = corrected_tensors(a, critic, self._limits, recovery)
        return Corrected(executed.numpy(), intervened.numpy())

    def learn(self, update: int, batch: TaskBatch, task_policy: TaskPolicy) -> None:
        """One update of critic and recovery policy; RRL's critic is that of ``task_policy``.

        Raises:
            FloatingPointError: if a loss is not a number.
        """
        raw = _joined(self._offline.get(update), batch)
        normalisation = self._normalisation
        if isinstance(self.learner, Rrl):
            # RRL asks in its own coordinates; the task policy has others.
            self.learner.task_policy = lambda _, noise: normalisation.action(
                task_policy(raw.next_observation, noise)
            )
        losses = self.learner.update(
            raw._replace(
                observation=normalisation.observation(raw.observation),
                next_observation=normalisation.observation(raw.next_observation),
                action=normalisation.action(raw.action),
            ),
            0.0,
        )
        try:
            check_losses(self.learner, losses, update)
        except FloatingPointError as error:
            raise FloatingPointError(f"finetuning of {self.learner.name}: {error}") from error

    def filters(self) -> tuple[SafetyFilter, ...]:
        """Copies of the networks of the moment."""
        return tuple(
            trained_filter(self.learner, seed, threshold, self._gamma_safe, normalisation, ranges)
            for seed, threshold, normalisation, ranges in zip(
                self.learner.seeds,
                self._thresholds,
                self._normalisation.of_seeds,
                self._ranges,
                strict=True,
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
    return Batch(
        *(torch.cat([old, new[:, :half]], dim=1) for old, new in zip(offline, fresh, strict=True))
    )
