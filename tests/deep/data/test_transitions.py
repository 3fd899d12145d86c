"""Offline data: what is collected and kept; and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deep.data.collect import (
    Source,
    collect,
    collect_mix,
    corner_policy,
    random_policy,
    sb3_policy,
    towards_obstacle_policy,
    uniform_starts,
)
from deep.data.transitions import (
    Transitions,
    concatenate,
    cut_at_violation,
    keep_before_violation,
    summarise,
)
from deep.tasks import make_task, navigation2
from deep.tasks.shapes import inside_any
from tests.deep.recordings import BRAKE, brake_data, episode, joined, same


def test_only_arrays_that_may_change_are_copied() -> None:
    columns = episode([0, 0, 1])
    data = Transitions(**columns)
    columns["observations"][0] = 9.0
    assert data.observations[0] == 0.0
    assert not data.observations.flags.writeable
    again = replace(data, rewards=np.zeros(3))
    assert again.observations is data.observations
    assert not again.rewards.flags.writeable


def test_collected_transitions_are_steps_of_the_task() -> None:
    data = brake_data()
    state = (data.observations.astype(float) + 1) / 2 * BRAKE.high
    step = BRAKE.step(state, data.actions, np.random.default_rng(0))
    # Observations are float32: compare off the boundary only.
    clear = np.abs(step.next_state[:, 0]) > 1e-3
    assert np.allclose(BRAKE.observe(step.next_state), data.next_observations, atol=1e-5)
    assert np.array_equal(step.violation[clear], data.costs[clear] == 1)
    # Inside an episode the rows follow each other.
    inside = ~data.ends[:-1]
    assert np.array_equal(data.next_observations[:-1][inside], data.observations[1:][inside])
    assert data.ends[-1]
    assert np.array_equal(data.terminals, data.costs == 1)


def test_episodes_are_cut_where_asked_and_by_the_time_limit() -> None:
    rng = np.random.default_rng(0)
    short = collect(BRAKE, random_policy(BRAKE), rng, 1000, max_steps=2)
    ends = np.flatnonzero(short.ends)
    assert np.diff(ends, prepend=-1).max() == 2
    assert (short.timeouts & ~short.terminals).any()
    with pytest.raises(ValueError, match="must be at least 1"):
        collect(BRAKE, random_policy(BRAKE), rng, 0)


def test_collection_is_reproducible() -> None:
    assert same(brake_data(3), brake_data(3))
    assert not same(brake_data(3), brake_data(4))


def test_the_filter_keeps_the_steps_before_violations_only() -> None:
    raw = joined(episode([0, 0, 0, 1]), episode([0, 0], timeout=True), episode([1]))
    data = Transitions(**raw)
    kept = keep_before_violation(data, 2)
    assert kept.observations[:, 0].tolist() == [2, 3, 0]
    assert keep_before_violation(data, 100).costs.tolist() == [0, 0, 0, 1, 1]
    assert keep_before_violation(data, None) is data
    with pytest.raises(ValueError, match="keep at least 1 step before a violation, not 0"):
        keep_before_violation(data, 0)


def test_an_unfinished_last_episode_is_no_violation() -> None:
    raw = joined(episode([0, 1]), episode([0, 0]))
    raw["terminals"][-1] = False
    assert len(keep_before_violation(Transitions(**raw), 5)) == 2


def test_a_mix_has_the_stated_shares_after_the_filter() -> None:
    sources = [
        Source(random_policy(BRAKE), 0.25),
        Source(corner_policy(BRAKE), 0.5, keep=5),
        Source(towards_obstacle_policy(BRAKE), 0.25, starts=uniform_starts(BRAKE)),
    ]
    data = collect_mix(BRAKE, sources, np.random.default_rng(0), 4000)
    assert len(data) == 4000
    actions = data.actions[:, 0]
    assert (np.abs(actions[:1000]) < 1).all()
    assert set(np.unique(actions[1000:3000])) == {-1.0, 1.0}
    assert (actions[3000:] == 1).all()
    assert data.ends[[999, 2999, 3999]].all()  # a part's last episode is cut off


def test_shares_that_do_not_sum_to_one_are_refused() -> None:
    with pytest.raises(ValueError, match=r"sum to 1, not to 0\.7"):
        collect_mix(BRAKE, [Source(random_policy(BRAKE), 0.7)], np.random.default_rng(0), 10)


def test_a_source_without_violations_is_refused() -> None:
    task = navigation2()  # the block is 20 steps away; random walkers do not find it
    source = Source(random_policy(task), 1.0, max_steps=3)
    message = "navigation2: of 51,100 transitions too few lie within 100 steps before a violation"
    with pytest.raises(ValueError, match=message):
        collect_mix(task, [source], np.random.default_rng(0), 100)
    with pytest.raises(ValueError, match="there is no violation in the data"):
        collect_mix(task, [replace(source, keep=None)], np.random.default_rng(0), 100)


def test_rare_violations_are_waited_for() -> None:
    task = make_task("static-env")  # once in 4,500 steps of random actions
    data = collect_mix(task, [Source(random_policy(task), 1.0)], np.random.default_rng(0), 300)
    assert len(data) == 300
    assert 3 <= data.costs.sum() <= 5


def test_the_largest_draws_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    source = Source(random_policy(BRAKE), 1.0, keep=1)
    monkeypatch.setattr("deep.data.collect.LARGEST", 512)
    data = collect_mix(BRAKE, [source], np.random.default_rng(0), 200)
    assert len(data) == 200
    assert (data.costs == 1).all()
    assert len(np.unique(data.actions)) == 200  # no draw is there twice


def test_uniform_starts_cover_the_box_outside_obstacles() -> None:
    task = make_task("dubins")
    state = uniform_starts(task)(np.random.default_rng(0), 3000)
    assert not inside_any(task.obstacles, task.position(state)).any()
    assert (state.max(axis=0) > 0.95 * task.high).all()


def test_a_stable_baselines_model_is_a_policy() -> None:
    class Model:
        def predict(self, observation: np.ndarray, *, deterministic: bool) -> tuple[object, None]:
            assert deterministic
            return np.full((len(observation), 1), 0.25), None

    data = collect(BRAKE, sb3_policy(Model(), deterministic=True), np.random.default_rng(0), 500)
    assert (data.actions == 0.25).all()


def test_concatenation_ends_each_part() -> None:
    first, second = episode([0, 1]), episode([1])
    unfinished = joined(first, episode([0]))
    unfinished["terminals"][-1] = False
    both = concatenate([Transitions(**unfinished), Transitions(**second)])
    assert both.timeouts.tolist() == [False, False, True, False]
    wide = replace(Transitions(**second), actions=np.zeros((1, 2), dtype=np.float32))
    with pytest.raises(ValueError, match="the parts differ"):
        concatenate([Transitions(**second), wide])
    with pytest.raises(ValueError, match="nothing to concatenate"):
        concatenate([])


def test_the_summary_counts() -> None:
    raw = joined(episode([0, 0, 0, 1]), episode([0, 0], timeout=True))
    summary = summarise(Transitions(**raw))
    assert (summary.transitions, summary.episodes) == (6, 2)
    assert (summary.violations, summary.timeouts) == (1, 1)
    assert (summary.mean_length, summary.mean_return) == (3.0, 3.0)
    assert "6 transitions in 2 episodes (3.0 steps each), 1 violations" in str(summary)


BAD = {
    "costs: row 1 is 0.5; a cost is 1 at a violation": ("costs", [0, 0.5, 1]),
    "there is no violation in the data": ("costs", [0, 0, 0]),
    "costs: row 1 is a violation but its episode goes on": ("costs", [0, 1, 1]),
    "observations: row 1, column 0 is nan, not a finite": ("observations", [[0], [np.nan], [2]]),
    "actions: row 2, column 0 is inf": ("actions", [[0.0], [0.0], [np.inf]]),
    r"rewards: row 1 is 1e\+300, not a finite number of float32's": ("rewards", [0, 1e300, 0]),
    "next_observations: row 0, column 0 is nan": ("next_observations", [[np.nan], [1], [2]]),
    "costs: row 2 is nan": ("costs", [0, 0, np.nan]),
    "terminals: row 1 is nan, not 1 where an episode ends, else 0": ("terminals", [0, np.nan, 1]),
    "timeouts: row 0 is 2.0, not 1 where": ("timeouts", [2.0, 0, 1]),
    "costs: row 0 has 2 costs, one for each of several constraints": ("costs", [[0, 1]] * 3),
    "rewards: the values are of type complex128, not real numbers": ("rewards", [0j, 1j, 0j]),
    "actions: the values are of type <U3, not real numbers": ("actions", [["0.0"]] * 3),
    "rewards: the values are of type object": ("rewards", [None, 1.0, 2.0]),
    r"rewards has shape \(2,\), expected \(3,\)": ("rewards", [0.0, 0.0]),
    r"actions has shape \(2, 1\), expected \(3, 1\)": ("actions", [[0.0], [0.0]]),
    "next_observations have shape": ("next_observations", [[0.0, 1.0]] * 3),
    "must have shapes": ("observations", [0.0, 1.0, 2.0]),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_data_are_refused(message: str) -> None:
    name, value = BAD[message]
    with pytest.raises(ValueError, match=message):
        Transitions(**(episode([0, 0, 1]) | {name: np.array(value)}))


def test_what_is_masked_or_ragged_is_refused() -> None:
    masked = np.ma.array([0.0, 1.0, 2.0], mask=[False, True, False])  # type: ignore[no-untyped-call]  # numpy's
    with pytest.raises(ValueError, match="^rewards: row 1 is masked$"):
        Transitions(**(episode([0, 0, 1]) | {"rewards": masked}))
    with pytest.raises(ValueError, match="^actions: rows differ in length"):
        Transitions(**(episode([0, 0, 1]) | {"actions": [[0.0], [1.0, 2.0], [0.0]]}))


def test_no_data_are_refused() -> None:
    empty = {name: column[:0] for name, column in episode([1]).items()}
    with pytest.raises(ValueError, match="the data hold no transition"):
        Transitions(**empty)


def test_cutting_keeps_every_violation() -> None:
    raw = joined(episode([0, 1, 0, 0, 1]), episode([0, 0], timeout=True), episode([1, 1, 0]))
    cut = Transitions(**cut_at_violation(raw))
    # Only the rows that lead out of a violating state are dropped: one of each long episode.
    assert cut.observations[:, 0].tolist() == [0, 1, 3, 4, 0, 1, 0, 1]
    assert cut.costs.tolist() == [0, 1, 0, 1, 0, 0, 1, 1]
    assert cut.terminals.tolist() == (cut.costs == 1).tolist()
    assert cut.timeouts.tolist() == [False] * 5 + [True, False, False]


def test_episodes_that_go_on_after_violations_are_counted() -> None:
    message = "row 1 is a violation .* as after 2 of 3 violations; --cut"
    with pytest.raises(ValueError, match=message):
        Transitions(**episode([0, 1, 1, 0, 0, 1]))


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30))
def test_cutting_loses_neither_violations_nor_rows_from_states_that_had_not_failed(
    rows: list[tuple[bool, bool]],
) -> None:
    costs, ends = map(np.array, zip(*rows, strict=True))
    raw = episode(costs.tolist()) | {"terminals": np.zeros(len(rows)), "timeouts": ends}
    cut = cut_at_violation(raw)
    kept = cut["observations"][:, 0].astype(int)
    for row in range(len(rows)):
        failed = row > 0 and costs[row - 1] and not ends[row - 1]
        assert (row in kept) == (costs[row] or not failed)
    assert (cut["terminals"] == (cut["costs"] == 1)).all()
    # What is kept between two ends followed each other in the recording.
    inside = ~(cut["terminals"] | cut["timeouts"])[:-1]
    assert (np.diff(kept)[inside] == 1).all()


def test_data_are_read_only() -> None:
    data = Transitions(**episode([0, 1]))
    with pytest.raises(ValueError, match="read-only"):
        data.costs[0] = 1
