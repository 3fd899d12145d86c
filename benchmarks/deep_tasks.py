"""Environment steps a second of the vectorised Safety Gym tasks, on one core.

``python -m benchmarks.deep_tasks`` steps ``TaskVectorEnv`` with random actions, resets and
observations included, ten substeps a step. Writes ``results/deep_tasks.json``.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.measure import best_time, save
from deep.tasks import TaskVectorEnv, make_task

NAMES = ("static-env", "dynamic-env", "point-goal1", "car-goal1")
COPIES = (1, 64, 1024)
STEPS = 25_600
REPEATS = 5


def measure(name: str, copies: int) -> dict[str, Any]:
    """One row: processor time of at least 25,600 steps."""
    environment = TaskVectorEnv(make_task(name), copies)
    environment.reset(seed=0)
    rounds = max(STEPS // copies, 20)
    actions = np.random.default_rng(0).uniform(-1, 1, (rounds, copies, 2))

    def run() -> None:
        for action in actions:
            environment.step(action)

    seconds, _ = best_time(run, REPEATS)
    return {"task": name, "copies": copies, "steps_per_second": round(rounds * copies / seconds)}


def main() -> None:
    """Measure all tasks and write the result file."""
    started = perf_counter()
    rows = [measure(name, copies) for name in NAMES for copies in COPIES]
    for row in rows:
        print(f"{row['task']:12}{row['copies']:6}{row['steps_per_second']:12,}")
    save("deep_tasks", {"substeps": 10, "repeats": REPEATS}, rows, perf_counter() - started)


if __name__ == "__main__":
    main()
