"""The Point and Car of ``deep.tasks.safety_gym`` against the MuJoCo robots, and their fit.

``python -m benchmarks.fit_robots collect FOLDER`` records rollouts of the real robots alone on
the plane (it needs ``scripts/install_safety_gymnasium.sh`` and ``DEAD_ENDS_SAFETY_PYTHON``);
``python -m benchmarks.fit_robots fit FOLDER`` fits the robots' parameters to the training
rollouts by least squares and scores published and fitted parameters on the held-out ones.
Writes ``results/fit_robots.json``; the fitted numbers are entered in the robots' modules by
hand.

Every action is uniform in [-1, 1]^2, new at each step or held for ten. The error of a rollout
is the distance between the robots' positions after 50 control steps.

The Car hops, and its hops are chaotic: so the simulator is also run against itself, with its
car let down from 0.1 mm above the ground. No model can be expected to come much nearer.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.measure import save
from deep.tasks.safety_gym.car_body import CAR, CAR_PUBLISHED, CarParameters
from deep.tasks.safety_gym.car_robot import advance_cars, sense_cars
from deep.tasks.safety_gym.point_robot import (
    POINT,
    PointParameters,
    advance_points,
    sense_points,
)
from deep.tasks.safety_gym.real import Worker
from deep.tasks.safety_gym.robot import CAR_ROBOT, POINT_ROBOT, Robot

Floats = NDArray[np.float64]
STEPS = 50
HELD = 10
DROP = 1e-4
FIRST_TEST = "test-random"


class Rollouts(NamedTuple):
    """Rollouts of one robot: actions (n, 50, 2), poses (n, 51, 3), sensors (n, 51, s)."""

    actions: Floats
    poses: Floats
    sensors: Floats


@dataclass(frozen=True)
class Case:
    """One robot, and what is fitted of it.

    ``difference`` is the step of the numerical derivatives: the error is rough where contacts
    or servos chatter.
    """

    name: str
    robot: Robot
    advance: Callable[[Floats, Floats, Any], None]
    sense: Callable[[Floats, Floats], None]
    parameters: type[PointParameters] | type[CarParameters]
    difference: float
    published: PointParameters | CarParameters
    built_in: PointParameters | CarParameters


CASES = (
    Case("point", POINT_ROBOT, advance_points, sense_points, PointParameters, 1e-2, POINT, POINT),
    Case("car", CAR_ROBOT, advance_cars, sense_cars, CarParameters, 0.1, CAR_PUBLISHED, CAR),
)
SETS = {
    "train-random": (240, 1),
    "train-held": (80, HELD),
    "test-random": (400, 1),
    "test-held": (200, HELD),
}


def record(worker: Worker, actions: Floats, first_seed: int, drop: float) -> Rollouts:
    """Run the real robot; copy i begins from seed first_seed + i."""
    n = len(actions)
    sensors = [np.array([worker.call("reset", i, first_seed + i) for i in range(n)])]
    worker.call("lift", drop)
    poses = [worker.call("poses")]
    for t in range(STEPS):
        sensors.append(worker.call("step", actions[:, t])["observation"])
        poses.append(worker.call("poses"))
    return Rollouts(actions, np.stack(poses, axis=1), np.stack(sensors, axis=1))


def collect(folder: Path) -> None:
    """Record all sets of both robots; the held-out ones a second time, let down."""
    folder.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        rng, seed = np.random.default_rng(0), 0
        for name, (count, hold) in SETS.items():
            if name == FIRST_TEST:
                rng, seed = np.random.default_rng(1), 10_000
            drawn = rng.uniform(-1, 1, (count, STEPS // hold, 2))
            actions = np.repeat(drawn, hold, axis=1)
            worker = Worker(f"{case.name}-alone", count)
            drops = (0.0, DROP) if name.startswith("test") else (0.0,)
            for drop in drops:
                rollouts = record(worker, actions, seed, drop)
                suffix = "-dropped" if drop else ""
                np.savez(folder / f"{case.name}-{name}{suffix}.npz", **rollouts._asdict())
            worker.close()
            seed += count
            print(case.name, name, count)


def load(folder: Path, case: Case, name: str) -> Rollouts:
    """One recorded set."""
    with np.load(folder / f"{case.name}-{name}.npz") as file:
        return Rollouts(file["actions"], file["poses"], file["sensors"])


def simulate(case: Case, rollouts: Rollouts, p: Any) -> tuple[Floats, Floats]:
    """Positions (n, 50, 2) and sensors (n, 50, s) of our robot under the same actions."""
    n = len(rollouts.actions)
    state = case.robot.at_rest(n)
    state[:, :3] = rollouts.poses[:, 0]
    positions, sensors = np.empty((n, STEPS, 2)), np.empty((n, STEPS, case.robot.sensors))
    for t in range(STEPS):
        case.advance(state, rollouts.actions[:, t], p)
        positions[:, t] = state[:, :2]
        case.sense(state, sensors[:, t])
    return positions, sensors


def fit(case: Case, folder: Path) -> Any:
    """Least squares over the parameters' ratios to the published ones; lost rollouts count little.

    It begins at the published ones, and finds what is near them only: the error is rough.
    """
    sets = [load(folder, case, name) for name in SETS if name.startswith("train")]
    weight = np.linspace(0.5, 1, STEPS)[:, None]

    def residuals(ratios: Floats) -> Floats:
        p = case.parameters(*(np.array(case.published) * ratios))
        errors = [weight * (simulate(case, s, p)[0] - s.poses[:, 1:, :2]) for s in sets]
        return np.concatenate([error.ravel() for error in errors])

    found = least_squares(
        residuals,
        np.ones(len(case.published)),
        bounds=(0.2, 5.0),
        diff_step=[case.difference],
        loss="soft_l1",
        f_scale=0.02,
        max_nfev=60,
    )
    return case.parameters(*(np.array(case.published) * found.x).tolist())


def score(case: Case, rollouts: Rollouts, p: Any) -> dict[str, Any]:
    """Position errors after 50 steps, in metres, and how large sensors are, there and here."""
    positions, sensors = simulate(case, rollouts, p)
    error = np.linalg.norm(positions[:, -1] - rollouts.poses[:, -1, :2], axis=1)
    path = np.linalg.norm(np.diff(rollouts.poses[..., :2], axis=1), axis=2).sum(axis=1)
    there = rollouts.sensors[:, 1:, : case.robot.sensors]
    return {
        **quantiles(error),
        "median_path": float(np.median(path)),
        "rms_sensors": np.sqrt((sensors**2).mean(axis=(0, 1))).round(4).tolist(),
        "rms_sensors_mujoco": np.sqrt((there**2).mean(axis=(0, 1))).round(4).tolist(),
    }


def quantiles(error: Floats) -> dict[str, float]:
    """Median with a 95% bootstrap interval, and the ninth decile."""
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(error, (2000, len(error))), axis=1)
    low, high = np.quantile(medians, (0.025, 0.975))
    return {
        "median_error": float(np.median(error)),
        "median_low": float(low),
        "median_high": float(high),
        "decile_error": float(np.quantile(error, 0.9)),
    }


def against_itself(case: Case, folder: Path, name: str) -> dict[str, Any]:
    """The simulator against itself, let down from a tenth of a millimetre."""
    one, two = load(folder, case, name), load(folder, case, f"{name}-dropped")
    error = np.linalg.norm(one.poses[:, -1, :2] - two.poses[:, -1, :2], axis=1)
    return quantiles(error)


def rows(folder: Path) -> list[dict[str, Any]]:
    """One row a robot, set of parameters and held-out set."""
    result = []
    for case in CASES:
        candidates = {
            "published": case.published,
            "fitted": fit(case, folder),
            "built in": case.built_in,
        }
        for name in (n for n in SETS if n.startswith("test")):
            about = {"robot": case.name, "set": name, "rollouts": SETS[name][0]}
            for label, p in candidates.items():
                row = about | {"parameters": label, "values": p._asdict()}
                result.append(row | score(case, load(folder, case, name), p))
            if case.name == "car":
                row = about | {"parameters": "MuJoCo, 0.1 mm higher"}
                result.append(row | against_itself(case, folder, name))
    return result


def main() -> None:
    """Collect, or fit and score."""
    match sys.argv[1:]:
        case ["collect", folder]:
            collect(Path(folder))
        case ["fit", folder]:
            started = perf_counter()
            found = rows(Path(folder))
            for row in found:
                print(f"{row['robot']:6}{row['set']:12}{row['parameters']:24}"
                      f"{100 * row['median_error']:8.3f} cm")  # fmt: skip
            config = {"steps": STEPS, "sets": {k: list(v) for k, v in SETS.items()}}
            save("fit_robots", config, found, perf_counter() - started)
        case _:
            raise SystemExit("usage: python -m benchmarks.fit_robots collect|fit FOLDER")


if __name__ == "__main__":
    main()
