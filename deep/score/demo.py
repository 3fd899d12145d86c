"""From nothing to a picture: learned boundaries over the exact dead sets, in minutes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dead_ends.io.atomic import atomic_path
from deep.pretraining.config import Mix, PretrainConfig
from deep.pretraining.run import pretrain_in_folder
from deep.score.boundary import (
    BoundaryScore,
    LearnedFilter,
    box_points,
    critic_table,
    score_boundary,
)
from deep.score.exact_answers import exact_answer
from deep.tasks import make_task

__all__ = ["DemoConfig", "demo"]

TASKS = ("brake", "double-integrator")


@dataclass(frozen=True)
class DemoConfig:
    """The demonstration.

    Attributes:
        out: the folder; the picture is ``demo.png`` in it.
        seeds: one boundary each.
        updates: of DEA-RRL (annealed), on each task.
        transitions: collected for each seed.
    """

    out: Path = Path("runs/demo")
    seeds: tuple[int, ...] = (0, 1, 2, 3)
    updates: int = 2000
    transitions: int = 20_000


def demo(config: DemoConfig, *, quiet: bool = False) -> dict[str, tuple[BoundaryScore, ...]]:
    """Collect, train, score and draw; the scores of every seed, by task."""
    from matplotlib.figure import Figure

    from deep.score.figures import boundary_axes

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    scores: dict[str, tuple[BoundaryScore, ...]] = {}
    for axes, name in zip(figure.subplots(1, len(TASKS)), TASKS, strict=True):
        answer = exact_answer(make_task(name))
        run = PretrainConfig(
            task=name,
            seeds=config.seeds,
            updates=config.updates,
            mix=Mix(transitions=config.transitions),
        )
        filters = pretrain_in_folder(run, config.out / name, quiet=quiet).filters
        points = box_points(answer, 5000, 17, 0.05, np.random.default_rng(0))
        scores[name] = tuple(
            score_boundary(critic_table(LearnedFilter(answer.task, f), points), f.threshold, points)
            for f in filters
        )
        boundary_axes(axes, answer, filters, f"{name}: dead-ends (orange), learned (blue)")
    with atomic_path(config.out / "demo.png") as temporary:
        figure.savefig(temporary, dpi=150)
    return scores
