"""Files are whole or absent."""

from __future__ import annotations

from pathlib import Path

import pytest

from dead_ends.io.atomic import atomic_path


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
