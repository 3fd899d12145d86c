"""What is said of a filter is what it does with a log: counted by hand, for made-up ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deep.data.transitions import Transitions
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import health
from deep.pretraining.health import Fault, check_filter, read_health, write_health
from deep.tasks.bounds import Bounds
from tests.deep.filters import linear_filter


def log() -> Transitions:
    """Observation: the row. A violation at row 9, an end at 19, a timeout at 29, five more rows."""
    rows = np.arange(35)
    violated = rows == 9
    observations = rows[:, None].astype(np.float32)
    return Transitions(
        observations,
        np.zeros((35, 1)),
        observations,
        np.zeros(35),
        violated.astype(float),
        violated | (rows == 19),
        rows == 29,
    )


def step_at(first: float, sign: float = 1.0) -> SafetyFilter:
    """Blocks from observation ``first`` on, or with ``sign`` -1 before it."""
    seen = Bounds((0.0,), (34.0,))
    return linear_filter([10.0 * sign], 0.0, -10.0 * sign * (first - 0.5), 0.0, observations=seen)


def test_shares_are_those_of_a_count_by_hand() -> None:
    found = check_filter(step_at(8, -1), log(), 3)  # blocks rows 0 to 7
    assert (found.transitions, found.steps, found.threshold) == (35, 3, 0.5)
    assert found.blocked == 8 / 35
    assert found.blocked_before == 1 / 3  # of 7, 8, 9
    assert found.blocked_well == 0  # of 10 to 29
    assert found.blocked_elsewhere == 7 / 32
    assert found.out_of_range == 0
    assert found.fault is None
    assert str(found) == (
        "seed 0: at epsilon 0.5 it blocks 22.9% of 35 logged actions, 0.0% of those in episodes "
        "that ended well, 33.3% of those in the last 3 steps before violations; 0.0% of the "
        "observations are out of range"
    )
    # An episode that the log breaks off has not ended well.
    assert check_filter(step_at(29), log(), 3).blocked_well == 1 / 20
    # Without a horizon, and at H = 0: the step that violates.
    for horizon in (None, 0, 1):
        found = check_filter(step_at(10, -1), log(), horizon)
        assert (found.steps, found.blocked_before) == (1, 1.0)
        assert "those in the last step before violations" in str(found)
    # A violation's last steps end where its episode begins.
    assert check_filter(step_at(10, -1), log(), 50).blocked_before == 1.0
    assert check_filter(step_at(10, -1), log(), 50).blocked_elsewhere == 0.0


@pytest.mark.parametrize(
    ("safety", "fault"),
    [
        (step_at(-1), Fault.BLOCKS_ALL),
        (step_at(1), Fault.BLOCKS_ALL),  # 34 of 35
        (step_at(99), Fault.BLOCKS_NONE),
        (step_at(10), Fault.BLOCKS_ALL),  # all that ended well, and nothing before the violation
        (step_at(20), Fault.BLOCKS_NONE),  # half of what ended well, nothing before the violation
        (step_at(8, -1), None),
        (step_at(10, -1), None),
    ],
)
def test_what_is_of_no_use_is_named(safety: SafetyFilter, fault: Fault | None) -> None:
    found = check_filter(safety, log(), 3)
    assert found.fault is fault
    assert str(found).endswith(
        "out of range" if fault is None else f"; warning: of no use, {fault}"
    )


def test_a_filter_that_tells_nothing_apart_is_of_no_use() -> None:
    """It blocks by a coin in the action: half of everything, before violations as elsewhere."""
    rows = log()
    coin = replace(rows, actions=np.where(np.arange(35) % 2, 1.0, -1.0)[:, None])
    found = check_filter(linear_filter([0.0], 10.0, 0.0, 0.0), coin, 4)
    assert (found.blocked_before, found.blocked_well) == (0.5, 0.5)
    assert found.fault is Fault.BLOCKS_ALIKE
    # Where no episode ended well, the other rows stand for them.
    lost = coin.take(np.arange(10))
    found = check_filter(linear_filter([0.0], 10.0, 0.0, 0.0), lost, 4)
    assert (found.blocked_well, found.blocked_elsewhere) == (None, 0.5)
    assert found.fault is Fault.BLOCKS_ALIKE
    assert "none (there are none) of those in episodes that ended well" in str(found)


def test_a_log_from_elsewhere_is_noticed() -> None:
    found = check_filter(step_at(8, -1), log(), 3)
    narrow = replace(step_at(8, -1), observations=Bounds((0.0,), (30.0,)))  # 33 is in, 34 is out
    moved = check_filter(narrow, log(), 3)
    assert (moved.out_of_range, moved.fault) == (1 / 35, None)
    narrow = replace(narrow, observations=Bounds((0.0,), (20.0,)))
    moved = check_filter(narrow, log(), 3)
    assert (moved.out_of_range, moved.fault) == (12 / 35, Fault.ELSEWHERE)
    assert moved.blocked == found.blocked
    with pytest.raises(
        ValueError, match=r"^the log has observations in R\^1 and actions in R\^1, "
    ):
        check_filter(linear_filter([1.0, 1.0], 0.0, 0.0, 0.0), log(), 3)


def test_a_log_in_other_action_units_is_refused() -> None:
    """Its actions would be moved to the bounds, and the shares those of other actions."""
    safety = step_at(8, -1)  # actions in [-1, 1]
    far = replace(log(), actions=np.linspace(-3.0, 1.0, 35)[:, None])
    message = r"^the log has actions in \(-3\) to \(1\), the filter was trained on \(-1\) to \(1\)$"
    with pytest.raises(ValueError, match=message):
        check_filter(safety, far, 3)
    near = replace(log(), actions=np.linspace(-1.09, 1.0, 35)[:, None])  # 5% of the range
    assert check_filter(safety, near, 3).fault is None
    with pytest.raises(ValueError, match="^horizon must not be negative, not -1$"):
        check_filter(safety, log(), -1)


def test_long_logs_are_asked_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = check_filter(step_at(8, -1), log(), 3)
    monkeypatch.setattr(health, "ROWS", 4)
    assert check_filter(step_at(8, -1), log(), 3) == whole


def test_health_is_kept_with_the_run(tmp_path: Path) -> None:
    found = tuple(check_filter(f, log(), 3) for f in (step_at(8, -1), step_at(-1)))
    write_health(found, tmp_path)
    assert read_health(tmp_path) == found
    path = tmp_path / "health.json"
    kept = json.loads(path.read_text())["seeds"]
    assert [entry["fault"] for entry in kept] == [None, "it blocks nearly every action"]
    for broken in ('{"seeds": [{"seed": 0}]}', '{"seeds": [3]}', '{"seeds": 3}'):
        path.write_text(broken)
        with pytest.raises(ValueError, match="health.json: not the health of filters"):
            read_health(tmp_path)
    path.unlink()
    with pytest.raises(ValueError, match=r"not a finished pretraining run \(no health.json\)$"):
        read_health(tmp_path)
