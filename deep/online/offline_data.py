"""The paper's offline data: a SAC run's replay buffer, and uniform random actions.

Of both only the last steps before violations are kept (the paper: 100), because what lies
further back says nothing about safety. Random actions are in the mixture since the
violations of a trained policy resemble each other.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from deep.collect import collect, random_policy
from deep.data import Transitions, concatenate, keep_before_violation
from deep.online.config import train_config_from_json
from deep.online.fleet import Fleet
from deep.online.replay import Replay
from deep.tasks import make_task

__all__ = ["offline_data", "replayed"]


def replayed(folder: Path, seed: int) -> Transitions:
    """All transitions in the replay buffer of a finished run, raw, copy by copy.

    Raises:
        ValueError: if the run is not finished, or has not kept its buffer.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise ValueError(f"{folder}: there is no run here (no config.json)")
    config = train_config_from_json(json.loads(path.read_text())["run"])
    if not (folder / "result.json").is_file() or not (folder / "replay.bin").is_file():
        raise ValueError(f"{folder}: not a finished run that kept its replay buffer")
    if seed not in config.seeds:
        raise ValueError(f"{folder}: there is no seed {seed}, only {list(config.seeds)}")
    fleet = Fleet(config.task, (seed,), 1)
    sizes = (fleet.observation_dim, fleet.action_dim)
    fleet.close()
    replay = Replay(
        folder / "replay.bin",
        config.seeds,
        config.copies,
        config.replay // config.copies,
        config.checkpoint_every // config.copies,
        *sizes,
    )
    return replay.transitions(seed, config.steps // config.copies)


def offline_data(
    task: str, runs: Path, seed: int, random: int, keep: int | None, rng: np.random.Generator
) -> Transitions:
    """The replay of ``seed`` in the run folder ``runs``, and ``random`` random transitions.

    Args:
        task: the task of the run.
        keep: only so many steps before each violation, of both; None: everything.
    """
    parts = [keep_before_violation(replayed(runs, seed), keep)]
    if random:
        known = make_task(task)
        fresh = collect(known, random_policy(known), rng, random)
        parts.append(keep_before_violation(fresh, keep))
    return concatenate(parts)
