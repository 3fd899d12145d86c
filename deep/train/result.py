"""What every run of a task policy leaves: its configuration, evaluations, policies, result.

``result.json`` is written last: its presence says that the run is finished.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from deep.data.normalisation import Normalisation
from deep.filter.safety_filter import SafetyFilter
from deep.filter.task_policy import TrainedPolicy
from deep.runs.folder import read_object, versions, write_json
from deep.runs.record import Record
from deep.runs.seed_result import Budget, SeedResult, read_seeds
from deep.tasks.gym import NO_RULES, Rules, rules_from_json
from deep.tasks.vectorised import GYM, evaluation_copies
from deep.train.episodes import Episodes, run_episodes
from deep.train.learner import TaskLearner, TaskLosses

__all__ = [
    "EPISODES_KEPT_APART",
    "EVALUATIONS",
    "Budget",
    "SeedResult",
    "TrainResult",
    "checked_losses",
    "evaluate",
    "evaluation_rows",
    "read_result",
    "read_seeds",
    "run_rules",
    "save_all",
    "task_policies",
    "write_result",
]

EVALUATIONS = ("step", "seed", "episodes", "acr", "avr", "arr", "length")
EPISODES_KEPT_APART = 1000
"""Evaluations during training draw other episodes than the one at the end."""


@dataclass(frozen=True)
class TrainResult:
    """What a finished run says.

    Attributes:
        folder: where it is.
        method: as in the tables: sac, wcsac, iql, or the form of the correction.
        seeds: one a seed.
    """

    folder: Path
    method: str
    seeds: tuple[SeedResult, ...]


def run_rules(folder: Path) -> Rules:
    """What the run in this folder took its environment's rules to be.

    Raises:
        ValueError: if there is no run of a task policy.
    """
    path = folder / "config.json"
    run = read_object(path, "run")["run"]
    try:
        rules, task = rules_from_json(run), str(run["task"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"{path}: not the run of a task policy ({error})") from error
    return rules if task.startswith(GYM) else NO_RULES


def checked_losses(seed: int, k: int, losses: TaskLosses | None, moment: str) -> list[str]:
    """A seed's losses as they are written down; empty cells where there are none.

    Raises:
        FloatingPointError: if one is not a number.
    """
    if losses is None:
        return [""] * len(TaskLosses._fields)
    numbers = [float(loss[k]) for loss in losses]
    if not all(map(math.isfinite, numbers)):
        raise FloatingPointError(
            f"{moment}: a loss of seed {seed} is not a number; try a smaller learning rate"
        )
    return [f"{x:.6g}" for x in numbers]


def task_policies(
    learner: TaskLearner, normalisation: Sequence[Normalisation], method: str
) -> tuple[TrainedPolicy, ...]:
    """Copies of every seed's task policy of the moment."""
    mlp = learner.policy.mlp
    return tuple(
        TrainedPolicy(
            tuple(
                (w[k].detach().numpy().copy(), b[k, 0].detach().numpy().copy())
                for w, b in zip(mlp.weights, mlp.biases, strict=True)
            ),
            own,
            method,
            seed,
        )
        for k, (seed, own) in enumerate(zip(learner.seeds, normalisation, strict=True))
    )


def evaluate(
    task: str,
    policies: Sequence[TrainedPolicy],
    filters: Sequence[SafetyFilter | None],
    episodes: int,
    stream: int = 0,
    rules: Rules = NO_RULES,
) -> list[Episodes]:
    """Whole episodes of every policy's mean action, each behind its filter if there is one.

    ``stream`` draws other episodes; ``filters`` may be empty.
    """
    copies = evaluation_copies(task)
    return [
        run_episodes(task, policy.act, safety, episodes, policy.seed + stream, copies, rules)
        for policy, safety in zip(policies, filters or [None] * len(policies), strict=True)
    ]


def evaluation_rows(
    done: int, seeds: Sequence[int], episodes: Sequence[Episodes]
) -> Iterator[tuple[object, ...]]:
    """Rows of ``evaluations.csv``, one a seed."""
    for seed, e in zip(seeds, episodes, strict=True):
        numbers = (e.acr, e.avr, e.arr, e.length)
        yield done, seed, len(e.returns), *(f"{x:.6g}" for x in numbers)


def save_all(
    folder: Path, seeds: Sequence[int], made: Sequence[TrainedPolicy | SafetyFilter]
) -> None:
    """One file a seed; no folder where there is nothing."""
    if not made:
        return
    folder.mkdir(exist_ok=True)
    for seed, one in zip(seeds, made, strict=True):
        one.save(folder / f"seed{seed}.safetensors")


def write_result(
    folder: Path,
    task: str,
    method: str,
    budget: Budget,
    seeds: Sequence[SeedResult],
    **origin: str | None,
) -> None:
    """``result.json``: task, method, budget and seeds, and with what they were made."""
    content: dict[str, Any] = {"task": task, "method": method, "budget": asdict(budget), **origin}
    content |= {"seeds": [asdict(seed) for seed in seeds], "made with": versions()}
    write_json(folder / "result.json", content)


def read_result(folder: Path) -> TrainResult:
    """What a finished run says.

    Raises:
        ValueError: naming what is missing or wrong.
    """
    record = Record.read(folder / "result.json")
    return TrainResult(folder, record.text("method"), read_seeds(record))
