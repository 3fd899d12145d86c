"""Algorithm 1 from transitions to safety filters, in memory.

:func:`pretrain` is the whole of it. A run that is kept in a folder and may be interrupted
(:mod:`deep.pretraining.run`) is made of the same parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from tqdm import tqdm

from deep.data.minibatches import Batch, Batches
from deep.data.normalisation import Normalisation, Ranges, normalisation_of, normalise, ranges_of
from deep.data.transitions import Transitions
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import (
    DEFAULT,
    Learner,
    Losses,
    Settings,
    Sizes,
    build_learner,
)
from deep.pretraining.config import Training, resolve
from deep.pretraining.health import FilterHealth, check_filter, check_losses
from deep.pretraining.trained_filter import trained_filter

__all__ = [
    "PretrainResult",
    "begin",
    "check_device",
    "filters_of",
    "make_updates",
    "pretrain",
]


@dataclass(frozen=True)
class PretrainResult:
    """What pretraining gives.

    Attributes:
        filters: one a seed, in the order of the seeds.
        health: what each seed's filter does with the log that it was trained on.

    >>> result = pretrain(log, horizon=3, seeds=(0, 7), updates=3, quiet=True)
    >>> [safety.seed for safety in result.filters]
    [0, 7]
    """

    filters: tuple[SafetyFilter, ...]
    health: tuple[FilterHealth, ...]


def pretrain(
    log: Transitions,
    horizon: int | None = None,
    *,
    method: Settings | None = None,
    seeds: Sequence[int] = Training.seeds,
    updates: int = Training.updates,
    gamma_safe: float | None = None,
    threshold: float | None = None,
    sharpness: float = Training.sharpness,
    action_low: Sequence[float] | None = None,
    action_high: Sequence[float] | None = None,
    device: str = Training.device,
    quiet: bool = False,
) -> PretrainResult:
    """Learn safety filters from a log (Algorithm 1); no folder, no file.

    A filter of no use is a result like any other: its ``health`` says so. The filters are
    those that :func:`deep.pretraining.run.pretrain_in_folder` learns from a file of the log.

    Args:
        log: the transitions, in the environment's own units.
        horizon: H, the most steps from a dead-end to the violation; without it both
            ``gamma_safe`` and ``threshold`` are needed.
        method: the form of Algorithm 1, with its settings; None: this project's own,
            DEA-RRL (annealed).
        seeds: one critic, recovery policy and filter each, trained side by side.
        updates: minibatch updates.
        gamma_safe, threshold, sharpness, action_low, action_high, device: as in
            :class:`~deep.pretraining.config.Training`.
        quiet: show no progress bar.

    Raises:
        ValueError: for settings that cannot be used, with the reason.
        FloatingPointError: if a loss is not a number.

    A car that learns when it is too late to brake; three updates are too few for it:

        >>> import numpy as np
        >>> from deep import Transitions, pretrain
        >>> gap = np.array([3.0, 2.0, 1.0, 3.0, 2.5])[:, None]
        >>> log = Transitions(
        ...     observations=gap, actions=[[1.0], [1.0], [1.0], [0.5], [-1.0]],
        ...     next_observations=gap - 1, rewards=np.zeros(5), costs=[0, 0, 1, 0, 0],
        ...     terminals=[0, 0, 1, 0, 0], timeouts=[0, 0, 0, 0, 1])
        >>> result = pretrain(log, horizon=3, updates=3, quiet=True)
        >>> result.filters[0].threshold, result.health[0].transitions
        (0.10546875, 5)
    """
    training = resolve(
        Training(
            method=DEFAULT.settings() if method is None else method,
            seeds=tuple(seeds),
            updates=updates,
            horizon=horizon,
            gamma_safe=gamma_safe,
            sharpness=sharpness,
            threshold=threshold,
            action_low=None if action_low is None else tuple(action_low),
            action_high=None if action_high is None else tuple(action_high),
            device=device,
        )
    )
    check_device(device)
    count = len(training.seeds)
    ranges = [ranges_of(log, training.action_bounds)] * count
    normalisations = [normalisation_of(log, sharpness)] * count
    learner, batches = begin(training, [normalise(log, normalisations[0])])
    for done, _, losses in make_updates(learner, batches, training.updates, 0, quiet):
        if done % training.log_every == 0 or done == training.updates:
            check_losses(learner, losses, done)
    filters = filters_of(learner, training, normalisations, ranges)
    return PretrainResult(filters, tuple(check_filter(f, log, horizon) for f in filters))


def check_device(device: str) -> None:
    """There is such a device.

    Raises:
        ValueError: if there is not.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("device cuda: this machine or this build of torch has no CUDA device")


def begin(training: Training, data: Sequence[Transitions]) -> tuple[Learner, Batches]:
    """The learner before its first update, and what it learns from: a copy of the data.

    Args:
        training: resolved.
        data: normalised; one set for all seeds, or one a seed.
    """
    device, settings = torch.device(training.device), training.method
    sizes = Sizes(data[0].observations.shape[1], data[0].actions.shape[1])
    learner = build_learner(settings, sizes, training.seeds).to(device)
    return learner, Batches(
        data, training.seeds, settings.batch_size, settings.violation_share, device
    )


def make_updates(
    learner: Learner, batches: Batches, total: int, done: int, quiet: bool
) -> Iterator[tuple[int, Batch, Losses]]:
    """Make the updates from number ``done`` on; after each: how many are done, its batch
    and its losses.
    """
    with tqdm(total=total, initial=done, desc=learner.name, unit="", disable=quiet) as bar:
        for update in range(done, total):
            batch = batches.get(update)
            losses = learner.update(batch, update / total)
            bar.update()
            yield update + 1, batch, losses


def filters_of(
    learner: Learner,
    training: Training,
    normalisations: Sequence[Normalisation],
    ranges: Sequence[Ranges],
) -> tuple[SafetyFilter, ...]:
    """The filters that the seeds have learned, behind the resolved threshold."""
    assert training.threshold is not None
    assert training.gamma_safe is not None
    return tuple(
        trained_filter(learner, seed, training.threshold, training.gamma_safe, normalisation, own)
        for seed, normalisation, own in zip(training.seeds, normalisations, ranges, strict=True)
    )
