"""Offline data: what is collected, kept, written and read; and what is refused."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import ClassVar

import h5py
import numpy as np
import pytest

from deep.collect import (
    Source,
    collect,
    collect_mix,
    corner_policy,
    random_policy,
    sb3_policy,
    towards_obstacle_policy,
    uniform_starts,
)
from deep.data import (
    Transitions,
    concatenate,
    cut_at_violation,
    keep_before_violation,
    summarise,
)
from deep.formats import from_minari, read_hdf5, to_minari, write_hdf5
from deep.tasks import Brake, make_task, navigation2
from deep.tasks.shapes import inside_any

BRAKE = Brake()


def brake_data(seed: int = 0, transitions: int = 2000) -> Transitions:
    return collect(BRAKE, random_policy(BRAKE), np.random.default_rng(seed), transitions)


def episode(costs: list[int], timeout: bool = False) -> dict[str, np.ndarray]:
    """Raw columns of one episode whose observations count its rows."""
    n = len(costs)
    last = np.arange(n) == n - 1
    return {
        "observations": np.arange(n)[:, None] * 1.0,
        "actions": np.zeros((n, 1)),
        "next_observations": np.arange(1, n + 1)[:, None] * 1.0,
        "rewards": np.ones(n),
        "costs": np.array(costs, dtype=float),
        "terminals": last & (not timeout),
        "timeouts": last & timeout,
    }


def joined(*episodes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([e[name] for e in episodes]) for name in episodes[0]}


def same(a: Transitions, b: Transitions) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Transitions))


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
    monkeypatch.setattr("deep.collect.LARGEST", 512)
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
    "observations: row 1 holds a NaN": ("observations", [[0.0], [np.nan], [2.0]]),
    "actions: row 2 holds a NaN or an infinity": ("actions", [[0.0], [0.0], [np.inf]]),
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


def test_no_data_are_refused() -> None:
    empty = {name: column[:0] for name, column in episode([1]).items()}
    with pytest.raises(ValueError, match="the data hold no transition"):
        Transitions(**empty)


def test_episodes_that_go_on_can_be_cut() -> None:
    raw = joined(episode([0, 1, 0, 1]), episode([0, 0], timeout=True), episode([1, 1, 0]))
    cut = Transitions(**cut_at_violation(raw))
    assert cut.costs.tolist() == [0, 1, 0, 0, 1]
    assert cut.terminals.tolist() == [False, True, False, False, True]
    assert cut.timeouts.tolist() == [False, False, False, True, False]


def test_data_are_read_only() -> None:
    data = Transitions(**episode([0, 1]))
    with pytest.raises(ValueError, match="read-only"):
        data.costs[0] = 1


def test_hdf5_round_trip_and_another_projects_file(tmp_path: Path) -> None:
    data = brake_data()
    path = tmp_path / "brake.hdf5"
    write_hdf5(data, path)
    assert same(read_hdf5(path), data)
    # Somebody else's: float64, (N, 1) columns, no next_observations, costs after a violation.
    raw = joined(episode([0, 1, 0]), episode([0, 0], timeout=True), episode([0, 1]))
    with h5py.File(path, "w") as file:
        for name, column in raw.items():
            if name != "next_observations":
                file[name] = column[:, None] if name == "costs" else column
    with pytest.raises(ValueError, match="brake.hdf5: costs: row 1 is a violation"):
        read_hdf5(path)
    read = read_hdf5(path, cut=True)
    assert read.costs.tolist() == [0, 1, 0, 0, 1]
    # The row that was cut off has no successor in the file: it is dropped.
    assert read.observations[:, 0].tolist() == [0, 1, 0, 0, 1]
    assert read.next_observations[[0, 2, 3], 0].tolist() == [1, 1, 1]
    assert read.timeouts.tolist() == [False, False, True, False, False]


def test_files_that_are_something_else_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no such file"):
        read_hdf5(tmp_path / "absent.hdf5")
    text = tmp_path / "text.hdf5"
    text.write_text("hello")
    with pytest.raises(ValueError, match="not an HDF5 file"):
        read_hdf5(text)
    partial = tmp_path / "partial.hdf5"
    with h5py.File(partial, "w") as file:
        file["observations"] = np.zeros((3, 1))
    with pytest.raises(ValueError, match="the data sets actions, rewards, costs, terminals"):
        read_hdf5(partial)
    ragged = tmp_path / "ragged.hdf5"
    with h5py.File(ragged, "w") as file:
        for name, column in episode([0, 0, 1]).items():
            file[name] = column[:2] if name == "rewards" else column
    with pytest.raises(ValueError, match="differ in length"):
        read_hdf5(ragged)


def test_minari_round_trip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    raw = joined(episode([0, 0, 1]), episode([0, 0], timeout=True), episode([1]))
    data = Transitions(**raw)
    dataset = to_minari(data, "deep/test-v0")
    assert dataset.total_episodes == 3
    assert same(from_minari(dataset), data)


def test_minari_episodes_without_costs_are_refused() -> None:
    class Episode:
        id = 4
        infos: ClassVar[dict[str, object]] = {}
        rewards = np.zeros(2)

    class Dataset:
        def iterate_episodes(self) -> list[Episode]:
            return [Episode()]

    with pytest.raises(ValueError, match=r"episode 4: there is no infos\['cost'\]"):
        from_minari(Dataset())  # type: ignore[arg-type]  # a stand-in
    Episode.infos = {"cost": np.zeros(5)}
    with pytest.raises(ValueError, match="episode 4: 5 costs for 2 steps"):
        from_minari(Dataset())  # type: ignore[arg-type]  # a stand-in
