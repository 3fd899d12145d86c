"""Configurations of online runs: what is refused, and the way through JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deep.tasks.gym import Rules
from deep.tasks.task import Sizes
from deep.tasks.vectorised import Arrived
from deep.train.config import (
    TrainConfig,
    build_task_learner,
    train_config_from_json,
    train_config_to_json,
)
from deep.train.counts import Counts
from deep.train.sac import Sac, SacSettings
from tests.deep.online_runs import TINY

BEHIND = replace(TINY, safety=Path("safety"))


@pytest.mark.parametrize(
    "name",
    [
        *("steps", "copies", "start_steps", "steps_per_update", "replay", "episodes"),
        *("evaluate_every", "evaluation_episodes", "log_every", "checkpoint_every"),
    ],
)
def test_counts_are_at_least_one(name: str) -> None:
    for wrong in (0, -3):
        with pytest.raises(ValueError, match=f"^{name} must be at least 1, not {wrong}$"):
            replace(TINY, **{name: wrong})  # type: ignore[arg-type]  # one of several types


@pytest.mark.parametrize(
    "name", ["steps", "start_steps", "replay", "evaluate_every", "log_every", "checkpoint_every"]
)
def test_steps_are_counted_in_whole_steps_of_all_copies(name: str) -> None:
    message = rf"^{name} must be a multiple of copies \(4\), not 242$"
    with pytest.raises(ValueError, match=message):
        replace(TINY, **{name: 242})  # type: ignore[arg-type]  # one of several types


def test_a_run_begins_before_it_ends() -> None:
    with pytest.raises(ValueError, match=r"start_steps \(80\) must not exceed steps \(40\)"):
        replace(TINY, steps=40)
    with pytest.raises(ValueError, match="batch_size must be at least 2: finetuning halves it"):
        replace(TINY, method=SacSettings(batch_size=1))


def test_other_counts_are_free() -> None:
    assert replace(TINY, steps_per_update=7, episodes=9, evaluation_episodes=5).episodes == 9


@pytest.mark.parametrize(
    "given", [{"threshold": (0.5,)}, {"safety_seeds": (0, 3)}, {"finetune": False}]
)
def test_what_is_of_the_correction_needs_one(given: dict[str, object]) -> None:
    message = "^threshold, safety_seeds and finetune need a pretraining run: safety$"
    with pytest.raises(ValueError, match=message):
        replace(TINY, **given)  # type: ignore[arg-type]  # one of several types
    assert replace(BEHIND, **given) != BEHIND  # type: ignore[arg-type]  # one of several types


def test_numbers_of_seeds_and_thresholds_agree() -> None:
    with pytest.raises(ValueError, match="^1 safety_seeds for 2 seeds$"):
        replace(BEHIND, safety_seeds=(0,))
    with pytest.raises(ValueError, match="^3 thresholds for 2 seeds: give one, or one each$"):
        replace(BEHIND, threshold=(0.1, 0.2, 0.3))
    assert BEHIND.thresholds is None
    assert replace(BEHIND, threshold=(0.1,)).thresholds == (0.1, 0.1)
    assert replace(BEHIND, threshold=(0.1, 0.2)).thresholds == (0.1, 0.2)


def test_a_configuration_survives_json() -> None:
    given = replace(
        BEHIND, threshold=(0.1, 0.2), safety_seeds=(5, 5), finetune=True,
        method=SacSettings(hidden=(3, 4), temperature=0.1),
    )  # fmt: skip
    ruled = replace(TINY, rules=Rules("cost[1] > 3", time_limit=9))
    for config in (TrainConfig("brake"), TINY, given, ruled):
        assert (
            train_config_from_json(json.loads(json.dumps(train_config_to_json(config)))) == config
        )
    plain = train_config_to_json(given)
    assert (plain["safety"], plain["method"]["name"]) == ("safety", "sac")
    learner = build_task_learner(given, Sizes(2, 1))
    assert isinstance(learner, Sac)
    assert (learner.settings, learner.seeds) == (given.method, given.seeds)
    assert learner.policy.mlp.sizes == (2, 3, 4, 2)


@pytest.mark.parametrize("where", ["task", "method", "safety", "method.name", "method.gamma"])
def test_a_missing_entry_is_refused(where: str) -> None:
    plain = train_config_to_json(TINY)
    place = plain
    *outer, last = where.split(".")
    for name in outer:
        place = place[name]
    del place[last]
    with pytest.raises(ValueError, match=f"^not the configuration of a run: .*{last}"):
        train_config_from_json(plain)


def test_an_unknown_entry_is_refused() -> None:
    plain = train_config_to_json(TINY)
    unknown = plain["method"] | {"name": "dqn"}
    for wrong in ({"colour": 3}, {"method": unknown}, {"method": plain["method"] | {"b": 1}}):
        with pytest.raises(ValueError, match="^not the configuration of a run: '(colour|dqn|b)'"):
            train_config_from_json(plain | wrong)


def arrived(reward: float, cost: list[float], timeout: list[bool]) -> Arrived:
    """One step of two seeds' single copies, of which a violation ends the episode."""
    nothing = np.zeros((2, 1, 1), dtype=np.float32)
    costs = np.array(cost)[:, None]
    return Arrived(
        nothing, nothing, np.full((2, 1), reward), costs, costs > 0, np.array(timeout)[:, None]
    )


def test_counts_by_hand() -> None:
    counts = Counts.zero(2, 1)
    none, second = np.zeros((2, 1), dtype=bool), np.array([[False], [True]])
    counts.add(arrived(1.0, [0, 0], [False, False]), second)
    counts.add(arrived(2.0, [1, 0], [False, False]), second)
    assert counts.row(0, 4) == (1, 1, "0", "3", "2")
    assert counts.row(1, 4) == (0, 0, "0.5", "", "")
    counts.begin_row(4)
    counts = Counts.from_json(json.loads(json.dumps(counts.to_json())))
    counts.add(arrived(4.0, [0, 0], [False, True]), second)
    counts.add(arrived(5.0, [1, 1], [False, False]), none)
    assert counts.row(0, 6) == (2, 2, "0", "9", "2")
    assert counts.row(1, 6) == (2, 1, "0.5", "6", "2")  # 1 + 2 + 4 and 5, three steps and one
    assert counts.interventions.tolist() == [0, 3]
