"""The paper's offline data: a SAC run's replay buffer, and uniform random actions.

And data of random actions alone, from "real:" and "gym:" environments.

Of both only the last steps before violations are kept (the paper: 100), because what lies
further back says nothing about safety. Random actions are in the mixture since the
violations of a trained policy resemble each other.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep.data.collect import check_shares, collect, kept, random_policy
from deep.data.transitions import Transitions, concatenate, keep_before_violation
from deep.filter.task_policy import TrainedPolicy, check_units
from deep.pretraining.config import Mix
from deep.runs.folder import read_object
from deep.tasks import make_task
from deep.tasks.gym import Rules
from deep.tasks.vectorised import Fleet, evaluation_copies, task_spaces
from deep.train.config import TrainConfig, train_config_from_json
from deep.train.replay import Replay

__all__ = ["collect_in_environments", "offline_data", "replayed", "training_run"]

SEEDS = 2**31


def training_run(folder: Path) -> TrainConfig:
    """The configuration of the online run in this folder.

    Raises:
        ValueError: if there is none.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise ValueError(f"{folder}: there is no run here (no config.json)")
    content = read_object(path, "run")
    try:
        return train_config_from_json(content["run"])
    except ValueError as error:
        raise ValueError(f"{path}: not a training run ({error})") from error


def replayed(folder: Path, seed: int) -> Transitions:
    """All transitions in the replay buffer of a finished run, raw, copy by copy.

    Raises:
        ValueError: if the run is not finished, or has not kept its buffer, or not all of it,
            or if the seed has no violation.
    """
    config = training_run(folder)
    if not (folder / "result.json").is_file() or not (folder / "replay.bin").is_file():
        raise ValueError(f"{folder}: not a finished run that kept its replay buffer")
    if seed not in config.seeds:
        raise ValueError(f"{folder}: there is no seed {seed}, only {list(config.seeds)}")
    sizes, bounds = task_spaces(config.task, config.rules)
    policy = TrainedPolicy.load(folder / "policies" / f"seed{seed}.safetensors")
    check_units(f"{folder}: it recorded", policy.normalisation, config.task, bounds)
    replay = Replay(
        folder / "replay.bin",
        config.seeds,
        config.copies,
        config.replay // config.copies,
        config.checkpoint_every // config.copies,
        *sizes,
    )
    try:
        return replay.transitions(seed, config.steps // config.copies)
    except ValueError as error:
        raise ValueError(f"{folder}: seed {seed}: {error}") from error


def offline_data(
    task: str, runs: Path, seed: int, random: int, keep: int | None, rng: np.random.Generator
) -> Transitions:
    """The replay of ``seed`` in the run folder ``runs``, and ``random`` random transitions.

    Args:
        task: the task of the run.
        keep: only so many steps before each violation, of both; None: everything.

    Raises:
        ValueError: as for :func:`replayed`, if ``random`` is negative, or if random actions
            lead to no violation.
    """
    if random < 0:
        raise ValueError(f"random must not be negative, not {random}")
    parts = [keep_before_violation(replayed(runs, seed), keep)]
    if random:
        try:
            drawn = _random_transitions(task, random, training_run(runs).rules, rng)
        except ValueError as error:
            raise ValueError(f"{task}, {random} random actions: {error}") from error
        parts.append(keep_before_violation(drawn, keep))
    return concatenate(parts)


def _random_transitions(
    task: str, transitions: int, rules: Rules, rng: np.random.Generator
) -> Transitions:
    """At least so many, with uniform random actions."""
    copies = evaluation_copies(task)
    if copies is not None:
        return Transitions(**_in_environments(task, transitions, copies, rules, rng))
    known = make_task(task)
    return collect(known, random_policy(known), rng, transitions)


def collect_in_environments(
    task: str, mix: Mix, rules: Rules, rng: np.random.Generator
) -> Transitions:
    """As :meth:`deep.pretraining.config.Mix.collect`, for a "real:" or "gym:" environment.

    Raises:
        ValueError: if the mixture wants what only tasks know, its shares do not sum to 1, or too
            few transitions lie before violations.
    """
    if mix.adversary or mix.anywhere or mix.max_steps is not None:
        raise ValueError(
            f"{task}: adversary, anywhere and max_steps are for this project's own tasks, of which "
            "it knows obstacles and states"
        )
    copies = evaluation_copies(task)
    assert copies is not None
    shares = ((False, mix.random), (True, mix.corners))
    actors = [(corners, share) for corners, share in shares if share != 0]
    counts = check_shares([share for _, share in actors], mix.transitions)
    parts = []
    for (corners, _), count in zip(actors, counts, strict=True):
        draw = partial(_in_environments, task, copies=copies, rules=rules, rng=rng, corners=corners)
        if count:
            parts.append(kept(task, draw, mix.keep, count))
    return concatenate(parts)


def _in_environments(
    task: str,
    transitions: int,
    copies: int,
    rules: Rules,
    rng: np.random.Generator,
    corners: bool = False,
) -> dict[str, NDArray[Any]]:
    """Columns of random actions, uniform or at the ends of their range, in such environments."""
    fleet = Fleet(task, (int(rng.integers(SEEDS)),), copies, rules)
    low, high = np.array(fleet.action_bounds.low), np.array(fleet.action_bounds.high)
    steps = []
    try:
        observation = fleet.reset()
        for _ in range(-(-transitions // copies)):
            drawn = rng.uniform(low, high, (1, copies, fleet.action_dim))
            ends = np.where(drawn < (low + high) / 2, low, high)
            action = (ends if corners else drawn).astype(np.float32)
            following, last, *outcome = fleet.step(action)
            steps.append((observation, action, last, *outcome))
            observation = following
    finally:
        fleet.close()
    # Copy by copy, each one's last episode cut off where the recording ends.
    columns = [np.stack(column, axis=2)[0] for column in zip(*steps, strict=True)]
    terminal, timeout = columns[-2:]
    timeout[:, -1] |= ~terminal[:, -1]
    names = [field.name for field in fields(Transitions)]
    flat = [column.reshape(-1, *column.shape[2:]) for column in columns]
    return dict(zip(names, flat, strict=True))
