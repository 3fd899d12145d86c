"""Why a filter can be safe and useless: stand-offs, on PointGoal1.

    python -m benchmarks.stand_off runs/study

puts the study's SAC policies behind the pretrained filters that they have never met, at the
thresholds that the study chose and at larger ones, and looks at the steps that are corrected: how
fast the robot is there, how often correction and policy take turns (corrected steps between two
that are not), and what the recovery policy does.

A policy that thrusts at a hazard is stopped; the recovery policy backs off a little; now the
thrust is safe again for a step. Where the recovery policy backs off straight the robot hardly
moves any more, whatever the threshold; where it turns, the robot gets away.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import RESULTS, facts
from dead_ends.io.atomic import atomic_path
from deep.filter.safety_filter import SafetyFilter
from deep.filter.task_policy import TrainedPolicy
from deep.tasks import PointGoal1

TASK = "point-goal1"
THRESHOLDS = {"dea-rrl": (0.5, 0.9), "dea-rrl-annealed": (0.05,)}
SEEDS = (0, 1, 2, 3)
COPIES, STEPS = 30, 600
EPISODES_SEED = 5


def watched(policy: TrainedPolicy, safety: SafetyFilter) -> dict[str, float]:
    """What happens on corrected steps of 30 robots in 600 steps; no episode is ended."""
    task, rng = PointGoal1(), np.random.default_rng(EPISODES_SEED)
    state = task.reset(rng, COPIES)
    corrected = np.zeros((STEPS, COPIES), dtype=np.bool_)
    speed, executed = np.zeros((STEPS, COPIES)), np.zeros((STEPS, COPIES, 2))
    for t in range(STEPS):
        observation = task.observe(state)
        found = safety.correct(observation, policy.act(observation))
        corrected[t], executed[t] = found.intervened, found.executed
        speed[t] = np.hypot(state[:, 3], state[:, 4])
        state = task.step(state, executed[t], rng).next_state
    turns = corrected[1:-1] & ~corrected[:-2] & ~corrected[2:]
    recovery = executed[corrected]
    return {
        "arr": float(corrected.mean()),
        "speed": float(np.median(speed[corrected])),
        "alone": float(turns.sum() / corrected[1:-1].sum()),
        "thrust": float(recovery[:, 0].mean()),
        "turn": float(np.abs(recovery[:, 1]).mean()),
    }


def main(study: Path) -> None:
    """Measure every filter and write ``results/stand_off.json``."""
    rows: list[dict[str, Any]] = []
    folder = study / TASK
    for form, thresholds in THRESHOLDS.items():
        for threshold in thresholds:
            for seed in SEEDS:
                name = f"seed{seed}.safetensors"
                policy = TrainedPolicy.load(folder / "train" / "sac" / "policies" / name)
                safety = SafetyFilter.load(folder / "pretrain" / form / "filters" / name)
                numbers = watched(policy, safety.with_threshold(threshold))
                rows.append({"form": form, "threshold": threshold, "seed": seed, **numbers})
                shown = ", ".join(f"{key} {value:.3f}" for key, value in numbers.items())
                print(f"{form} at {threshold}, seed {seed}: {shown}")
    content = {"task": TASK, "copies": COPIES, "steps": STEPS, "rows": rows, "made with": facts()}
    with atomic_path(RESULTS / "stand_off.json") as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
