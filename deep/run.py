"""One run of Algorithm 1 in a folder: from data to safety filters, resumable at any moment.

The folder holds ``config.json`` (resolved, with versions), ``progress.csv``,
``checkpoint.safetensors`` and, at the end, ``filters/seed<k>.safetensors``. Every update
is a function of the state before it and of its number, so a run that is killed and taken
up again from its last checkpoint ends as if nothing had happened.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import platform
import signal
import subprocess
import threading
import time
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from dead_ends.io.atomic import atomic_path
from deep.batches import Batches
from deep.checkpoint import load_checkpoint, save_checkpoint
from deep.config import PretrainConfig, config_from_json, config_to_json, resolve
from deep.data import Transitions
from deep.formats import read_hdf5
from deep.pretrain import Learner, Sizes, build_learner
from deep.pretrain.extract import extract_filter
from deep.pretrain.health import CriticHealth, check_critics, check_losses
from deep.safety_filter import Normalisation, SafetyFilter
from deep.tasks import Brake, DoubleIntegrator, Task, make_task

__all__ = ["PretrainResult", "normalisation_of", "open_run", "pretrain", "task_horizon"]

COLUMNS = ("update", "seed", "critic_loss", "value_loss", "recovery_loss", "mean_q", "seconds")
DATA_STREAM = 7
HEALTH_BATCH = 1 << 40
"""The number of a batch that no training reaches: fresh rows for the last check."""


@dataclass(frozen=True)
class PretrainResult:
    """What a run gives.

    Attributes:
        filters: one a seed, in the order of the seeds.
        health: of each seed's critic on a fresh batch.
    """

    filters: tuple[SafetyFilter, ...]
    health: tuple[CriticHealth, ...]


def task_horizon(task: Task) -> int | None:
    """H of the tasks that have an exact answer."""
    return task.horizon if isinstance(task, Brake | DoubleIntegrator) else None


def open_run(config: PretrainConfig, folder: Path) -> PretrainConfig:
    """Begin a run in a new folder, or find the same one in an old folder.

    Raises:
        ValueError: if the folder holds another run.
    """
    task = None if config.task is None else make_task(config.task)
    resolved = resolve(config, None if task is None else task_horizon(task))
    plain = config_to_json(resolved)
    path = folder / "config.json"
    if path.exists():
        if read_run(folder) != config_from_json(plain):
            raise ValueError(f"{folder} holds a run with another configuration")
        return resolved
    fingerprint = _fingerprint(resolved.data)
    folder.mkdir(parents=True, exist_ok=True)
    content = {"run": plain, "made with": _versions(), "data": fingerprint}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")
    return resolved


def read_run(folder: Path) -> PretrainConfig:
    """The configuration of the run in this folder.

    Raises:
        ValueError: if there is none, or its data file has changed since.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise ValueError(f"{folder}: there is no run here (no config.json)")
    content = json.loads(path.read_text())
    config = config_from_json(content["run"])
    if _fingerprint(config.data) != content["data"]:
        raise ValueError(f"{config.data}: the data have changed since the run began")
    return config


def _versions() -> dict[str, str]:
    names = ("numpy", "torch", "gymnasium", "safetensors")
    found = {name: metadata.version(name) for name in names}
    return found | {"python": platform.python_version(), "git": _git_revision()}


def _git_revision() -> str:
    """The revision of the source tree, with a + if it has changes; "" outside one."""
    root = Path(__file__).parent
    run = subprocess.run(
        ["git", "describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    return run.stdout.strip()


def _fingerprint(path: Path | None) -> str | None:
    if path is None:
        return None
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def normalisation_of(data: Transitions) -> Normalisation:
    """From the data's ranges: observations and actions fill [-1, 1]."""
    parts = []
    for array in (np.concatenate([data.observations, data.next_observations]), data.actions):
        low, high = array.min(axis=0).astype(float), array.max(axis=0).astype(float)
        half = (high - low) / 2
        parts += [(low + high) / 2, np.where(half > 0, half, 1.0)]
    return Normalisation(*(tuple(part.tolist()) for part in parts))


def _normalised(data: Transitions, n: Normalisation) -> Transitions:
    def observation(x: Any) -> Any:
        return (x - np.array(n.observation_centre)) / np.array(n.observation_scale)

    return replace(
        data,
        observations=observation(data.observations),
        next_observations=observation(data.next_observations),
        actions=(data.actions - np.array(n.action_centre)) / np.array(n.action_scale),
    )


def _load(config: PretrainConfig) -> tuple[list[Transitions], Normalisation]:
    """One data set a seed from a task, or one for all from a file."""
    if config.task is not None:
        task = make_task(config.task)
        streams = (np.random.default_rng((seed, DATA_STREAM)) for seed in config.seeds)
        data = [config.mix.collect(task, rng) for rng in streams]
        return data, Normalisation.identity(task.observation_dim, task.action_dim)
    assert config.data is not None
    raw = read_hdf5(config.data)
    normalisation = normalisation_of(raw)
    return [_normalised(raw, normalisation)], normalisation


def pretrain(config: PretrainConfig, folder: Path, *, quiet: bool = False) -> PretrainResult:
    """Train, or go on training, in this folder.

    An interrupt (Ctrl-C) is passed on after the update at work and a checkpoint.

    Raises:
        ValueError: for a folder with another run, or data that cannot be used.
        FloatingPointError: if a loss is not a number; the last checkpoint stays.
    """
    config = open_run(config, folder)
    assert config.threshold is not None
    assert config.gamma_safe is not None
    if config.device == "cuda" and not torch.cuda.is_available():
        raise ValueError("device cuda: this machine or this build of torch has no CUDA device")
    data, normalisation = _load(config)
    device = torch.device(config.device)
    sizes = Sizes(data[0].observations.shape[1], data[0].actions.shape[1])
    learner = build_learner(config.method, sizes, config.seeds).to(device)
    settings = config.method
    batches = Batches(data, config.seeds, settings.batch_size, settings.violation_share, device)
    _train(learner, batches, config, folder, quiet)
    filters = tuple(
        extract_filter(learner, seed, config.threshold, config.gamma_safe, normalisation)
        for seed in config.seeds
    )
    (folder / "filters").mkdir(exist_ok=True)
    for safety in filters:
        safety.save(folder / "filters" / f"seed{safety.seed}.safetensors")
    return PretrainResult(filters, check_critics(learner, batches.get(HEALTH_BATCH)))


def _train(
    learner: Learner, batches: Batches, config: PretrainConfig, folder: Path, quiet: bool
) -> None:
    checkpoint = folder / "checkpoint.safetensors"
    done = load_checkpoint(learner, checkpoint) if checkpoint.exists() else 0
    log = _ProgressLog(folder / "progress.csv", learner.seeds, done)
    begin = time.perf_counter()
    bar = tqdm(total=config.updates, initial=done, desc=learner.name, unit="", disable=quiet)
    with bar, _InterruptAfterUpdate() as interrupt:
        while done < config.updates:
            batch = batches.get(done)
            losses = learner.update(batch, done / config.updates)
            done += 1
            bar.update()
            stop = interrupt.asked  # read once: it may be set at any moment
            last = stop or done == config.updates
            if done % config.log_every == 0 or last:
                check_losses(learner, losses, done)
                with torch.no_grad():
                    q = learner.critic.worst(batch.observation, batch.action).mean(dim=1)
                log.write(done, (*losses, q), time.perf_counter() - begin)
            if done % config.checkpoint_every == 0 or last:
                check_losses(learner, losses, done)
                save_checkpoint(learner, done, checkpoint)
            if stop:
                raise KeyboardInterrupt


class _InterruptAfterUpdate:
    """Holds Ctrl-C back until the update at work is whole; outside the main thread: nothing."""

    def __init__(self) -> None:
        self.asked = False
        self._before: Any = None

    def __enter__(self) -> _InterruptAfterUpdate:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._ask)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _ask(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002  (a handler's signature)
        self.asked = True


class _ProgressLog:
    """``progress.csv``: one row a seed and logged update."""

    def __init__(self, path: Path, seeds: tuple[int, ...], done: int) -> None:
        self._path = path
        self._seeds = seeds
        rows = [row for row in _rows(path) if int(row[0]) <= done]
        with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *rows])

    def write(self, update: int, numbers: tuple[torch.Tensor, ...], seconds: float) -> None:
        """Append the seeds' numbers and hand them to the operating system."""
        with self._path.open("a", newline="") as file:
            writer = csv.writer(file)
            for k, seed in enumerate(self._seeds):
                values = (f"{float(number[k]):.6g}" for number in numbers)
                writer.writerow((update, seed, *values, f"{seconds:.1f}"))
            file.flush()
            os.fsync(file.fileno())


def _rows(path: Path) -> list[list[str]]:
    """The rows that were written wholly, without the header."""
    if not path.exists():
        return []
    lines = path.read_text().splitlines(keepends=True)[1:]
    whole = [line for line in lines if line.endswith("\n") and line.count(",") == len(COLUMNS) - 1]
    return list(csv.reader(whole))
