"""npz files: round trips, the smallest file, and what is said about bad ones."""

import io
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dead_ends.io.npz import load_npz, save_npz
from dead_ends.model.safe_mdp import Geometry, SafeMDP

TABLE = np.array([[0, 1], [2, 2], [-1, -1], [3, 3]], dtype=np.int32)
FAIL = np.array([False, False, True, False])
GOAL = np.array([False, False, False, True])


def everything() -> dict[str, Any]:
    return {
        "terminal": GOAL,
        "rewards": np.arange(8.0).reshape(4, 2),
        "initial": [0, 1],
        "state_names": ["start", "edge", "cliff", "goal ★"],
        "action_names": ["stay", "go"],
        "geometry": Geometry(
            cell=np.array([[0, 0], [1, 0], [2, 0], [-1, -1]]),
            x_label="distance [m]",
            y_label="speed [m/s]",
            origin=(0.5, -1.0),
            step=(2.0, 0.25),
            y_down=True,
            walls=((3, 1), (4, 1)),
            arrows=((0.0, 0.0), (1.0, -0.5)),
        ),
    }


def assert_same(first: SafeMDP, second: SafeMDP) -> None:
    assert first.is_deterministic == second.is_deterministic
    assert (first.transitions() != second.transitions()).nnz == 0
    assert first.exact == second.exact
    for name in ("fail", "terminal", "available", "rewards", "initial"):
        ours, theirs = getattr(first, name), getattr(second, name)
        assert (ours is None) == (theirs is None), name
        assert ours is None or np.array_equal(ours, theirs), name
    assert first.state_names == second.state_names
    assert first.action_names == second.action_names
    if first.geometry is None or second.geometry is None:
        assert first.geometry is second.geometry
        return
    assert np.array_equal(first.geometry.cell, second.geometry.cell)
    for name in ("x_label", "y_label", "origin", "step", "y_down", "walls", "arrows"):
        assert getattr(first.geometry, name) == getattr(second.geometry, name), name


def stochastic(number: Any) -> SafeMDP:
    P = np.full((4, 2, 4), number(0), dtype=object if number is Fraction else float)
    P[0, 0, 0] = P[0, 0, 1] = number(1) / 2
    P[1, 1, 2], P[1, 1, 3] = number(1) / 4, 3 * number(1) / 4
    available = np.array([[True, False], [False, True], [False, False], [False, False]])
    return SafeMDP.stochastic(P, FAIL, available, **everything())


@pytest.mark.parametrize(
    "model",
    [
        SafeMDP.deterministic(TABLE, FAIL),
        SafeMDP.deterministic(TABLE, FAIL, **everything()),
        SafeMDP.deterministic(TABLE, FAIL, geometry=Geometry(cell=np.zeros((4, 2)))),
        stochastic(float),
        stochastic(Fraction),
    ],
    ids=["smallest", "everything", "bare geometry", "floats", "fractions"],
)
def test_round_trip(model: SafeMDP, tmp_path: Path) -> None:
    save_npz(model, tmp_path / "model.npz")
    assert_same(load_npz(tmp_path / "model.npz"), model)
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]


def test_files_written_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    np.savez(path, next_state=TABLE.astype(np.int64), fail=FAIL)
    assert_same(load_npz(path), SafeMDP.deterministic(TABLE, FAIL))
    P = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    fail = np.array([False, True])
    np.savez(path, P=P, fail=fail)
    assert_same(load_npz(path), SafeMDP.stochastic(P, fail))
    np.savez(path, P_exact=["1/3", "2/3"], P_indices=[0, 1], P_indptr=[0, 2, 2], fail=fail)
    assert load_npz(path).exact == (Fraction(1, 3), Fraction(2, 3))
    np.savez(path, P_data=[0.25, 0.75], P_indices=[0, 1], P_indptr=[0, 2, 2], fail=fail)
    assert load_npz(path).transitions().data.tolist() == [0.25, 0.75]


CSR = {"P_data": [1.0], "P_indices": [0], "P_indptr": [0, 1]}
ONE = np.array([False])
EXACT = {"P_indptr": [0, 1], "P_indices": [0], "fail": ONE}
BARE = {"next_state": TABLE, "fail": FAIL}
DRAWN = {**BARE, "geometry_cell": np.zeros((4, 2), dtype=np.int32)}


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"next_state": TABLE}, "no array 'fail'"),
        ({"fail": FAIL}, "exactly one of .* found none of them"),
        ({"next_state": TABLE, "P": np.eye(4), "fail": FAIL}, "found next_state, P"),
        ({"next_state": TABLE, "fail": FAIL, "goal": GOAL}, "unknown array 'goal'"),
        ({"next_state": TABLE, "fail": FAIL * 1}, "fail must be a boolean mask, not int64"),
        ({"next_state": TABLE, "fail": FAIL[:3]}, "fail must have shape"),
        ({"next_state": TABLE + 1, "fail": FAIL}, "state 3, action 0: successor 4 is not a state"),
        ({"next_state": TABLE * 1.0, "fail": FAIL}, "next_state must hold integers"),
        ({"next_state": TABLE, "fail": FAIL, "available": TABLE >= 0}, "'available' has no mean"),
        ({"next_state": TABLE, "fail": FAIL, "state_names": [1, 2]}, "state_names must be a list"),
        ({"next_state": TABLE, "fail": FAIL, "state_names": ["a"]}, "state_names: expected 4"),
        ({"next_state": TABLE, "fail": np.array([None])}, "array 'fail': .*allow_pickle"),
        ({"P": np.eye(4), "fail": FAIL}, "P must be dense with shape"),
        ({**CSR, "fail": ONE, "P_data": [0.5]}, "state 0, action 0: probabilities sum to 0.5"),
        ({**CSR, "fail": ONE, "P_data": [[1.0]]}, "P_data must have one dimension"),
        ({**CSR, "fail": ONE, "P_data": [1.0, 1.0]}, "P_data has 2 entries, P_indices 1"),
        ({**CSR, "fail": ONE, "P_indices": [1.0]}, "P_indices must hold integers"),
        ({**CSR, "fail": ONE, "P_indices": [1]}, "P_data, P_indices, P_indptr: .*ind"),
        ({**CSR, "fail": ONE, "P_indptr": [0, 2]}, "P_data, P_indices, P_indptr: .*"),
        ({**CSR, "fail": FAIL}, "P_indptr must have S.A . 1 entries for S = 4, not 2"),
        ({**CSR, "fail": np.zeros(0, dtype=bool)}, "P_indptr must have"),
        ({"P_indptr": [0, 1], "fail": ONE}, "no array 'P_data'"),
        ({"P_indptr": [0, 1], "P_indices": [0], "P_exact": ["x"], "fail": ONE}, "'x' is not a fr"),
        ({"P_indptr": [0, 1], "P_indices": [0], "P_exact": ["1/0"], "fail": ONE}, "'1/0' is not"),
        ({"P_indptr": [0, 1], "P_indices": [0], "P_exact": ["1/2"], "fail": ONE}, "not exactly 1"),
        (
            {**EXACT, "P_exact": ["1e-999999999"]},
            "too many",
        ),
        (
            {**EXACT, "P_exact": ["9" * 5000]},
            "'999.*9...' is",
        ),
        (
            {**EXACT, "P_exact": ["9" * 10**6]},
            "P_exact holds s",
        ),
        ({**BARE, "geometry_y_down": True}, "no array 'geometry_cell'"),
        ({**BARE, "geometry_cell": [[0, 0]]}, "geometry: expected 4 cells, got 1"),
        ({**BARE, "geometry_cell": [0]}, r"geometry: cell must have shape \(S, 2\)"),
        ({**DRAWN, "geometry_x_label": 3}, "geometry_x_label: expected one string"),
        ({**DRAWN, "geometry_y_down": 3}, "geometry_y_down: expected one bool"),
        ({**DRAWN, "geometry_origin": 3}, "geometry_origin: expected two numbers"),
        ({**DRAWN, "geometry_walls": [3]}, r"geometry_walls: expected shape \(n, 2\)"),
    ],
)
def test_bad_arrays_are_named(arrays: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=message) as caught:
        load_npz(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("keep", [0, 10, 200, -1, -30])
def test_truncated_files(keep: int, tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    save_npz(SafeMDP.deterministic(TABLE, FAIL), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match="not an npz file, or it is truncated"):
        load_npz(path)


def test_damaged_bytes_are_detected(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    save_npz(SafeMDP.deterministic(np.arange(1000).reshape(-1, 1), np.zeros(1000) == 1), path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(ValueError, match="damaged npz file: Bad CRC-32"):
        load_npz(path)


def test_an_archive_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("fail.npy", b"not an array")
    with pytest.raises(ValueError, match="array 'fail'"):
        load_npz(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_npz(tmp_path / "absent.npz")
    with pytest.raises(IsADirectoryError):
        load_npz(tmp_path)
    with pytest.raises(ValueError, match="does not exist"):
        save_npz(SafeMDP.deterministic(TABLE, FAIL), tmp_path / "absent" / "model.npz")


def test_an_exact_model_without_transitions(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    model = SafeMDP.stochastic(np.full((1, 1, 1), Fraction(1)), np.array([True]))
    save_npz(model, path)
    assert_same(load_npz(path), model)


def write_raw(path: Path, shape: tuple[int, ...], content: bytes) -> None:
    """next_state with a header that says this shape."""
    header = io.BytesIO()
    fields = {"descr": "<i4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, fields)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("next_state.npy", header.getvalue() + content)


@pytest.mark.parametrize("shape", [(10**13,), (10**30,), (-5, 2), (2**62, 4), (4, 4)])
def test_a_shape_that_the_file_cannot_have(shape: tuple[int, ...], tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    write_raw(path, shape, b"0" * 8)
    with pytest.raises(ValueError, match=rf"^{path}: array 'next_state': "):
        load_npz(path)


def test_an_array_larger_than_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it is unpacked: zeros need no room in the file."""
    monkeypatch.setattr("dead_ends.model.memory.GIB", 2**20)
    monkeypatch.setattr("dead_ends.model.memory.available_memory", lambda: 2**21)
    path = tmp_path / "model.npz"
    write_raw(path, (2**20,), bytes(2**22))
    with pytest.raises(MemoryError, match=r"model\.npz: the array next_state.npy needs 4.0 GiB"):
        load_npz(path)


def test_a_large_exact_model(tmp_path: Path) -> None:
    """Dense, its probabilities would fill 3 GB."""
    n = 20_000
    path = tmp_path / "model.npz"
    np.savez(
        path,
        P_exact=["1/3", "2/3"] * n,
        P_indices=np.column_stack([np.zeros(n, int), np.arange(n)]).ravel(),
        P_indptr=np.arange(0, 2 * n + 1, 2),
        fail=np.arange(n) == n - 1,
    )
    assert load_npz(path).exact_probabilities()[-2:] == (Fraction(1, 3), Fraction(2, 3))
