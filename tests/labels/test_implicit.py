"""Transitions on the fly: the same answers as from a table, checks, files, interrupts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from dead_ends import INFINITE, Label, SafeMDP, classify
from dead_ends.io.labelling import survival_time_file
from dead_ends.labels.implicit import SURVIVES, classify_implicit, progress_bar
from dead_ends.model import memory


@njit
def successor(state, action, table, fail):
    if fail[state]:
        raise ValueError("successor called on a fail state")
    return table[state, action]


@njit
def is_fail(state, _table, fail):
    return fail[state]


def solve(table: np.ndarray, fail: np.ndarray, **options):
    return classify_implicit(
        successor, is_fail, *table.shape, data=(table.astype(np.int64), fail), **options
    )


def corridor(length: int) -> tuple[np.ndarray, np.ndarray]:
    """State s leads to s - 1, and 0 is fail."""
    states = np.arange(length + 1)
    return (states - 1)[:, None], states == 0


@st.composite
def tables(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    num_states, num_actions = draw(st.integers(1, 9)), draw(st.integers(1, 3))
    state = st.integers(0, num_states - 1)
    row = st.lists(state | st.just(-1), min_size=num_actions, max_size=num_actions)
    table = np.array([draw(row.filter(lambda r: max(r) >= 0)) for _ in range(num_states)])
    return table, np.array([draw(st.booleans()) for _ in range(num_states)])


@settings(max_examples=300, deadline=None)
@given(tables())
def test_the_answer_is_that_of_the_table(model) -> None:
    table, fail = model
    expected = classify(SafeMDP.deterministic(table, fail))
    result = solve(table, fail)
    time = expected.survival_time
    assert np.array_equal(result.survival_time, np.where(time == INFINITE, SURVIVES, time))
    assert np.array_equal(result.labels(), expected.labels)
    assert result.labels(np.array([0])).tolist() == [expected.labels[0]]
    assert (result.horizon, result.boundary_horizon) == (
        expected.horizon,
        expected.boundary_horizon,
    )
    assert result.counts == {label: expected.count(label) for label in Label}


def test_chunks_meet_without_a_gap(monkeypatch) -> None:
    monkeypatch.setattr("dead_ends.labels.implicit.CHUNK", 7)
    for length in (5, 6, 7, 20):
        result = solve(*corridor(length))
        assert result.survival_time.tolist() == list(range(length + 1))
        assert result.sweeps == 2  # upwards settles all, downwards finds nothing


def test_the_longest_time_that_two_bytes_hold() -> None:
    assert solve(*corridor(SURVIVES - 1)).horizon == SURVIVES - 1
    message = "state 65535 survives more than 65,534 steps, which two bytes do not hold"
    with pytest.raises(ValueError, match=message):
        solve(*corridor(SURVIVES))


@pytest.mark.parametrize("bad", [2, -2, 10**12])
def test_a_successor_out_of_range_is_named(bad: int) -> None:
    message = (
        f"state 0, action 1: successor {bad} is not a state "
        "(0 to 1, or -1 for an action that is not available)"
    )
    for first in (0, 1):  # a safe state, where only the last pass sees it, or another
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            solve(np.array([[first, bad], [0, 0]]), np.array([False, True]))


def test_a_state_without_an_action_is_named() -> None:
    message = (
        "state 1 has no action and does not fail; if the episode ends there without harm, "
        "let it lead to itself"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        solve(np.array([[0, 1], [-1, -1]]), np.array([False, False]))


def test_functions_must_be_compiled() -> None:
    with pytest.raises(ValueError, match=r"^successor must be compiled: decorate it with numba"):
        classify_implicit(max, is_fail, 1, 1)
    with pytest.raises(ValueError, match=r"^fail must be compiled: decorate it with numba\.njit$"):
        classify_implicit(successor, bool, 1, 1)


@pytest.mark.parametrize(("states", "actions"), [(0, 1), (1, 0)])
def test_an_empty_model_is_refused(states: int, actions: int) -> None:
    with pytest.raises(ValueError, match="^a model needs at least one state and one action$"):
        classify_implicit(successor, is_fail, states, actions)


def test_what_does_not_fit_the_memory_is_refused_before_it_starts(monkeypatch) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: 2**30)
    message = "labelling 1,000,000,000 states needs 1.9 GiB of memory, 1.0 are available"
    with pytest.raises(MemoryError, match=f"^{re.escape(message)}$"):
        classify_implicit(successor, is_fail, 10**9, 4)


def test_available_memory_is_read_from_the_system(monkeypatch, tmp_path: Path) -> None:
    path = tmp_path / "meminfo"
    path.write_text("MemTotal:  9 kB\nMemAvailable:   3 kB\n")
    monkeypatch.setattr(memory, "MEMINFO", path)
    assert memory.available_memory() == 3072
    path.write_text("MemTotal:  9 kB\n")
    assert memory.available_memory() is None
    path.unlink()
    assert memory.available_memory() is None
    memory.require_memory(10**18, "anything")  # nobody knows: try


def test_times_are_written_to_a_file(tmp_path: Path) -> None:
    out = tmp_path / "times.npy"
    with survival_time_file(out, 101) as times:
        result = solve(*corridor(100), times=times)
    assert isinstance(result.survival_time, np.memmap)
    assert np.load(out).tolist() == list(range(101)) == result.survival_time.tolist()
    with pytest.raises(ValueError, match="read-only"):
        result.survival_time[0] = 1


class Interrupted(BaseException):
    """Stands for KeyboardInterrupt, which would end the test run."""


def test_an_interrupt_leaves_no_file(tmp_path: Path) -> None:
    def interrupt(*_: int) -> None:
        raise Interrupted

    old = tmp_path / "old.npy"
    old.write_bytes(b"as it was")
    for out in (tmp_path / "new.npy", old):
        with pytest.raises(Interrupted), survival_time_file(out, 101) as times:
            solve(*corridor(100), times=times, progress=interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["old.npy"]
    assert old.read_bytes() == b"as it was"


def test_progress_is_reported_chunk_by_chunk(monkeypatch) -> None:
    monkeypatch.setattr("dead_ends.labels.implicit.CHUNK", 4)
    reports: list[tuple[int, int, int]] = []
    solve(*corridor(9), progress=lambda *report: reports.append(report))
    assert reports == [(1, 4, 4), (1, 8, 8), (1, 10, 10), (2, 2, 10), (2, 6, 10), (2, 10, 10)]


def test_the_progress_bar_names_the_sweep(capsys) -> None:
    with progress_bar(101) as progress:
        solve(*corridor(100), progress=progress)
    assert "sweep 2, 101 settled" in capsys.readouterr().err
