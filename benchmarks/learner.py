"""Updates a second of our SAC and of Stable-Baselines3's: ``python -m benchmarks.learner``.

One update is a minibatch drawn from a filled replay buffer, one step of twin critics and policy,
and the targets' averaging. Ours makes K updates at once, one a seed, in one process; the rate
counts all of them. Both run on one core, in one thread, with the same widths, batch size and
fixed temperature, in turns: every repetition measures all of them, and a ratio is one of two
neighbours. Writes ``results/learner.json`` and prints the README's table.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np
import torch

from benchmarks.measure import save
from benchmarks.sb3 import filled_sac
from deep.data.normalisation import TensorNormalisation
from deep.tasks.task import Sizes
from deep.train.replay import Arrival, Replay
from deep.train.sac import Sac, SacSettings

SIZES = Sizes(observation=60, action=2)
CASES = ((64, 64), (64, 256), (128, 256), (256, 256))
"""Width of both hidden layers, batch size."""
SEEDS = (1, 4, 8)
REPLAY = 100_000
REPEATS = 7
SECONDS = 0.7
"""Of each measurement."""

Updates = Callable[[int], None]
"""Makes a number of updates of every seed."""


def their_updates(settings: SacSettings, replay: int = REPLAY) -> Updates:
    """Stable-Baselines3's ``train``."""
    model = filled_sac(settings, *SIZES, replay)
    return lambda count: model.train(count, settings.batch_size)


def our_updates(settings: SacSettings, seeds: int, folder: Path, replay: int = REPLAY) -> Updates:
    """Those of a training run: sample, set the learning rate, scale, update."""
    learner = Sac(settings, SIZES, range(seeds))
    buffer = filled_replay(seeds, folder, replay)
    steps, done = buffer.capacity, 0
    normalisation = TensorNormalisation(buffer.normalisation(steps))

    def update(count: int) -> None:
        nonlocal done
        for _ in range(count):
            raw = buffer.sample(done, steps, settings.batch_size)
            learner.slow_down(0.0)
            learner.update(
                raw._replace(
                    observation=normalisation.observation(raw.observation),
                    next_observation=normalisation.observation(raw.next_observation),
                )
            )
            done += 1

    return update


def filled_replay(seeds: int, folder: Path, replay: int) -> Replay:
    """Our buffer, full of noise: ``replay`` transitions a seed."""
    copies = 100
    buffer = Replay(
        folder / f"replay{seeds}.bin", range(seeds), copies, replay // copies, 1, *SIZES
    )
    rng = np.random.default_rng(0)
    never = np.zeros((seeds, copies), dtype=np.bool_)
    for step in range(buffer.capacity):
        s, following = rng.standard_normal((2, seeds, copies, SIZES.observation))
        action = rng.uniform(-1, 1, (seeds, copies, SIZES.action))
        reward = rng.standard_normal((seeds, copies))
        buffer.add(step, Arrival(s, action, action, following, reward, never, never, never))
    return buffer


def rate(updates: Updates, count: int, seeds: int) -> float:
    """Updates of all seeds a second of the processor."""
    begin = process_time()
    updates(count)
    return seeds * count / (process_time() - begin)


def count_for(updates: Updates, seconds: float) -> int:
    """How many updates take about that long; the first ones warm up."""
    updates(5)
    return max(1, round(seconds * rate(updates, 10, 1)))


def measure(width: int, batch_size: int, folder: Path) -> list[dict[str, Any]]:
    """Rows of one case, one for each number of seeds."""
    settings = SacSettings(
        hidden=(width, width), batch_size=batch_size, final_rate=1, reward_scale=1
    )
    theirs = their_updates(settings)
    ours = {seeds: our_updates(settings, seeds, folder) for seeds in SEEDS}
    their_count = count_for(theirs, SECONDS)
    counts = {seeds: count_for(updates, SECONDS) for seeds, updates in ours.items()}
    rates: dict[int, list[float]] = {seeds: [] for seeds in SEEDS}
    their_rates: dict[int, list[float]] = {seeds: [] for seeds in SEEDS}
    for _ in range(REPEATS):
        for seeds, updates in ours.items():
            their_rates[seeds].append(rate(theirs, their_count, 1))
            rates[seeds].append(rate(updates, counts[seeds], seeds))
    case = {"width": width, "batch_size": batch_size}
    return [case | {"seeds": k} | compared(rates[k], their_rates[k]) for k in SEEDS]


def compared(ours: list[float], theirs: list[float]) -> dict[str, Any]:
    """Medians of both rates, and of their ratios with the least and the greatest."""
    ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
    return {
        "ours": round(median(ours), 1),
        "stable_baselines3": round(median(theirs), 1),
        "ratio": round(median(ratios), 3),
        "least_ratio": round(min(ratios), 3),
        "greatest_ratio": round(max(ratios), 3),
    }


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown: one line a row."""
    lines = [
        "| hidden layers | batch | seeds in one process | ours, updates a second "
        "| Stable-Baselines3 | ratio | least to greatest |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['width']} x {row['width']} | {row['batch_size']} | {row['seeds']} "
        f"| {row['ours']:,.0f} | {row['stable_baselines3']:,.0f} | {row['ratio']:.2f} "
        f"| {row['least_ratio']:.2f} to {row['greatest_ratio']:.2f} |"
        for row in rows
    ]
    return lines


def main() -> None:
    """Measure all cases on one core and write the result file."""
    started = perf_counter()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    rows = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            rows += measure(*case, Path(folder))
    print("\n".join(table(rows)))
    config = {**SIZES._asdict(), "replay": REPLAY, "repeats": REPEATS, "seconds": SECONDS}
    print(save("learner", config, rows, perf_counter() - started))


if __name__ == "__main__":
    main()
