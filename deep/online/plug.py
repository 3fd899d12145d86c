"""Plug and play: a trained task policy behind a filter that it has never met.

Also the plain evaluation of a policy, without a filter.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from dead_ends.io.atomic import atomic_path
from deep.folder import versions
from deep.online.episodes import run_episodes
from deep.safety_filter import SafetyFilter
from deep.task_policy import TrainedPolicy

__all__ = ["evaluate_policies"]


def evaluate_policies(
    policies: Path,
    safety: Path | None,
    out: Path,
    *,
    threshold: float | None = None,
    episodes: int = 500,
    task: str | None = None,
) -> tuple[dict[str, Any], ...]:
    """Whole episodes of every seed of a training run, behind a filter if there is one.

    Args:
        policies: the folder of a finished run.
        safety: a folder with ``filters/seed<k>.safetensors`` of the same seeds: a
            pretraining run, or a training run behind a correction.
        out: gets ``result.json``.
        threshold: epsilon; None: each filter's own.
        episodes: whole episodes a seed.
        task: evaluate there instead of where the policies were trained.

    Raises:
        ValueError: if a run is missing or unfinished, or lacks a seed.
    """
    path = policies / "result.json"
    if not path.is_file():
        raise ValueError(f"{policies}: not a finished run (no result.json)")
    run = json.loads(path.read_text())
    where = task or run["task"]
    begin = time.perf_counter()
    seeds, methods = [], set()
    for entry in run["seeds"]:
        seed = int(entry["seed"])
        policy = TrainedPolicy.load(policies / "policies" / f"seed{seed}.safetensors")
        gate = None
        if safety is not None:
            gate = SafetyFilter.load(safety / "filters" / f"seed{seed}.safetensors")
            gate = gate if threshold is None else gate.with_threshold(threshold)
            methods.add(gate.method)
        found = run_episodes(where, policy.act, gate, episodes, seed)
        seeds.append(
            {
                "seed": seed,
                "tv": None,
                "episodes": None,
                "acr": found.acr,
                "avr": found.avr,
                "arr": found.arr,
                "length": found.length,
                "training_arr": None,
                "threshold": None if gate is None else gate.threshold,
            }
        )
    content = {
        "task": where,
        "method": "+".join([run["method"], *sorted(methods)]),
        "budget": {
            "env_steps": run["budget"]["env_steps"],
            "updates": run["budget"]["updates"],
            "wall_seconds": round(time.perf_counter() - begin, 1),
            "evaluation_episodes": episodes,
        },
        "policies": str(policies),
        "safety": None if safety is None else str(safety),
        "seeds": seeds,
        "made with": versions(),
    }
    out.mkdir(parents=True, exist_ok=True)
    with atomic_path(out / "result.json") as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")
    return tuple(seeds)
