"""Online runs of a second or less, and pretraining runs made by hand, for tests."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from deep.data.transitions import Transitions
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import Settings
from deep.pretraining.config import Mix, PretrainConfig
from deep.pretraining.run import open_run, pretrain_in_folder
from deep.train.config import TrainConfig
from deep.train.sac import SacSettings
from tests.deep.filters import linear_filter

SEEDS = (0, 3)
TINY = TrainConfig(
    task="brake",
    method=SacSettings(hidden=(8,), batch_size=16),
    seeds=SEEDS,
    steps=240,
    copies=4,
    start_steps=80,
    steps_per_update=8,
    replay=240,
    evaluate_every=120,
    evaluation_episodes=3,
    episodes=5,
    log_every=40,
    checkpoint_every=60,
    keep_replay=True,
)
WRAPPED = replace(TINY, replay=80)
"""Remembers less than it sees."""


def braking_filter(threshold: float = 0.5) -> SafetyFilter:
    """Brakes where a car is near and fast, and the more so the harder it accelerates."""
    return linear_filter([-4.0, 4.0], 2.0, -1.0, -5.0, threshold=threshold)


def blocking_filter(bias: float, threshold: float) -> SafetyFilter:
    """Q = sigmoid(bias) everywhere; recovers by tanh(0.3)."""
    return linear_filter([0.0, 0.0], 0.0, bias, 0.3, threshold=threshold)


def hand_made(folder: Path, filters: Mapping[int, SafetyFilter]) -> Path:
    """The folder of a pretraining run (dea-rrl-annealed on brake) with a filter for each seed."""
    open_run(PretrainConfig(task="brake", seeds=tuple(filters)), folder)
    (folder / "filters").mkdir()
    for seed, safety in filters.items():
        safety.save(folder / "filters" / f"seed{seed}.safetensors")
    return folder


def pretrained(folder: Path, method: Settings) -> Path:
    """The folder of a short pretraining run on brake."""
    config = PretrainConfig(
        task="brake", method=method, seeds=SEEDS, updates=20, mix=Mix(transitions=300)
    )
    pretrain_in_folder(config, folder, quiet=True)
    return folder


def table(path: Path) -> list[dict[str, str]]:
    """The rows of a log, without the time that they took."""
    with path.open() as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def raw_replay(folder: Path, config: TrainConfig) -> dict[str, np.ndarray]:
    """The file's columns by name, each (K, steps, copies, ...), for brake."""
    size = (config.replay + config.checkpoint_every) // config.copies
    rows = np.fromfile(folder / "replay.bin", dtype=np.float32)
    rows = rows.reshape(len(config.seeds), size, config.copies, 10)
    columns = {"observation": rows[..., :2], "next_observation": rows[..., 4:6]}
    places = {"action": 2, "executed": 3, "reward": 6, "cost": 7, "terminal": 8, "timeout": 9}
    return columns | {name: rows[..., place] for name, place in places.items()}


def same(first: Transitions, second: Transitions) -> bool:
    """Whether two data sets agree in every bit."""
    names = [field.name for field in fields(Transitions)]
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)
