"""The benchmark of critics on the way into a hazard: where braking still helps, and the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import critic_views
from benchmarks.critic_views import (
    BRAKE,
    FORMS,
    FORWARD,
    SEED,
    VARIANTS,
    approach_rows,
    approach_table,
    approaches,
    at_full_speed,
    braking_distance,
)
from deep.data.normalisation import Normalisation
from deep.filter.safety_filter import SafetyFilter
from deep.tasks import PointGoal1
from deep.tasks.bounds import Bounds
from deep.tasks.task import Bools, Floats


def _hits(task: PointGoal1, state: Floats, action: Floats) -> Bools:
    """Which states come to a violation within half a second of this action."""
    rng = np.random.default_rng(0)
    hit = task.violates(state)
    for _ in range(25):
        step = task.step(state, np.tile(action, (len(state), 1)), rng)
        state, hit = step.next_state, hit | step.violation
    return hit


def _filter(bias: float) -> SafetyFilter:
    """Q = sigmoid(2 a_0 + bias)."""
    o = PointGoal1.observation_dim
    weights = np.zeros((1, o + 2, 1), dtype=np.float32)
    weights[0, o] = 2.0
    return SafetyFilter(
        critic=((weights, np.full((1, 1, 1), bias, dtype=np.float32)),),
        recovery=((np.zeros((o, 4), dtype=np.float32), np.zeros(4, dtype=np.float32)),),
        threshold=0.5,
        normalisation=Normalisation.identity(o, 2),
        actions=Bounds.unit(2),
        observations=Bounds.unit(o),
        reach=1.0,
        gamma_safe=0.99,
        method="by hand",
        seed=SEED,
    )


def test_full_speed_is_where_thrust_and_drag_are_equal() -> None:
    robot = at_full_speed(PointGoal1())
    assert robot[3] == pytest.approx(1.5, abs=1e-3)
    assert robot[[0, 1, 2, 4, 5]].tolist() == [0] * 5
    assert abs(robot[6]) < 1e-3


def test_braking_helps_as_long_as_the_distance_says() -> None:
    task = PointGoal1()
    brake = braking_distance(task)
    distances = np.array([brake + 0.02, brake - 0.02, 0.02])
    early, late, last = approaches(task, distances, np.random.default_rng(1))
    assert len(early) > 20
    assert not _hits(task, early, BRAKE).any()
    assert _hits(task, early, FORWARD).all()
    assert _hits(task, late, BRAKE).all()
    assert not task.violates(last).any()
    full = np.tile(FORWARD, (len(last), 1))
    assert task.step(last, full, np.random.default_rng(0)).violation.all()


def test_critics_are_asked_about_full_thrust(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(critic_views, "LAYOUTS", 200)
    for k, form in enumerate(FORMS):
        for keep, sharpness in VARIANTS.values():
            folder = tmp_path / f"{form}-{keep}-{sharpness:g}" / "filters"
            folder.mkdir(parents=True)
            _filter(k - 2.0).save(folder / f"seed{SEED}.safetensors")
    rows = approach_rows(tmp_path)
    assert len(rows) == len(FORMS) * len(VARIANTS) * 10
    assert {round(row["q"], 6) for row in rows} == {0.5, round(1 / (1 + np.exp(-1)), 6)}
    lines = approach_table(rows).splitlines()
    assert lines[0].startswith("| filter | data and view | 0.74 m | 0.50 m | 0.44 m |")
    assert len(lines) == 2 + len(FORMS) * len(VARIANTS)
    assert lines[2].startswith("| dea-rrl | 400 steps, sharpened | 0.50 [0.50, 0.50] |")
    with pytest.raises(ValueError, match="seed100.safetensors: there is no such file"):
        approach_rows(tmp_path / "none")
