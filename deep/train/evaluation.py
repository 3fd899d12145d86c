"""Plug and play: a trained task policy behind a filter that it has never met.

Also the plain evaluation of a policy, without a filter.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from deep.filter.safety_filter import SafetyFilter
from deep.filter.task_policy import TrainedPolicy, check_units
from deep.runs.folder import check_unused
from deep.runs.record import Record
from deep.tasks.gym import NO_RULES, Rules
from deep.tasks.task import Sizes
from deep.tasks.vectorised import check_fit, task_spaces
from deep.train.pretrained import load_filters
from deep.train.result import (
    Budget,
    SeedResult,
    evaluate,
    read_seeds,
    run_rules,
    write_result,
)

__all__ = ["evaluate_policies"]


def evaluate_policies(
    policies: Path,
    safety: Path | None,
    out: Path,
    *,
    threshold: float | None = None,
    episodes: int = 500,
    task: str | None = None,
    rules: Rules | None = None,
) -> tuple[SeedResult, ...]:
    """Whole episodes of every seed of a training run, behind a filter if there is one.

    Args:
        policies: the folder of a finished run.
        safety: a folder with ``filters/seed<k>.safetensors`` of the same seeds: a
            pretraining run, or a training run behind a correction.
        out: gets ``result.json``.
        threshold: epsilon; None: each filter's own.
        episodes: whole episodes a seed.
        task: evaluate there instead of where the policies were trained.
        rules: what an environment of "gym:" leaves open; None: where the policies were trained,
            their run's, elsewhere nothing.

    Raises:
        ValueError: if a run is missing or unfinished, lacks a seed or does not fit the task
            (dimensions, action bounds), if ``out`` holds a run or an evaluation, or a threshold
            is given without filters.
    """
    if threshold is not None and safety is None:
        raise ValueError("threshold needs filters: safety")
    path = policies / "result.json"
    if not path.is_file():
        raise ValueError(f"{policies}: not a finished run (no result.json)")
    if (out / "config.json").exists():
        raise ValueError(f"{out} holds a run, whose result an evaluation would replace")
    check_unused(out)
    run = Record.read(path)
    method, home = run.text("method"), run.text("task")
    spent = Budget.from_record(run.record("budget"))
    numbers = [seed.seed for seed in read_seeds(run)]
    where = task or home
    if rules is None:
        rules = run_rules(policies) if where == home else NO_RULES
    begin = time.perf_counter()
    trained = [
        TrainedPolicy.load(policies / "policies" / f"seed{seed}.safetensors") for seed in numbers
    ]
    filters = [] if safety is None else _filters(safety, numbers, threshold)
    sizes, bounds = task_spaces(where, rules)
    for folder, kind, made in ((policies, "policies", trained), (safety, "filters", filters)):
        for one in made:
            n = one.normalisation
            found = Sizes(len(n.observation_centre), len(n.action_centre))
            check_fit(f"{folder}: its {kind} take", found, where, sizes)
    for policy in trained:
        check_units(f"{policies}: its policies choose", policy.normalisation, where, bounds)
    filters = [safety.for_actions(bounds, where) for safety in filters]
    thresholds: list[float | None] = [safety.threshold for safety in filters]
    seeds = [
        SeedResult.of(seed, found, threshold=epsilon)
        for seed, found, epsilon in zip(
            numbers,
            evaluate(where, trained, filters, episodes, rules=rules),
            thresholds or [None] * len(numbers),
            strict=True,
        )
    ]
    seconds = round(time.perf_counter() - begin, 1)
    out.mkdir(parents=True, exist_ok=True)
    write_result(
        out,
        where,
        "+".join([method, *sorted({safety.method for safety in filters})]),
        replace(spent, wall_seconds=seconds, evaluation_episodes=episodes),
        seeds,
        policies=str(policies),
        safety=None if safety is None else str(safety),
    )
    return tuple(seeds)


def _filters(safety: Path, seeds: Sequence[int], threshold: float | None) -> list[SafetyFilter]:
    loaded = load_filters(safety, seeds)
    return loaded if threshold is None else [safety.with_threshold(threshold) for safety in loaded]
