"""Safety filters as files: round trips, readers without this package, every error."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dead_ends.safety.filter_table import FilterTable, load_filter, save_filter

ALLOWED = np.array([[True, False], [False, True], [False, False]])
RECOVERY = np.array([0, 1, 1])
METADATA = {"epsilon_safe": 0.5, "made by": "a test", "é": [1, None]}


@pytest.mark.parametrize("name", ["filter.npz", "filter.json"])
def test_what_was_saved_is_loaded(tmp_path: Path, name: str) -> None:
    save_filter(FilterTable(ALLOWED, RECOVERY, METADATA), tmp_path / name)
    table = load_filter(tmp_path / name)
    np.testing.assert_array_equal(table.allowed, ALLOWED)
    np.testing.assert_array_equal(table.recovery, RECOVERY)
    assert table.metadata == METADATA
    assert table.allowed.dtype == np.bool_
    assert table.recovery.dtype == np.int64
    assert not table.allowed.flags.writeable
    assert not table.recovery.flags.writeable
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_npz_needs_numpy_only(tmp_path: Path) -> None:
    save_filter(FilterTable(ALLOWED, RECOVERY, METADATA), tmp_path / "filter.npz")
    with np.load(tmp_path / "filter.npz", allow_pickle=False) as archive:
        assert sorted(archive.files) == ["allowed", "metadata", "recovery"]
        np.testing.assert_array_equal(archive["allowed"], ALLOWED)
        assert json.loads(str(archive["metadata"])) == METADATA


def test_json_needs_a_json_reader_only(tmp_path: Path) -> None:
    save_filter(FilterTable(ALLOWED, RECOVERY), tmp_path / "filter.json")
    assert json.loads((tmp_path / "filter.json").read_text()) == {
        "allowed": [[True, False], [False, True], [False, False]],
        "recovery": [0, 1, 1],
        "metadata": {},
    }


@pytest.mark.parametrize(
    ("allowed", "recovery", "message"),
    [
        (ALLOWED.astype(int), RECOVERY, r"allowed must be boolean, not int64"),
        (ALLOWED[0], RECOVERY, r"allowed must have shape \(S, A\), not \(2,\)"),
        (ALLOWED[:0], RECOVERY, r"allowed must have shape \(S, A\), not \(0, 2\)"),
        (ALLOWED, RECOVERY * 0.5, r"recovery must be integers of shape \(3,\), not float64 of "),
        (
            ALLOWED,
            RECOVERY[:2],
            r"recovery must be integers of shape \(3,\), not int64 of shape \(2,\)",
        ),
        (ALLOWED, [0, 2, 1], r"recovery: state 1: there is no action 2 \(0 to 1\)"),
        (ALLOWED, [0, 1, -1], r"recovery: state 2: there is no action -1 \(0 to 1\)"),
    ],
)
def test_wrong_tables_are_refused(allowed: Any, recovery: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FilterTable(np.asarray(allowed), np.asarray(recovery))


def test_metadata_must_be_json(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"metadata: Object of type object is not JSON"):
        save_filter(FilterTable(ALLOWED, RECOVERY, {"a": object()}), tmp_path / "filter.npz")
    assert not list(tmp_path.iterdir())


NAMES = {
    "state_names": ("door", "hall", "é"),
    "action_names": ("keep still", "go"),
    "keys": ("0", "(1, 2.5)"),
}


@pytest.mark.parametrize("name", ["filter.npz", "filter.json"])
def test_names_and_keys_are_kept(tmp_path: Path, name: str) -> None:
    save_filter(FilterTable(ALLOWED, RECOVERY, **NAMES), tmp_path / name)
    table = load_filter(tmp_path / name)
    assert {each: getattr(table, each) for each in NAMES} == NAMES
    assert [table.find(key) for key in (0, [1.0, 2.5], np.array([1, 2.5]), 1)] == [0, 1, 1, None]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"state_names": ["a", "b"]}, "state_names must have 3 entries, not 2"),
        ({"action_names": "ab"}, "action_names must be a list of strings"),
        ({"action_names": ["a", 1]}, "action_names must be a list of strings"),
        ({"keys": ["0", "1", "2", "3"]}, "keys must have 3 entries, not 4"),
        ({"keys": ["0", "0"]}, "keys: two states have the same key"),
    ],
)
def test_wrong_names_are_refused(tmp_path: Path, names: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FilterTable(ALLOWED, RECOVERY, **names)
    arrays = {"allowed": ALLOWED, "recovery": RECOVERY, "metadata": "{}"}
    np.savez(tmp_path / "filter.npz", **arrays, **{k: np.array(v) for k, v in names.items()})
    if names != {"action_names": ["a", 1]}:  # NumPy makes strings of both
        with pytest.raises(ValueError, match=rf"filter\.npz: {message}"):
            load_filter(tmp_path / "filter.npz")


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"filter\.csv: a filter's name must end in \.npz or"):
        save_filter(FilterTable(ALLOWED, RECOVERY), tmp_path / "filter.csv")
    with pytest.raises(ValueError, match=r"filter: a filter's name must end in \.npz or \.json"):
        load_filter(tmp_path / "filter")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", r"filter\.json: the file does not hold a JSON object"),
        ('{"allowed": [[true', r"filter\.json: Expecting .* line 1 column"),
        ('{"allowed": [[true]]}', r"filter\.json: key 'recovery' is missing"),
        (
            '{"allowed": [[1]], "recovery": [0], "metadata": {}}',
            r"filter\.json: allowed must be boolean, not int64",
        ),
        (
            '{"allowed": [[true], [true, false]], "recovery": [0, 0], "metadata": {}}',
            r"filter\.json: .*inhomogeneous",
        ),
        (
            '{"allowed": [[true]], "recovery": [0], "metadata": 3}',
            r"filter\.json: metadata must be an object of JSON, not 3",
        ),
    ],
)
def test_bad_json_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "filter.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_filter(tmp_path / "filter.json")


def test_bad_npz_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "filter.npz"
    path.write_bytes(b"no zip file")
    with pytest.raises(ValueError, match=r"filter\.npz: not an npz file"):
        load_filter(path)
    np.savez(path, allowed=ALLOWED, recovery=RECOVERY)
    with pytest.raises(ValueError, match=r"filter\.npz: key 'metadata' is missing"):
        load_filter(path)
    np.savez(path, allowed=ALLOWED, recovery=RECOVERY, metadata=np.array("{"))
    with pytest.raises(ValueError, match=r"filter\.npz: metadata: Expecting property name"):
        load_filter(path)


def test_a_missing_file_is_an_os_error(tmp_path: Path) -> None:
    for name in ("filter.npz", "filter.json"):
        with pytest.raises(FileNotFoundError):
            load_filter(tmp_path / name)
