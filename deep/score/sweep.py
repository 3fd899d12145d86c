"""What gamma_safe, epsilon, the last expectile and the data mix do to DEA-RRL (annealed).

One of them is varied at a time, the rest stays at the recipe. For each value both errors
are scored against the exact labels; epsilon needs no training of its own.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dead_ends.io.atomic import atomic_path
from deep.filter.thresholds import LOW_SHARE, discount_from_horizon
from deep.pretraining import DeaRrlAnnealedSettings
from deep.pretraining.config import Mix, PretrainConfig
from deep.pretraining.run import pretrain_in_folder
from deep.score.boundary import LearnedFilter, box_points, critic_table, score_boundary
from deep.score.exact_answers import ExactAnswer, exact_answer
from deep.score.figures import SweepScore, sweep_figure
from deep.tasks import make_task

__all__ = ["SweepConfig", "sweep"]

GAMMAS = (0.5, 0.95, 0.99)
EXPECTILES = (0.3, 0.1, 0.03, 0.003)
CORNERS = (0.0, 1.0)
EPSILON_SHARES = (0.03, 0.06, 0.125, 0.25, 0.5, 0.75, 1.0)
POINT_STREAM = 101


@dataclass(frozen=True)
class SweepConfig:
    """One sweep.

    Attributes:
        task: brake or double-integrator.
        out: the run folder.
        seeds: of every training run.
        updates: of every training run.
        points: on which boundaries are scored.
        actions: of the grid in each action coordinate.
    """

    task: str
    out: Path
    seeds: tuple[int, ...] = (0, 1, 2, 3)
    updates: int = 2000
    points: int = 5000
    actions: int = 17


def sweep(config: SweepConfig, *, quiet: bool = False) -> tuple[SweepScore, ...]:
    """Train and score every value; write ``sweep.csv`` and ``sweep.png``.

    Raises:
        ValueError: if the task has no exact answer.
    """
    answer = exact_answer(make_task(config.task))
    points = box_points(
        answer, config.points, config.actions, 0.05, np.random.default_rng(POINT_STREAM)
    )
    scores: list[SweepScore] = []
    for parameter, value, run in _runs(config, answer):
        folder = config.out / f"{parameter}-{value:g}".replace(" ", "-")
        filters = pretrain_in_folder(run, folder, quiet=quiet).filters
        for safety in filters:
            table = critic_table(LearnedFilter(answer.task, safety), points)
            top = safety.gamma_safe**answer.horizon
            recipe = run.gamma_safe == discount_from_horizon(answer.horizon)
            for name, x, epsilon in [
                (parameter, value, safety.threshold),
                *(_recipe_places(top) if recipe else []),
            ]:
                score = score_boundary(table, epsilon, points)
                scores.append(
                    SweepScore(name, x, safety.seed, score.dead_called_safe, score.safe_called_dead)
                )
    _write(scores, config.out / "sweep.csv")
    with atomic_path(config.out / "sweep.png") as temporary:
        sweep_figure(config.task, scores).savefig(temporary, dpi=150)
    return tuple(scores)


def _recipe_places(top: float) -> list[tuple[str, float, float]]:
    """Where the recipe itself stands on the other axes, and its sweep over epsilon."""
    own = LOW_SHARE * top
    return [
        ("last expectile", DeaRrlAnnealedSettings().final_expectile, own),
        ("share of corner actions", Mix().corners, own),
        *(("epsilon / gamma_safe^H", share, share * top) for share in EPSILON_SHARES),
    ]


def _runs(config: SweepConfig, answer: ExactAnswer) -> list[tuple[str, float, PretrainConfig]]:
    def run(
        gamma: float | None = None,
        settings: DeaRrlAnnealedSettings | None = None,
        mix: Mix | None = None,
    ) -> PretrainConfig:
        return PretrainConfig(
            task=config.task,
            method=settings or DeaRrlAnnealedSettings(),
            seeds=config.seeds,
            updates=config.updates,
            mix=mix or Mix(),
            gamma_safe=gamma,
        )

    recipe = discount_from_horizon(answer.horizon)
    return [
        *(("gamma_safe", g, run(gamma=g)) for g in sorted({recipe, *GAMMAS})),
        *(
            ("last expectile", e, run(settings=DeaRrlAnnealedSettings(final_expectile=e)))
            for e in EXPECTILES
        ),
        *(("share of corner actions", c, run(mix=Mix(random=1 - c, corners=c))) for c in CORNERS),
    ]


def _write(scores: Sequence[SweepScore], path: Path) -> None:
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["parameter", "value", "seed", "dead_called_safe", "safe_called_dead"])
        for s in scores:
            writer.writerow([s.parameter, s.value, s.seed, s.dead_called_safe, s.safe_called_dead])
