"""What a safety critic needs to see: data and view, one varied at a time, on PointGoal1.

    python -m benchmarks.critic_views runs/study

takes the SAC run and the offline data of a study, pretrains DEA-RRL (the paper's form) and
DEA-RRL (annealed) once each on

* the study's data and view: 400 steps before violations, lidars to the 24th power,
* the paper's 100 steps before violations,
* lidars as they are,

and puts SAC behind each filter for 200 whole episodes at several thresholds. Beside them
stands a limit that needs the simulator: an action is let through if after it one of nine
simple recoveries (brake, or creep ahead or back; straight, or turning to either side) goes on
for 80 steps without a violation. The exact dead-end boundary would let at least that through.

    python -m benchmarks.critic_views runs/study approach

asks the critics of such a run only one thing more, and is part of the run above too: Q_c of full
thrust along a straight line into a hazard, at full speed. From so many metres before the hazard on
that full braking takes, not even braking helps; there is nothing to see before and all after it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.measure import RESULTS, facts
from dead_ends.io.atomic import atomic_path
from deep.data.formats import write_hdf5
from deep.filter.safety_filter import SafetyFilter
from deep.filter.task_policy import TrainedPolicy
from deep.pretraining import DeaRrlAnnealedSettings, DeaRrlSettings, Settings
from deep.pretraining.config import PretrainConfig
from deep.pretraining.run import pretrain_in_folder
from deep.tasks import PointGoal1
from deep.tasks.task import Bools, Floats
from deep.train.episodes import run_episodes
from deep.train.offline_data import offline_data

TASK = "point-goal1"
SEED = 100
EPISODES = 200
SIMULATED_EPISODES = 50  # 18 rollouts of 80 steps at every step
VARIANTS = {
    "400 steps, sharpened": (400, 24.0),
    "100 steps, sharpened": (100, 24.0),
    "400 steps, lidars as they are": (400, 1.0),
}
FORMS: dict[str, tuple[Settings, tuple[float, ...]]] = {
    "dea-rrl": (
        DeaRrlSettings(learning_rate=1e-3, batch_size=128, polyak=0.1),
        (0.3, 0.5, 0.7, 0.8),
    ),
    "dea-rrl-annealed": (
        DeaRrlAnnealedSettings(learning_rate=1e-3, batch_size=128, final_expectile=0.1),
        (0.05, 0.1, 0.2, 0.3),
    ),
}
HORIZON, UPDATES = 20, 15_000
RECOVERIES = np.array([(v, turn) for v in (0.0, -0.3, 0.3) for turn in (0.0, -1.0, 1.0)])
"""Speed along the heading in m/s, and steering."""
RECOVERY_STEPS = 80
GAIN = 8.0
DISTANCES = (0.5, 0.2, 0.1, 0.05, 0.02)
"""Of an approach, in metres: before the last braking, and before contact."""
LAYOUTS = 1000
MARGIN = 0.3
"""Metres between an approach and the edges of all other hazards."""
FORWARD, BRAKE = np.array([[1.0, 0.0]]), np.array([[-1.0, 0.0]])


def recover(state: Floats, recovery: Floats) -> Floats:
    """Actions towards the speed and with the steering in the rows of ``recovery``."""
    along = np.cos(state[:, 2]) * state[:, 3] + np.sin(state[:, 2]) * state[:, 4]
    return np.column_stack([np.clip(GAIN * (recovery[:, 0] - along), -1, 1), recovery[:, 1]])


def survives(task: PointGoal1, state: Floats, recovery: Floats) -> Bools:
    """Which states go on with this recovery for 80 steps without a violation."""
    rng = np.random.default_rng(0)  # goals are drawn from it, which no hazard depends on
    alive = ~task.violates(state)
    chosen = np.tile(recovery, (len(state), 1))
    for _ in range(RECOVERY_STEPS):
        step = task.step(state, recover(state, chosen), rng)
        state = step.next_state
        alive &= ~step.violation
    return alive


def simulated(policy: TrainedPolicy, episodes: int) -> dict[str, float]:
    """ACR, AVR and ARR of the policy behind the simulator's own check."""
    task, rng = PointGoal1(), np.random.default_rng(SEED)
    state = task.reset(rng, episodes)
    returns, alive, plan = (
        np.zeros(episodes),
        np.ones(episodes, dtype=np.bool_),
        np.zeros((episodes, 2)),
    )
    replaced = steps = 0
    for _ in range(task.time_limit):
        action = policy.act(task.observe(state)).astype(np.float64)
        after = task.step(state, action, np.random.default_rng(0))
        safe, kept = np.zeros(episodes, dtype=np.bool_), np.zeros(episodes, dtype=np.bool_)
        for recovery in RECOVERIES:
            safe |= ~after.violation & survives(task, after.next_state, recovery)
            here = ~kept & survives(task, state, recovery)
            plan[here] = recovery
            kept |= here
        executed = np.where(safe[:, None], action, recover(state, plan))
        replaced += int((~safe & alive).sum())
        steps += int(alive.sum())
        step = task.step(state, executed, rng)
        returns[alive] += step.reward[alive]
        alive &= ~step.violation
        state = step.next_state
    return {
        "acr": float(returns.mean()),
        "avr": 1 - float(alive.mean()),
        "arr": replaced / steps,
    }


def at_full_speed(task: PointGoal1) -> Floats:
    """A robot's own coordinates (8,) after six seconds of full thrust from rest, heading 0."""
    rng = np.random.default_rng(0)
    state = task.reset(rng, 1)
    own = len(task.robot.state_names)
    state[:, :own] = task.robot.at_rest(1)
    for _ in range(300):
        state = task.step(state, FORWARD, rng).next_state
    state[0, :2] = 0.0
    return np.asarray(state[0, :own])


def braking_distance(task: PointGoal1) -> float:
    """Metres that a robot at full speed slides ahead under full braking."""
    rng = np.random.default_rng(0)
    state = task.reset(rng, 1)
    robot = at_full_speed(task)
    state[0, : len(robot)] = robot
    while state[0, 3] > 0:
        farthest = state[0, 0]
        state = task.step(state, BRAKE, rng).next_state
    return float(max(farthest, state[0, 0]))


def approaches(task: PointGoal1, before_contact: Floats, rng: np.random.Generator) -> Floats:
    """States (distances, layouts, state dim) on lines to the centre of the first hazard.

    Every line begins in a direction of its own; layouts where it comes near another hazard
    are left out. Of a layout, only the place of the robot differs.
    """
    state = task.reset(rng, LAYOUTS)
    angle = rng.uniform(0, 2 * np.pi, LAYOUTS)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    robot = at_full_speed(task)
    state[:, : len(robot)] = robot
    state[:, 2] = angle
    state[:, 3:5] = robot[3] * ahead
    hazards = task.hazards(state)
    size = task.layout.hazard_size
    offset = hazards[:, 1:] - hazards[:, :1]
    longest = size + before_contact.max()
    along = np.clip(-(offset * ahead[:, None]).sum(axis=2), 0, longest)
    from_line = np.linalg.norm(offset + along[..., None] * ahead[:, None], axis=2)
    state = state[(from_line > size + MARGIN).all(axis=1)]
    ahead = np.stack([np.cos(state[:, 2]), np.sin(state[:, 2])], axis=1)
    out = np.tile(state, (len(before_contact), 1, 1))
    out[..., :2] = task.hazards(state)[:, 0] - (size + before_contact)[:, None, None] * ahead
    return out


def approach_rows(views: Path) -> list[dict[str, Any]]:
    """Each critic's Q_c of full thrust at each distance: median, tenth and ninetieth percentile."""
    task, brake = PointGoal1(), braking_distance(PointGoal1())
    places = [("last braking", d, brake + d) for d in DISTANCES]
    places += [("contact", d, d) for d in DISTANCES]
    before_contact = np.array([distance for *_, distance in places])
    states = approaches(task, before_contact, np.random.default_rng(SEED))
    rows = []
    for form in FORMS:
        for variant, (keep, sharpness) in VARIANTS.items():
            path = views / f"{form}-{keep}-{sharpness:g}" / "filters" / f"seed{SEED}.safetensors"
            safety = SafetyFilter.load(path)
            for (before, distance, to_contact), at in zip(places, states, strict=True):
                q = safety.q(task.observe(at), np.tile(FORWARD, (len(at), 1)))
                low, median, high = (float(v) for v in np.quantile(q, (0.1, 0.5, 0.9)))
                rows.append(
                    {
                        "form": form, "variant": variant, "before": before, "distance": distance,
                        "to_contact": round(to_contact, 3), "layouts": len(at),
                        "q": median, "q_low": low, "q_high": high,
                    }
                )  # fmt: skip
    return rows


def approach_table(rows: list[dict[str, Any]]) -> str:
    """A row a critic, a column a distance; farthest first."""
    places = sorted({row["to_contact"] for row in rows}, reverse=True)
    lines = ["| filter | data and view |" + "".join(f" {d:.2f} m |" for d in places)]
    lines.append("|---|---|" + "---|" * len(places))
    for form, variant in dict.fromkeys((row["form"], row["variant"]) for row in rows):
        found = {
            row["to_contact"]: f"{row['q']:.2f} [{row['q_low']:.2f}, {row['q_high']:.2f}]"
            for row in rows
            if (row["form"], row["variant"]) == (form, variant)
        }
        lines.append(f"| {form} | {variant} |" + "".join(f" {found[d]} |" for d in places))
    return "\n".join(lines)


def approach(study: Path) -> None:
    """Write ``results/critic_approach.json`` and print its table."""
    rows = approach_rows(study / TASK / "views")
    speed = float(at_full_speed(PointGoal1())[3])
    content = {
        "task": TASK, "seed": SEED, "speed": round(speed, 3),
        "braking_distance": round(braking_distance(PointGoal1()), 3),
        "rows": rows, "made with": facts(),
    }  # fmt: skip
    with atomic_path(RESULTS / "critic_approach.json") as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")
    print(approach_table(rows))


def scored(study: Path, form: str, variant: str, work: Path) -> list[dict[str, Any]]:
    """One pretraining and its filters' metrics, a row a threshold."""
    settings, thresholds = FORMS[form]
    keep, sharpness = VARIANTS[variant]
    data = work / f"{keep}.hdf5"
    sac = study / TASK / "data" / "sac"
    if not data.exists():
        rng = np.random.default_rng(SEED)
        write_hdf5(offline_data(TASK, sac, SEED, 400_000, keep, rng), data)
    config = PretrainConfig(
        data=data, method=settings, seeds=(SEED,), updates=UPDATES, horizon=HORIZON,
        sharpness=sharpness,
    )  # fmt: skip
    name = f"{form}-{keep}-{sharpness:g}"
    safety = pretrain_in_folder(config, work / name).filters[0]
    policy = TrainedPolicy.load(sac / "policies" / f"seed{SEED}.safetensors")
    rows = []
    for threshold in thresholds:
        found = run_episodes(TASK, policy.act, safety.with_threshold(threshold), EPISODES, SEED)
        metrics = {"acr": found.acr, "avr": found.avr, "arr": found.arr}
        rows.append({"form": form, "variant": variant, "threshold": threshold, **metrics})
    return rows


def main(study: Path) -> None:
    """Run everything and write ``results/critic_views.json``."""
    torch.set_num_threads(1)
    work = study / TASK / "views"
    work.mkdir(parents=True, exist_ok=True)
    policy = TrainedPolicy.load(
        study / TASK / "data" / "sac" / "policies" / f"seed{SEED}.safetensors"
    )
    alone = run_episodes(TASK, policy.act, None, EPISODES, SEED)
    rows: list[dict[str, Any]] = [
        {"form": "none", "acr": alone.acr, "avr": alone.avr, "arr": 0.0},
        {"form": "simulated recoveries", **simulated(policy, SIMULATED_EPISODES)},
    ]
    for variant in VARIANTS:
        for form in FORMS:
            rows += scored(study, form, variant, work)
    content = {
        "task": TASK, "seed": SEED, "episodes": EPISODES,
        "simulated_episodes": SIMULATED_EPISODES, "updates": UPDATES, "horizon": HORIZON,
        "rows": rows, "made with": facts(),
    }  # fmt: skip
    with atomic_path(RESULTS / "critic_views.json") as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")
    for row in rows:
        print(row)


if __name__ == "__main__":
    if sys.argv[2:] != ["approach"]:
        main(Path(sys.argv[1]))
    approach(Path(sys.argv[1]))
