"""Learning curves of our SAC and of Stable-Baselines3's: ``python -m benchmarks.learning_curves``.

The same settings, steps and seeds' numbers on two standard tasks; every so many steps the mean
action is evaluated on a few whole episodes, the same ones for both. The score of a seed is the
mean of its evaluations, the area under its curve. The curves count as equal if the difference of
the mean scores has a 95% bootstrap interval (over seeds, percentile) that contains 0. Beside it
stand two rank tests: Mann-Whitney's, and Wilcoxon's of seeds that were evaluated on the same
episodes, which takes out what the episodes do to both.
Writes ``results/learning_curves.json`` and ``results/learning_curves.png``.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import gymnasium
import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import mannwhitneyu, wilcoxon
from stable_baselines3 import SAC

from benchmarks.measure import RESULTS, save
from benchmarks.sb3 import stable_baselines3_sac
from deep.tasks.gym import Rules
from deep.tasks.vectorised import GYM, evaluation_copies
from deep.train.config import TrainConfig
from deep.train.episodes import run_episodes
from deep.train.result import EPISODES_KEPT_APART
from deep.train.run import train
from deep.train.sac import SacSettings

SETTINGS = SacSettings(final_rate=1, reward_scale=1)
SEEDS = tuple(range(8))
EPISODES = 8
RESAMPLES = 10_000
NO_COSTS = Rules(termination_is_violation=True)
"""These environments report no costs, and end by the clock alone."""
TOOLS = {"ours": ("dead-ends", "#0072b2", "o"), "theirs": ("Stable-Baselines3", "#d55e00", "s")}

Curves = NDArray[np.float64]
"""Mean returns (seeds, evaluations)."""


@dataclass(frozen=True)
class Course:
    """A task, and how long is trained on it.

    Attributes:
        environment: Gymnasium's id.
        temperature: SAC's, fixed, small where rewards are.
        steps: of each seed.
        start_steps: random actions before the first update.
        every: steps between two evaluations.
    """

    environment: str
    temperature: float
    steps: int
    start_steps: int
    every: int

    @property
    def moments(self) -> list[int]:
        """Steps after which is evaluated: all after the random start."""
        every = range(self.every, self.steps + 1, self.every)
        return [step for step in every if step > self.start_steps]


COURSES = (
    Course("Pendulum-v1", temperature=0.2, steps=6_000, start_steps=500, every=500),
    Course("Reacher-v5", temperature=0.02, steps=5_000, start_steps=500, every=250),
)


def our_curves(course: Course, settings: SacSettings, seeds: Sequence[int], folder: Path) -> Curves:
    """One run with all seeds, one environment and one update a step for each."""
    config = TrainConfig(
        task=GYM + course.environment,
        method=settings,
        seeds=tuple(seeds),
        steps=course.steps,
        copies=1,
        start_steps=course.start_steps,
        steps_per_update=1,
        replay=course.steps,
        evaluate_every=course.every,
        evaluation_episodes=EPISODES,
        episodes=1,
        log_every=course.steps,
        checkpoint_every=course.steps,
        rules=NO_COSTS,
    )
    train(config, folder, quiet=True)
    with (folder / "evaluations.csv").open() as file:
        rows = {(int(r["seed"]), int(r["step"])): float(r["acr"]) for r in csv.DictReader(file)}
    return np.array([[rows[seed, step] for step in course.moments] for seed in seeds])


def their_curves(course: Course, settings: SacSettings, seeds: Sequence[int]) -> Curves:
    """One seed after the other."""
    return np.array([_their_curve(course, settings, seed) for seed in seeds])


def _their_curve(course: Course, settings: SacSettings, seed: int) -> list[float]:
    model = stable_baselines3_sac(
        gymnasium.make(course.environment),
        settings,
        seed=seed,
        start_steps=course.start_steps,
        replay=course.steps,
    )
    found, done = [], 0
    for step in course.moments:
        model.learn(step - done, reset_num_timesteps=done == 0)
        found.append(_their_return(course, model, seed))
        done = step
    return found


def _their_return(course: Course, model: SAC, seed: int) -> float:
    """On the episodes that our own seed of this number is evaluated on."""

    def act(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        actions, _ = model.predict(observations, deterministic=True)
        return np.asarray(actions, dtype=np.float32)

    task = GYM + course.environment
    episodes = run_episodes(
        task, act, None, EPISODES, seed + EPISODES_KEPT_APART, evaluation_copies(task), NO_COSTS
    )
    return episodes.acr


def verdict(ours: Curves, theirs: Curves, rng: np.random.Generator) -> dict[str, Any]:
    """Whether the seeds' mean scores differ by more than the seeds explain."""
    first, second = ours.mean(axis=1), theirs.mean(axis=1)
    low, high = np.quantile(_resampled(first, rng) - _resampled(second, rng), (0.025, 0.975))
    return {
        "our_score": float(first.mean()),
        "their_score": float(second.mean()),
        "difference": float(first.mean() - second.mean()),
        "interval": [float(low), float(high)],
        "mann_whitney_p": float(mannwhitneyu(first, second).pvalue),
        "wilcoxon_p": float(wilcoxon(first, second).pvalue),
        "equal": bool(low <= 0 <= high),
    }


def _resampled(scores: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Means of as many seeds, drawn with replacement."""
    return np.asarray(rng.choice(scores, (RESAMPLES, len(scores))).mean(axis=1))


def compare(course: Course, folder: Path) -> dict[str, Any]:
    """One row: both tools' curves, what they cost, and the verdict."""
    settings = replace(SETTINGS, temperature=course.temperature)
    begin = process_time()
    ours = our_curves(course, settings, SEEDS, folder)
    between = process_time()
    theirs = their_curves(course, settings, SEEDS)
    seconds = (between - begin, process_time() - between)
    return {
        **asdict(course),
        "moments": course.moments,
        "ours": np.round(ours, 2).tolist(),
        "theirs": np.round(theirs, 2).tolist(),
        "our_seconds": round(seconds[0], 1),
        "their_seconds": round(seconds[1], 1),
        **verdict(ours, theirs, np.random.default_rng(0)),
    }


def figure(rows: list[dict[str, Any]]) -> Figure:
    """One panel a task: every seed thin, their mean thick."""
    drawn = Figure(figsize=(4.2 * len(rows), 3.4), layout="constrained")
    for axes, row in zip(np.atleast_1d(drawn.subplots(1, len(rows))), rows, strict=True):
        for tool, (label, colour, marker) in TOOLS.items():
            curves = np.array(row[tool])
            axes.plot(row["moments"], curves.T, color=colour, alpha=0.25, linewidth=0.8)
            axes.plot(row["moments"], curves.mean(axis=0), color=colour, marker=marker, label=label)
        axes.set(title=row["environment"], xlabel="environment steps", ylabel="return")
        axes.grid(alpha=0.3)
    drawn.axes[0].legend()
    return drawn


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown: one line a task."""
    lines = [
        "| task | steps | score: ours | Stable-Baselines3 | difference, 95% interval "
        "| Mann-Whitney p | Wilcoxon p | last return: ours | Stable-Baselines3 "
        "| core-seconds: ours | Stable-Baselines3 |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        low, high = row["interval"]
        last = [np.array(row[tool])[:, -1].mean() for tool in TOOLS]
        lines.append(
            f"| {row['environment']} | {row['steps']:,} | {row['our_score']:.3g} "
            f"| {row['their_score']:.3g} | {row['difference']:+.3g} ({low:+.3g} to {high:+.3g}) "
            f"| {row['mann_whitney_p']:.2f} | {row['wilcoxon_p']:.2f} "
            f"| {last[0]:.3g} | {last[1]:.3g} "
            f"| {row['our_seconds']:.0f} | {row['their_seconds']:.0f} |"
        )
    return lines


def main() -> None:
    """Train with both on all tasks, and write results and figure."""
    started = perf_counter()
    torch.set_num_threads(1)
    rows = []
    for course in COURSES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(compare(course, Path(folder)))
        print(table(rows)[-1], flush=True)
    common = {name: x for name, x in asdict(SETTINGS).items() if name != "temperature"}
    config = {**common, "seeds": SEEDS, "episodes": EPISODES, "resamples": RESAMPLES}
    print(save("learning_curves", config, rows, perf_counter() - started))
    figure(rows).savefig(RESULTS / "learning_curves.png", dpi=150)


if __name__ == "__main__":
    main()
