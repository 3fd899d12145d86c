"""One run of Algorithm 1 in a folder: from data to safety filters, resumable at any moment.

The folder holds ``config.json`` (resolved, with versions), ``progress.csv``,
``checkpoint.safetensors`` and, at the end, ``health.json`` and
``filters/seed<k>.safetensors``. Every update
is a function of the state before it and of its number, so a run that is killed and taken
up again from its last checkpoint ends as if nothing had happened.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from deep.data.formats import read_hdf5
from deep.data.minibatches import Batches
from deep.data.normalisation import Normalisation, Ranges, normalisation_of, normalise, ranges_of
from deep.data.transitions import Transitions
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import Learner
from deep.pretraining.algorithm import (
    PretrainResult,
    begin,
    check_device,
    filters_of,
    make_updates,
)
from deep.pretraining.config import PretrainConfig, config_from_json, config_to_json, resolve
from deep.pretraining.health import check_filter, check_losses, write_health
from deep.runs.checkpoint import load_checkpoint, save_checkpoint
from deep.runs.folder import (
    CsvLog,
    InterruptAfterUpdate,
    check_folder,
    fingerprint,
    only_process,
    open_folder,
    read_object,
)
from deep.tasks import Brake, DoubleIntegrator, Task, make_task
from deep.tasks.bounds import Bounds

__all__ = [
    "load_data",
    "load_raw",
    "open_run",
    "pretrain_in_folder",
    "read_run",
    "task_horizon",
]

COLUMNS = ("update", "seed", "critic_loss", "value_loss", "recovery_loss", "mean_q", "seconds")
DATA_STREAM = 7


def task_horizon(task: Task) -> int | None:
    """H of the tasks that have an exact answer."""
    return task.horizon if isinstance(task, Brake | DoubleIntegrator) else None


def _resolved(config: PretrainConfig) -> PretrainConfig:
    """The run's configuration with every number filled in."""
    return resolve(config, None if config.task is None else task_horizon(make_task(config.task)))


def open_run(config: PretrainConfig, folder: Path) -> PretrainConfig:
    """Begin a run in a new folder, or find the same one in an old folder.

    Raises:
        ValueError: if the folder holds another run.
    """
    resolved = _resolved(config)
    open_folder(folder, config_to_json(resolved), fingerprint(resolved.data))
    return resolved


def read_run(folder: Path) -> PretrainConfig:
    """The configuration of the run in this folder.

    Raises:
        ValueError: if there is none, or its data file has changed since.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise ValueError(f"{folder}: there is no run here (no config.json)")
    content = read_object(path, "run")
    try:
        config = config_from_json(content["run"])
    except ValueError as error:
        raise ValueError(f"{path}: not a pretraining run ({error})") from error
    if fingerprint(config.data) != content.get("data"):
        raise ValueError(f"{config.data}: the data have changed since the run began")
    return config


def load_data(
    config: PretrainConfig,
) -> tuple[list[Transitions], list[Normalisation], list[Ranges]]:
    """Normalised data, one set a seed from a task or one for all from a file; a
    normalisation a seed, and its ranges.
    """
    raw, normalisations = load_raw(config)
    data, ranges = [], []
    for normalisation in normalisations[: len(raw)]:
        ranges.append(_ranges(config, raw[0]))
        data.append(normalise(raw.pop(0), normalisation))  # not both at once, for all seeds
    return data, normalisations, ranges * (len(config.seeds) // len(ranges))


def _ranges(config: PretrainConfig, raw: Transitions) -> Ranges:
    """A task's actions fill [-1, 1]; a file's bounds are stated, or what it covers."""
    if config.task is not None:
        return ranges_of(raw, Bounds.unit(raw.actions.shape[1]))
    try:
        return ranges_of(raw, config.action_bounds)
    except ValueError as error:
        raise ValueError(f"{config.data}: {error}") from error


def load_raw(config: PretrainConfig) -> tuple[list[Transitions], list[Normalisation]]:
    """The same data as they were recorded, and how they are to be normalised."""
    if config.data is not None:
        raw = _recorded(config)
        return [raw], [normalisation_of(raw, config.sharpness)] * len(config.seeds)
    assert config.task is not None
    task = make_task(config.task)
    pairs = [_collected(task, config, seed) for seed in config.seeds]
    return [data for data, _ in pairs], [normalisation for _, normalisation in pairs]


def _recorded(config: PretrainConfig) -> Transitions:
    """The data of a file, as they were recorded."""
    assert config.data is not None
    return read_hdf5(config.data, cut=config.cut, violation=config.violation)


def _collected(task: Task, config: PretrainConfig, seed: int) -> tuple[Transitions, Normalisation]:
    """A seed's own data; to be normalised unless the task's observations are scaled already."""
    data = config.mix.collect(task, np.random.default_rng((seed, DATA_STREAM)))
    identity = Normalisation.identity(task.observation_dim, task.action_dim)
    if (task.observation_low == -1).all() and (task.observation_high == 1).all():
        return data, identity
    found = replace(
        normalisation_of(data, config.sharpness),
        action_centre=identity.action_centre,  # a task's actions fill [-1, 1]
        action_scale=identity.action_scale,
    )
    return data, found


def pretrain_in_folder(
    config: PretrainConfig, folder: Path, *, quiet: bool = False
) -> PretrainResult:
    """Train, or go on training, in this folder.

    A filter of no use is a result like any other: its ``health`` says so.

    An interrupt (Ctrl-C) is passed on after the update at work and a checkpoint.

    Raises:
        ValueError: for a folder with another run, or another process at work, or data that
            cannot be used.
        FloatingPointError: if a loss is not a number; the last checkpoint stays.
    """
    with only_process(folder):
        return _pretrain(config, folder, quiet)


def _pretrain(config: PretrainConfig, folder: Path, quiet: bool) -> PretrainResult:
    config = _resolved(config)
    check_folder(folder, config_to_json(config), fingerprint(config.data))
    filters = _learned(config, folder, quiet)
    health = tuple(
        check_filter(safety, log, config.horizon)
        for safety, log in zip(filters, _logs(config), strict=True)
    )
    write_health(health, folder)
    (folder / "filters").mkdir(exist_ok=True)
    for safety in filters:
        safety.save(folder / "filters" / f"seed{safety.seed}.safetensors")
    return PretrainResult(filters, health)


def _learned(config: PretrainConfig, folder: Path, quiet: bool) -> tuple[SafetyFilter, ...]:
    """The filters of a run that has been trained to its end."""
    check_device(config.device)
    data, normalisations, ranges = load_data(config)
    learner, batches = begin(config, data)
    del data  # the batches have their own copy
    open_run(config, folder)  # only now: everything fits
    _train(learner, batches, config, folder, quiet)
    return filters_of(learner, config, normalisations, ranges)


def _logs(config: PretrainConfig) -> Iterator[Transitions]:
    """The data of each seed as they were recorded, once more, one after the other."""
    if config.data is not None:
        log = _recorded(config)
        yield from (log for _ in config.seeds)
        return
    assert config.task is not None
    task = make_task(config.task)
    for seed in config.seeds:
        yield _collected(task, config, seed)[0]


def _train(
    learner: Learner, batches: Batches, config: PretrainConfig, folder: Path, quiet: bool
) -> None:
    checkpoint = folder / "checkpoint.safetensors"
    done = load_checkpoint(learner, checkpoint)[0] if checkpoint.exists() else 0
    log = CsvLog(folder / "progress.csv", COLUMNS, done)
    started = time.perf_counter()
    with InterruptAfterUpdate() as interrupt:
        for number, batch, losses in make_updates(learner, batches, config.updates, done, quiet):
            stop = interrupt.asked  # read once: it may be set at any moment
            last = stop or number == config.updates
            if number % config.log_every == 0 or last:
                check_losses(learner, losses, number)
                with torch.no_grad():
                    q = learner.critic.worst(batch.observation, batch.action).mean(dim=1)
                log.write(_log_rows(learner, number, (*losses, q), time.perf_counter() - started))
            if number % config.checkpoint_every == 0 or last:
                check_losses(learner, losses, number)
                save_checkpoint(learner, number, checkpoint)
            if stop:
                raise KeyboardInterrupt


def _log_rows(
    learner: Learner, update: int, numbers: tuple[torch.Tensor, ...], seconds: float
) -> list[tuple[object, ...]]:
    """One row a seed of ``progress.csv``."""
    return [
        (update, seed, *(f"{float(number[k]):.6g}" for number in numbers), f"{seconds:.1f}")
        for k, seed in enumerate(learner.seeds)
    ]
