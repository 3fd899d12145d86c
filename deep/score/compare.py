"""The four forms of Algorithm 1 and this project's own, scored against the exact answer.

A run folder holds one training run a method (taken up again if it was interrupted),
``scores.csv`` (one row a threshold, method and seed), ``summary.md`` and ``boundary.png``.
Points, box and distances are fixed by the configuration before anything is trained; exact
labels enter nothing but the scores.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from deep.data.collect import Policy, random_policy, sb3_policy, towards_obstacle_policy
from deep.filter.safety_filter import SafetyFilter
from deep.filter.thresholds import paper_threshold
from deep.pretraining import FORMS
from deep.pretraining.config import Mix, PretrainConfig
from deep.pretraining.run import pretrain_in_folder
from deep.runs.bootstrap import percentile_interval
from deep.runs.folder import open_folder
from deep.score.boundary import (
    BoundaryScore,
    ClosedLoop,
    LearnedFilter,
    OracleFilter,
    Points,
    ScoredFilter,
    box_points,
    closed_loop,
    critic_table,
    safe_starts,
    score_boundary,
)
from deep.score.exact_answers import ExactAnswer, ExactTask, exact_answer
from deep.tasks import Task, TaskEnv, make_task

__all__ = ["CompareConfig", "Interval", "SeedScore", "compare", "interval", "summary_table"]

CODE_THRESHOLD = 0.3
"""The only default in the authors' code."""

POLICIES = ("random", "adversarial", "trained")
POINT_STREAM, EPISODE_STREAM, BOOTSTRAP_STREAM = 101, 102, 103


@dataclass(frozen=True)
class CompareConfig:
    """One comparison.

    Attributes:
        task: brake, double-integrator, double-integrator-fine, point, dubins, navigation1 or
            navigation2.
        out: the run folder.
        methods: the forms of Algorithm 1 to train; the oracle always comes along.
        seeds: as many critics and recovery policies a method.
        updates: of every method.
        transitions: collected for every seed.
        anywhere: collect from all over the task's region, not from its own starts.
        points: on which boundaries are scored, uniform over the task's box.
        actions: of the grid in each action coordinate.
        near: the distance that counts as near the boundary, a share of the box's first side.
        episodes: of the closed loop, for every seed and task policy.
        task_policy_steps: environment steps on which the trained task policy is trained.
        device: cpu or cuda.
    """

    task: str
    out: Path
    methods: tuple[str, ...] = tuple(FORMS)
    seeds: tuple[int, ...] = tuple(range(8))
    updates: int = 4000
    transitions: int = 40_000
    anywhere: bool = False
    points: int = 20_000
    actions: int = 33
    near: float = 0.05
    episodes: int = 1250
    task_policy_steps: int = 30_000
    device: str = "cpu"

    def __post_init__(self) -> None:
        unknown = set(self.methods) - set(FORMS)
        if unknown or not self.methods:
            raise ValueError(f"methods must be some of {', '.join(FORMS)}")


@dataclass(frozen=True)
class SeedScore:
    """One filter's scores.

    Attributes:
        method: the form of Algorithm 1, or "oracle".
        rule: how the threshold was chosen.
        threshold: epsilon.
        seed: the seed.
        boundary: against the exact labels.
        loops: the closed loop under each of ``POLICIES``.
    """

    method: str
    rule: str
    threshold: float
    seed: int
    boundary: BoundaryScore
    loops: tuple[ClosedLoop, ...]

    @property
    def worst_failures(self) -> int:
        """Failed episodes under the worst task policy."""
        return max(loop.failures for loop in self.loops)


@dataclass(frozen=True)
class Interval:
    """A mean over seeds with its 95% bootstrap interval."""

    mean: float
    low: float
    high: float


def interval(values: Sequence[float]) -> Interval:
    """The mean, and the percentiles of the means of resampled seeds; one seed is its own."""
    array = np.asarray(values, dtype=np.float64)
    mean = float(array.mean())
    if len(array) < 2:
        return Interval(mean, mean, mean)
    low, high = percentile_interval([array], np.mean, BOOTSTRAP_STREAM)
    return Interval(mean, float(low), float(high))


def trained_policy(task: Task, steps: int) -> Policy:
    """A task policy trained with PPO on the bare task, without any correction."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    copies = DummyVecEnv([lambda: TaskEnv(task)] * 8)
    model = PPO("MlpPolicy", copies, n_steps=256, batch_size=256, seed=0, device="cpu")
    return sb3_policy(model.learn(steps), deterministic=True)


def compare(config: CompareConfig, *, quiet: bool = False) -> tuple[SeedScore, ...]:
    """Train every method, score every seed, write the table and the picture.

    Raises:
        ValueError: if the task has no exact answer, or the folder holds another run.
    """
    from deep.score.figures import boundary_figure

    answer = exact_answer(make_task(config.task))
    rng = np.random.default_rng(POINT_STREAM)
    points = box_points(answer, config.points, config.actions, config.near, rng)
    plain = asdict(config) | {"out": None}
    open_folder(config.out, plain, file="compare.json", what="comparison")
    filters = {name: _trained(config, name, answer.horizon, quiet) for name in config.methods}
    makers = {
        "random": random_policy(answer.task),
        "adversarial": towards_obstacle_policy(answer.task),
        "trained": trained_policy(answer.task, config.task_policy_steps),
    }
    policies = tuple(makers[name] for name in POLICIES)
    scores = _oracle_scores(config, answer, points, policies)
    for method, trained in filters.items():
        for safety in trained:
            scores += _filter_scores(config, answer, points, policies, method, safety)
    _write_scores(scores, config.out / "scores.csv")
    with atomic_path(config.out / "summary.md") as temporary:
        temporary.write_text(summary_table(scores) + _gap_line(points))
    with atomic_path(config.out / "boundary.png") as temporary:
        boundary_figure(answer, filters).savefig(temporary, dpi=150)
    return scores


def _trained(
    config: CompareConfig, method: str, horizon: int, quiet: bool
) -> tuple[SafetyFilter, ...]:
    run = PretrainConfig(
        task=config.task,
        method=FORMS[method].settings(),
        seeds=config.seeds,
        updates=config.updates,
        horizon=horizon,
        mix=Mix(transitions=config.transitions, anywhere=config.anywhere),
        device=config.device,
    )
    return pretrain_in_folder(run, config.out / method, quiet=quiet).filters


def _filter_scores(
    config: CompareConfig,
    answer: ExactAnswer,
    points: Points,
    policies: tuple[Policy, ...],
    method: str,
    safety: SafetyFilter,
) -> tuple[SeedScore, ...]:
    """The scores at the method's own threshold and at the others that are of interest."""
    table = critic_table(LearnedFilter(answer.task, safety), points)
    horizon_rule = paper_threshold(safety.gamma_safe, answer.horizon)
    form = FORMS[method]
    rules = {form.threshold_rule: safety.threshold, "gamma^(H+1/2)": horizon_rule}
    if form.discount is None:
        rules[f"{CODE_THRESHOLD}"] = CODE_THRESHOLD
    return tuple(
        _score(
            config,
            answer,
            points,
            policies,
            LearnedFilter(answer.task, safety.with_threshold(threshold)),
            table,
            SeedName(method, rule, threshold, safety.seed),
        )
        for rule, threshold in rules.items()
    )


@dataclass(frozen=True)
class SeedName:
    """Which filter a score belongs to; see :class:`SeedScore`."""

    method: str
    rule: str
    threshold: float
    seed: int


def _oracle_scores(
    config: CompareConfig, answer: ExactAnswer, points: Points, policies: tuple[Policy, ...]
) -> tuple[SeedScore, ...]:
    if not isinstance(answer.task, ExactTask):
        return ()  # enclosed only: nobody knows the labels in the gap
    scored = OracleFilter(answer, answer.task)
    table = critic_table(scored, points)
    name = SeedName("oracle", "exact labels", 1.0, 0)
    return (_score(config, answer, points, policies, scored, table, name),)


def _score(
    config: CompareConfig,
    answer: ExactAnswer,
    points: Points,
    policies: tuple[Policy, ...],
    scored: ScoredFilter,
    table: NDArray[np.float32],
    name: SeedName,
) -> SeedScore:
    loops = []
    for number, policy in enumerate(policies):
        rng = np.random.default_rng((EPISODE_STREAM, number, name.seed))
        starts = safe_starts(answer, config.episodes, rng)
        loops.append(closed_loop(answer.task, scored, policy, starts, rng))
    boundary = score_boundary(table, name.threshold, points)
    return SeedScore(name.method, name.rule, name.threshold, name.seed, boundary, tuple(loops))


def _write_scores(scores: tuple[SeedScore, ...], path: Path) -> None:
    header = ["method", "rule", "threshold", "seed"]
    header += [field.name for field in fields(BoundaryScore)]
    for policy in POLICIES:
        header += [f"{policy}_{field.name}" for field in fields(ClosedLoop)]
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for score in scores:
            loops = [number for loop in score.loops for number in astuple(loop)]
            row = [score.method, score.rule, score.threshold, score.seed]
            writer.writerow([*row, *astuple(score.boundary), *loops])


SUMMARY: dict[str, Callable[[SeedScore], float]] = {
    "dead called safe": lambda s: s.boundary.dead_called_safe,
    "safe called dead": lambda s: s.boundary.safe_called_dead,
    "near: dead called safe": lambda s: s.boundary.near_dead_called_safe,
    "near: safe called dead": lambda s: s.boundary.near_safe_called_dead,
    "safe actions blocked": lambda s: s.boundary.safe_actions_blocked,
    "starts that fail, worst policy": lambda s: s.worst_failures / s.loops[0].episodes,
}


def summary_table(scores: Sequence[SeedScore]) -> str:
    """Markdown: one row a method and threshold; percent, mean over seeds [95% interval]."""
    lines = [
        "| method | epsilon | " + " | ".join(SUMMARY) + " | failures / episodes |",
        "|---" * (len(SUMMARY) + 3) + "|",
    ]
    for method, rule in dict.fromkeys((score.method, score.rule) for score in scores):
        rows = [score for score in scores if (score.method, score.rule) == (method, rule)]
        cells = [_percent(interval([column(row) for row in rows])) for column in SUMMARY.values()]
        failures = sum(loop.failures for row in rows for loop in row.loops)
        episodes = sum(loop.episodes for row in rows for loop in row.loops)
        epsilon = f"{rule} = {rows[0].threshold:.3f}"
        counts = f"{failures:,} / {episodes:,}"
        lines.append(f"| {method} | {epsilon} | " + " | ".join([*cells, counts]) + " |")
    return "\n".join(lines) + "\n"


def _gap_line(points: Points) -> str:
    if not points.gap:
        return ""
    return f"\nNot scored, between the enclosing sets: {100 * points.gap:.1f}% of the states.\n"


def _percent(value: Interval) -> str:
    if np.isnan(value.mean):
        return "–"
    return f"{100 * value.mean:.2f} [{100 * value.low:.2f}, {100 * value.high:.2f}]"
