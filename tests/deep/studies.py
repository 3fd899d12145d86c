"""Made-up study folders, in the layout of real ones, for tests that train nothing."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

STEPS = 1_000_000
EVERY = 10_000
MADE_WITH = {"numpy": "2.0", "torch": "2.9", "python": "3.11.9", "git": "a" * 40}


def seed_result(seed: int, **numbers: Any) -> dict[str, Any]:
    """One entry of ``seeds`` in a result file."""
    plain: dict[str, Any] = {
        "seed": seed,
        "tv": 100,
        "episodes": 1000,
        "acr": 10.0,
        "avr": 0.1,
        "arr": 0.0,
        "length": 900.0,
        "training_arr": 0.0,
        "threshold": None,
    }
    return plain | numbers


def write_result(folder: Path, task: str, method: str, seeds: Sequence[Mapping[str, Any]]) -> None:
    """``result.json`` of a finished run."""
    offline = method == "iql" or "+" in method
    budget = {
        "env_steps": 0 if offline else STEPS,
        "updates": STEPS // 10,
        "wall_seconds": 4000.0,
        "evaluation_episodes": 500,
    }
    folder.mkdir(parents=True)
    content = {"task": task, "method": method, "budget": budget, "seeds": seeds}
    (folder / "result.json").write_text(json.dumps(content | {"made with": MADE_WITH}))


def write_log(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """A CSV file with a header."""
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])


CHARACTER = {
    "sac": (14.0, 0.6, 0.0),
    "wcsac": (9.0, 0.15, 0.0),
    "rrl": (3.0, 0.06, 0.5),
    "rrl-msdp": (6.0, 0.07, 0.35),
    "dea-rrl": (13.0, 0.04, 0.2),
    "dea-rrl-annealed": (14.0, 0.03, 0.1),
    "dearrl-iql": (11.0, 0.2, 0.12),
}
"""Final return, violation share and share of corrected steps, all made up."""


def write_training(
    folder: Path,
    task: str,
    method: str,
    thresholds: Sequence[float | None],
    rng: np.random.Generator,
) -> None:
    """A whole run folder with noisy curves, a seed a threshold."""
    results, progress, evaluations = [], [], []
    for seed, threshold in enumerate(thresholds):
        reward, share, corrected = CHARACTER[method]
        if threshold is not None:
            share, corrected = share * (0.5 + threshold), corrected / (0.5 + threshold)
        episodes = violations = 0
        for step in range(EVERY, STEPS + 1, EVERY):
            done = step / STEPS
            new = int(rng.integers(10, 15))
            episodes += new
            rate = np.clip(share * (0.4 + 0.6 * done), 0, 1)
            violations += int(rng.binomial(new, rate))
            arr = round(float(np.clip(corrected * rng.normal(1.4 - 0.4 * done, 0.05), 0, 1)), 4)
            progress.append((step, seed, episodes, violations, arr, "", "", 0.1, 0.2, done))
            if step % (5 * EVERY) == 0:
                acr = reward * (1 - np.exp(-4 * done)) + rng.normal(0, 0.6)
                evaluations.append((step, seed, 20, acr, share, arr, 800))
        numbers = {"acr": acr, "avr": share, "arr": arr, "training_arr": arr, "tv": violations}
        results.append(seed_result(seed, threshold=threshold, episodes=episodes, **numbers))
    write_result(folder, task, method, results)
    header = ("step", "seed", "episodes", "violations", "interventions", "return", "length")
    losses = ("critic_loss", "policy_loss", "seconds")
    write_log(folder / "progress.csv", (*header, *losses), progress)
    columns = ("step", "seed", "episodes", "acr", "avr", "arr", "length")
    write_log(folder / "evaluations.csv", columns, evaluations)


def write_study(study: Path, tasks: Sequence[str], seeds: int) -> None:
    """All sections of a study; WCSAC is missing on the last task."""
    rng = np.random.default_rng(0)
    for task in tasks:
        place = study / task
        for method in CHARACTER:
            if method == "wcsac" and task == tasks[-1]:
                continue
            threshold = {"sac": None, "wcsac": 0.01}.get(method, 0.3)
            write_training(place / "train" / method, task, method, [threshold] * seeds, rng)
        results = [seed_result(k, tv=0, acr=12.0 + k, avr=0.5) for k in range(seeds)]
        write_result(place / "train" / "iql", task, "iql", results)
        for form in ("rrl", "rrl-msdp", "dearrl-iql", "dea-rrl", "dea-rrl-annealed"):
            write_training(place / "ablation" / form, task, form, [0.7] * seeds, rng)
            write_training(place / "select" / form, task, form, (0.05, 0.1, 0.3, 0.5, 0.7), rng)
        for pair in ("sac+rrl", "iql+rrl", "sac+dea-rrl", "iql+dea-rrl"):
            numbers = {"tv": None, "episodes": None, "training_arr": None, "threshold": 0.3}
            results = [seed_result(k, arr=0.2 + 0.01 * k, **numbers) for k in range(seeds)]
            write_result(place / "plug" / pair, task, pair, results)
