"""Files are whole or absent."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dead_ends.io.atomic import atomic_path, check_target


def test_success_replaces_the_file(tmp_path: Path) -> None:
    target = tmp_path / "labels.csv"
    target.write_text("old")
    with atomic_path(target) as temporary:
        assert temporary.suffix == ".csv"
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_everything_as_it_was(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "labels.csv"
    target.write_text("old")
    with pytest.raises(error), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_file_is_as_readable_as_any_other(tmp_path: Path) -> None:
    plain, target = tmp_path / "plain", tmp_path / "target"
    plain.write_text("")
    with atomic_path(target) as temporary:
        temporary.write_text("")
    assert target.stat().st_mode == plain.stat().st_mode


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    missing = atomic_path(tmp_path / "nowhere" / "labels.csv")
    with pytest.raises(ValueError, match=r"the folder .*nowhere does not exist"), missing:
        pass


KILLED = """
import os, signal, sys
from dead_ends.io.atomic import atomic_path, check_target
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("half")
    if sys.argv[2] == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    print(flush=True)
    sys.stdin.read()
"""


def writer(target: Path, fate: str) -> subprocess.Popen[bytes]:
    """Another process that writes half of a file."""
    command = [sys.executable, "-c", KILLED, str(target), fate]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path: Path) -> None:
    target = tmp_path / "labels.csv"
    with writer(target, "dies") as process:
        assert process.wait() == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    with atomic_path(tmp_path / "other.csv") as temporary:  # not what belongs to another file
        temporary.write_text("")
    assert left.is_dir()
    with atomic_path(target) as temporary:
        temporary.write_text("whole")
    assert {path.name for path in tmp_path.iterdir()} == {"labels.csv", "other.csv"}


def test_what_a_live_process_writes_is_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "labels.csv"
    with writer(target, "waits") as process:
        assert process.stdout is not None
        process.stdout.readline()
        with atomic_path(target) as temporary:
            temporary.write_text("ours")
        assert target.read_text() == "ours"
        process.communicate()
        assert process.returncode == 0
    assert target.read_text() == "half"
    assert list(tmp_path.iterdir()) == [target]


def test_where_there_are_no_locks_nothing_is_taken_for_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "labels.csv"
    with writer(target, "dies") as process:
        process.wait()

    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("dead_ends.io.atomic.fcntl.flock", no_locks)
    with atomic_path(target) as temporary:
        temporary.write_text("whole")
    assert target.read_text() == "whole"
    assert len(list(tmp_path.iterdir())) == 2


def test_what_another_user_left_is_no_obstacle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = tmp_path / ".labels.csv-abcd1234.writing"
    theirs.mkdir()

    def forbidden(path: Any, *flags: Any, **where: Any) -> int:
        if path == theirs:
            raise PermissionError(errno.EACCES, "Permission denied")
        return really_open(path, *flags, **where)

    really_open = os.open
    monkeypatch.setattr("dead_ends.io.atomic.os.open", forbidden)
    with atomic_path(tmp_path / "labels.csv") as temporary:
        temporary.write_text("whole")
    assert {path.name for path in tmp_path.iterdir()} == {"labels.csv", theirs.name}


def test_folders_of_similar_names_are_not_ours(tmp_path: Path) -> None:
    mine = tmp_path / ".labels.csv-old.writing"
    mine.mkdir()
    with atomic_path(tmp_path / "labels.csv") as temporary:
        temporary.write_text("")
    assert mine.is_dir()


def test_a_name_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="^the name of the file to write is empty$"):
        check_target("")
    for folder in (tmp_path, Path()):
        with pytest.raises(ValueError, match=r"is a folder, not a file to write$"):
            check_target(folder)


def test_an_input_is_known_by_all_its_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, other = tmp_path / "model.npz", tmp_path / "other.npz"
    for path in (source, other):
        path.write_text("")
    (tmp_path / "link.npz").symlink_to(source)
    (tmp_path / "hard.npz").hardlink_to(source)
    monkeypatch.chdir(tmp_path)
    for name in (source, "model.npz", "./model.npz", "link.npz", "hard.npz"):
        with pytest.raises(ValueError, match=r"is read as input \(.*model.npz\) and would be"):
            check_target(name, other, source)
    check_target("new.npz", source)
    check_target(other, source, "missing.npz")
