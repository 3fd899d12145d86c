"""Offline data on disk: files and datasets that come back whole, or are refused in a sentence."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from deep.__main__ import main
from deep.data.formats import from_minari, read_hdf5, to_minari, write_hdf5
from deep.data.transitions import Transitions
from tests.deep.recordings import brake_data, episode, joined, same

Columns = dict[str, NDArray[Any]]


def marked(*places: int, rows: int = 40) -> NDArray[np.float64]:
    column = np.zeros(rows)
    column[list(places)] = 1
    return column


def recording(**columns: Any) -> Columns:
    """40 rows of one episode, which ends with a violation; with other columns, or without."""
    rng = np.random.default_rng(0)
    base = {
        "observations": rng.random((40, 2)),
        "actions": rng.random((40, 1)),
        "next_observations": rng.random((40, 2)),
        "rewards": np.zeros(40),
        "costs": marked(39),
        "terminals": marked(39),
        "timeouts": np.zeros(40),
    }
    return {k: v for k, v in (base | columns).items() if v is not None}


def written(path: Path, columns: Columns) -> Path:
    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file[name] = column
    return path


def refusal(path: Path, **options: Any) -> str:
    """The sentence with which a file is refused, without its name."""
    with pytest.raises(ValueError, match="^" + path.as_posix()) as caught:
        read_hdf5(path, **options)
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence.removeprefix(f"{path}: ")


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
    assert read.costs.tolist() == [0, 1, 0, 0, 1]  # the row that leads out of the violation left
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


def test_a_violation_in_a_row_that_timed_out_is_kept(tmp_path: Path) -> None:
    # Without next_observations such rows have no successor, and used to go.
    columns = recording(
        next_observations=None, timeouts=marked(19), terminals=marked(39), costs=marked(19, 39)
    )
    read = read_hdf5(written(tmp_path / "a.hdf5", columns))
    assert np.flatnonzero(read.costs).tolist() == [19, 39]
    assert np.flatnonzero(read.terminals).tolist() == [19, 39]
    assert not read.timeouts.any()
    # So is one in the very last row of a recording that just stops.
    columns = recording(next_observations=None, terminals=np.zeros(40))
    assert read_hdf5(written(tmp_path / "b.hdf5", columns)).costs[39] == 1


@pytest.mark.parametrize("following", [True, False])
def test_a_long_recording_keeps_its_violations(tmp_path: Path, following: bool) -> None:
    n, places = 1000, range(7, 1000, 50)
    columns = {
        "observations": np.arange(n)[:, None] * 1.0,
        "actions": np.zeros((n, 1)),
        "rewards": np.zeros(n),
        "costs": marked(*places, rows=n),
        "terminals": np.zeros(n),
        "timeouts": np.zeros(n),
    } | ({"next_observations": np.arange(1, n + 1)[:, None] * 1.0} if following else {})
    path = written(tmp_path / "long.hdf5", columns)
    assert "row 7 is a violation" in refusal(path)
    assert "after 20 of 20 violations; --cut (cut=True" in refusal(path)
    read = read_hdf5(path, cut=True)
    assert read.observations[read.costs == 1, 0].tolist() == list(places)
    moves = read.next_observations[:, 0] - read.observations[:, 0]
    assert (moves[~read.terminals] == 1).all()


def test_a_rule_says_what_is_a_violation(tmp_path: Path) -> None:
    costs = np.where(np.arange(40) == 39, 2.0, 0.25)
    path = written(tmp_path / "c.hdf5", recording(costs=costs))
    assert refusal(path) == (
        "costs: row 0 is 0.25; a cost is 1 at a violation, else 0, unless you say which cost is "
        'one, for example --violation "cost > 0" (violation="cost > 0")'
    )
    for rule in ("cost > 0.5", "cost>=2", " cost[0] > 1e-0 "):
        assert np.flatnonzero(read_hdf5(path, violation=rule).costs).tolist() == [39]
    assert "row 0 is a violation but its episode goes on" in refusal(path, violation="cost > 0.1")
    nothing = "costs: there is no violation (cost > 5) in the data"
    assert refusal(path, violation="cost > 5") == nothing
    for rule in ("", "cost", "price > 1", "cost > x", "cost > nan", "cost == 1", "cost[a] > 1"):
        with pytest.raises(ValueError, match="^violation: a rule is like 'cost > 0.5' or"):
            read_hdf5(path, violation=rule)


def test_of_several_constraints_one_is_chosen(tmp_path: Path) -> None:
    costs = np.stack([marked(3, 39), marked(39)], axis=1)
    path = written(tmp_path / "d.hdf5", recording(costs=costs))
    assert refusal(path) == (
        "costs: row 0 has 2 costs, one for each of several constraints; choose one of these, "
        'for example --violation "cost[0] > 0" (violation="cost[0] > 0")'
    )
    assert "row 0 has 2 costs, one for each" in refusal(path, violation="cost > 0")
    assert read_hdf5(path, violation="cost[1] > 0").costs.sum() == 1
    assert read_hdf5(path, violation="cost[0] > 0", cut=True).costs.sum() == 2
    costs[5, 0] = np.nan  # nor is one overlooked in a constraint that is not chosen
    other = written(tmp_path / "nan.hdf5", recording(costs=costs))
    assert refusal(other, violation="cost[1] > 0") == "costs: row 5, column 0 is nan"
    assert refusal(path, violation="cost[2] > 0") == "costs: row 0 has 2 costs: there is no cost[2]"


def test_commands_have_the_options_that_their_messages_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    costs = 2 * marked(*range(5, 40, 4)) + 0.25
    path = written(tmp_path / "log.hdf5", recording(costs=costs, terminals=np.zeros(40)))
    small = ["--updates", "1", "--seeds", "0"]
    pretraining = ["pretrain", "--data", str(path), "--horizon", "3", *small]
    offline = ["train-offline", "--task", "brake", "--data", str(path), "--episodes", "1", *small]
    for number, command in enumerate((pretraining, offline)):
        out = tmp_path / str(number)
        given: list[str] = []
        for said, option in (
            ('--violation "cost > 0"', ["--violation", "cost > 0.5"]),
            ("--cut (cut=True", ["--cut"]),
        ):
            assert main([*command, "--out", str(out), *given]) == 2
            assert said in capsys.readouterr().err
            assert not out.exists()
            given += option
        assert main([*command, "--out", str(out), *given]) == 0
    assert main(["pretrain", "--task", "brake", "--out", str(tmp_path / "x"), "--cut"]) == 2
    assert "cut and violation are of a data file" in capsys.readouterr().err


NAN = {
    "observations": "row 3, column 1 is nan",
    "actions": "row 3, column 0 is nan",
    "next_observations": "row 3, column 1 is nan",
    "rewards": "row 3 is nan",
    "costs": "row 3 is nan",
    "terminals": "row 3 is nan",
    "timeouts": "row 3 is nan",
}


@pytest.mark.parametrize("cut", [True, False])
@pytest.mark.parametrize("name", NAN)
def test_nan_is_refused_by_column_and_row_of_the_file(tmp_path: Path, name: str, cut: bool) -> None:
    # Row 1 is dropped when it is cut; the rows are counted before that.
    columns = recording(costs=marked(0, 39), terminals=marked(39, *([] if cut else [0])))
    column = columns[name].reshape(40, -1)
    column[3, -1] = np.nan
    said = refusal(written(tmp_path / "e.hdf5", columns), cut=cut)
    assert said.startswith(f"{name}: {NAN[name]}")


def replaced(name: str, build: Callable[[h5py.File], None]) -> Callable[[h5py.File], None]:
    """Puts something else where a data set was."""

    def change(file: h5py.File) -> None:
        del file[name]
        build(file)

    return change


def other_file(file: h5py.File) -> Path:
    """A second file beside the first, with the same data sets."""
    path = Path(file.filename).with_name("other.hdf5")
    return path if path.exists() else written(path, recording())


def assign(name: str, value: Any) -> Callable[[h5py.File], None]:
    def build(file: h5py.File) -> None:
        file[name] = value

    return replaced(name, build)


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((40,), float)
    layout[:] = h5py.VirtualSource(other_file(file), "costs", (40,))
    file.create_virtual_dataset("costs", layout)


def external(file: h5py.File) -> None:
    raw = Path(file.filename).with_name("raw.bin")
    raw.write_bytes(marked(39).tobytes())
    file.create_dataset("costs", (40,), float, external=[(str(raw), 0, 320)])


def half_written(file: h5py.File) -> None:
    file.create_dataset("costs", (40,), float, chunks=(10,))[:10] = marked(3)[:10]


FAULTS: dict[str, Callable[[h5py.File], None]] = {
    "costs is a scalar or empty": assign("costs", 1.0),
    "rewards is a scalar or empty": assign("rewards", h5py.Empty(float)),
    "actions is a group, not a data set": replaced("actions", lambda f: f.create_group("actions")),
    "actions is a datatype, not a data set": assign("actions", np.dtype("f8")),
    "observations: the values are of type text": assign("observations", ["abc"] * 40),
    "costs: the values are of type [('x'": assign("costs", np.zeros(40, [("x", float)])),
    "rewards: the values are of type complex128": assign("rewards", np.zeros(40, complex)),
    "costs is a link": assign("costs", h5py.SoftLink("/terminals")),
    "timeouts is a link": assign("timeouts", h5py.SoftLink("/nowhere")),
    "actions is a link": assign("actions", h5py.ExternalLink("other.hdf5", "/actions")),
    "rewards is a link": assign("rewards", h5py.ExternalLink("nowhere.hdf5", "/rewards")),
    "costs keeps its numbers in other files: copy": replaced("costs", virtual),
    "costs keeps its numbers in other files": replaced("costs", external),
    "costs: not all of its 40 rows": replaced("costs", half_written),
    "rewards: not all of its 40 rows": replaced(
        "rewards", lambda f: f.create_dataset("rewards", (40,), float)
    ),
    "the data sets differ in length": assign("actions", np.zeros((39, 1))),
    "rewards has shape (40, 2)": assign("rewards", np.zeros((40, 2))),
    "observations and actions must have shapes (N, dim)": assign("actions", np.zeros(40)),
    "next_observations have shape (40, 3)": assign("next_observations", np.zeros((40, 3))),
    "the data sets timeouts are missing": replaced("timeouts", lambda _: None),
}


@pytest.mark.parametrize("message", FAULTS)
def test_faults_of_files_are_told_in_a_sentence(tmp_path: Path, message: str) -> None:
    path = written(tmp_path / "f.hdf5", recording())
    with h5py.File(path, "r+") as file:
        FAULTS[message](file)
    assert refusal(path).startswith(message)


def test_absurd_sizes_are_refused_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "g.hdf5", recording())
    monkeypatch.setattr("os.sysconf", lambda _: 60)  # 3,600 bytes of memory
    assert refusal(path) == "the data sets take 0.0 GB, more than half of this machine's memory"
    monkeypatch.undo()
    with h5py.File(path, "r+") as file:
        del file["rewards"]
        file.create_dataset("rewards", (10**12,), float, chunks=(10**6,))
    assert refusal(path) == "rewards: not all of its 1,000,000,000,000 rows were ever written"


def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    """Cut off anywhere, or with bytes that have changed: a sentence, or numbers that pass."""
    path = tmp_path / "h.hdf5"
    write_hdf5(Transitions(**recording()), path)
    whole = path.read_bytes()
    for end in range(0, len(whole), 499):
        path.write_bytes(whole[:end])
        assert refusal(path)
    rng, said = random.Random(0), []
    for _ in range(300):
        hurt = bytearray(whole)
        for place in rng.sample(range(len(whole)), 4):
            hurt[place] = rng.randrange(256)
        path.write_bytes(hurt)
        try:
            read_hdf5(path)
        except ValueError as error:
            said.append(str(error))
    assert len(said) > 100
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in said)
    # A chunk that does not unpack, in a file whose structure is sound.
    with h5py.File(path, "w") as file:
        for name, column in recording().items():
            file.create_dataset(name, data=column, compression="gzip", chunks=column.shape)
        file["rewards"].id.write_direct_chunk((0,), b"nonsense")
    assert refusal(path).startswith("rewards is damaged (")


def test_minari_round_trip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    raw = joined(episode([0, 0, 1]), episode([0, 0], timeout=True), episode([1]))
    data = Transitions(**raw)
    dataset = to_minari(data, "deep/test-v0")
    assert dataset.total_episodes == 3
    assert same(from_minari(dataset), data)


def minari(**changes: Any) -> Any:
    """A stand-in for a dataset of one episode of three steps, the last a violation."""
    fields = {
        "id": 4,
        "observations": np.arange(8.0).reshape(4, 2),
        "actions": np.zeros((3, 1)),
        "rewards": np.zeros(3),
        "terminations": np.array([False, False, True]),
        "truncations": np.zeros(3, dtype=bool),
        "infos": {"cost": np.array([0.0, 0.0, 1.0])},
    }
    one = SimpleNamespace(**(fields | changes))
    return SimpleNamespace(iterate_episodes=lambda: [one])


MINARI = {
    "there is no infos['cost']": {"infos": {}},
    "5 costs for 3 steps": {"infos": {"cost": np.zeros(5)}},
    "1 costs for 3 steps": {"infos": {"cost": np.array(1.0)}},
    "costs: row 1 is nan": {"infos": {"cost": np.array([0, np.nan, 1])}},
    "costs: row 2 is 2;": {"infos": {"cost": np.array([0, 0, 2])}},
    "costs: row 0 has 2 costs, one for each of several": {"infos": {"cost": np.zeros((3, 2))}},
    "its reset reports a violation": {"infos": {"cost": np.array([1, 0, 0, 1])}},
    "costs: row 0 is a violation but its episode goes on": {"infos": {"cost": np.ones(3)}},
    "terminals: row 0 is nan": {"terminations": np.array([np.nan, 0, 1])},
    "observations: row 3, column 1 is nan": {
        "observations": np.where(np.arange(8).reshape(4, 2) == 7, np.nan, 0)
    },
    "observations: the values are of type object": {"observations": {"a": np.zeros(4)}},
}


@pytest.mark.parametrize("message", MINARI)
def test_minari_episodes_with_faults_are_refused(message: str) -> None:
    with pytest.raises(ValueError, match=f"^episode 4: {re.escape(message)}"):
        from_minari(minari(**MINARI[message]))


def test_minari_datasets_know_the_same_rule() -> None:
    costs = np.array([[0, 9], [0, 9], [0.7, 0]])
    dataset = minari(infos={"cost": costs})
    assert from_minari(dataset, violation="cost[0] > 0.5").costs.tolist() == [0, 0, 1]
    cut = from_minari(dataset, violation="cost[1] >= 9", cut=True)
    assert cut.costs.tolist() == [1, 1]
    # An episode that neither ended nor was cut off does not go on in the next one.
    unfinished = minari(terminations=np.zeros(3, dtype=bool), infos={"cost": np.zeros(3)})
    two = [*unfinished.iterate_episodes(), *minari().iterate_episodes()]
    joined_up = from_minari(SimpleNamespace(iterate_episodes=lambda: two))  # type: ignore[arg-type]  # a stand-in
    assert joined_up.timeouts.tolist() == [False, False, True, False, False, False]
    stopped = minari(terminations=np.zeros(3, dtype=bool))
    assert from_minari(stopped).terminals.tolist() == [False, False, True]
    early = {"infos": {"cost": np.array([0, 1, 0])}, "terminations": np.zeros(3, dtype=bool)}
    assert from_minari(minari(**early), cut=True).ends.tolist() == [False, True]
