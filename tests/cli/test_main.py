"""The command line: what it prints, and what it says when something is wrong."""

import csv
import json
import os
import re
import resource
import subprocess
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dead_ends.cli
from dead_ends import __version__
from dead_ends.__main__ import main
from dead_ends.io import load_model
from dead_ends.labels.classification import classify
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.filter_table import load_filter

PYTHON = [sys.executable, "-m", "dead_ends"]


@pytest.fixture
def corridor(tmp_path: Path) -> str:
    """State 0 may stay or enter 1 -> 2 -> fail."""
    path = tmp_path / "corridor.npz"
    names = ["door", "hall", "edge", "pit"]
    table = [[0, 1], [2, 2], [3, 3], [-1, -1]]
    np.savez(path, next_state=table, fail=np.arange(4) == 3, state_names=names)
    return str(path)


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    try:
        status = main(arguments)
    except SystemExit as error:
        status = int(error.code or 0)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line on standard error."""
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, ""), err
    assert err.endswith("\n")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--version") == (0, f"dead-ends {__version__}\n", "")


def test_every_command_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(dead_ends.cli.__file__).parent
    modules = {
        path.stem
        for path in folder.glob("*.py")
        if hasattr(import_module(f"dead_ends.cli.{path.stem}"), "SUMMARY")
    }
    assert set(dead_ends.cli.COMMANDS) == modules
    _, out, _ = run(capsys, "--help")
    assert all(re.search(rf"\n    {command}\s", out) for command in modules)


def test_label_says_the_numbers(capsys: pytest.CaptureFixture[str], corridor: str) -> None:
    status, out, err = run(capsys, "label", corridor)
    assert (status, err) == (0, "")
    lines = [line.split() for line in out.splitlines()]
    assert ["states", "4"] in lines
    assert ["fail", "1"] in lines
    assert ["dead", "2"] in lines
    assert ["safe", "1"] in lines
    assert ["horizon", "H", "2"] in lines
    assert ["boundary", "horizon", "H_b", "2"] in lines
    assert f"0 < epsilon_safe <= gamma_safe**2 = {0.99**2!r}, for example 0.975187187108" in out


def test_label_json(capsys: pytest.CaptureFixture[str], corridor: str) -> None:
    status, out, _ = run(capsys, "label", corridor, "--json", "--gamma-safe", "1/2")
    summary = json.loads(out)
    assert status == 0
    threshold = summary.pop("threshold")
    assert threshold.pop("recommended") == pytest.approx(0.5**2.5)
    assert threshold == {
        "empty": False,
        "at_most": 0.25,
        "exponent": 2,
        "text": "0 < epsilon_safe <= gamma_safe**2 = 1/4",
    }
    assert summary == {
        "kind": "deterministic",
        "estimate": False,
        "seed": None,
        "states": 4,
        "actions": 2,
        "fail": 1,
        "dead": 2,
        "safe": 1,
        "at_risk": 0,
        "terminal": 0,
        "horizon": 2,
        "boundary_horizon": 2,
        "reachable_horizon": None,
        "reachable_boundary_horizon": None,
        "gamma_safe": 0.5,
    }


def test_label_of_an_environment(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "label", "FrozenLake-v1", "--env-arg", "map_name=8x8")
    assert status == 0
    assert "FrozenLake-v1: stochastic, 4 actions" in out
    assert "at risk" in out
    status, out, _ = run(
        capsys, "label", "FrozenLake-v1", "--env-arg", "is_slippery=False", "--json",
        "--fail-states", "5,7,11-12",
    )  # fmt: skip
    assert status == 0
    assert json.loads(out)["safe"] == 12
    status, out, _ = run(capsys, "label", "CliffWalking-v1", "--fail-if", "r <= -100", "--json")
    assert json.loads(out)["dead"] == 0
    assert json.loads(out)["states"] == 49


def test_thresholds_without_bounds_or_members(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = str(tmp_path / "model.npz")
    np.savez(path, next_state=[[0], [1]], fail=np.array([False, True]))
    assert "any, for no action leaves the safe states" in run(capsys, "label", path)[1]
    assert json.loads(run(capsys, "label", path, "--json")[1])["threshold"]["at_most"] is None


def read_csv(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_label_files(capsys: pytest.CaptureFixture[str], corridor: str, tmp_path: Path) -> None:
    for suffix in (".csv", ".json", ".npz"):
        path = tmp_path / f"labels{suffix}"
        status, out, _ = run(capsys, "label", corridor, "--out", str(path))
        assert status == 0
        assert out.endswith(f"wrote {path}\n")
    assert read_csv(tmp_path / "labels.csv") == [
        ["state", "name", "label", "survival_time"],
        ["0", "door", "safe", ""],
        ["1", "hall", "dead", "2"],
        ["2", "edge", "dead", "1"],
        ["3", "pit", "fail", "0"],
    ]
    content = json.loads((tmp_path / "labels.json").read_text())
    assert content["labels"] == ["safe", "dead", "dead", "fail"]
    assert content["survival_time"] == [None, 2, 1, 0]
    assert content["state_names"] == ["door", "hall", "edge", "pit"]
    assert content["summary"]["horizon"] == 2
    with np.load(tmp_path / "labels.npz") as arrays:
        labelling = classify(load_model(corridor))
        assert np.array_equal(arrays["labels"], labelling.labels)
        assert np.array_equal(arrays["survival_time"], labelling.survival_time)
        assert json.loads(str(arrays["summary"])) == content["summary"]


def test_the_seed_of_a_layout_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("minigrid", reason="minigrid is not installed")
    said = []
    for words in ([], ["--seed", "1"]):
        _, out, _ = run(capsys, "label", "MiniGrid-LavaGapS5-v0", *words)
        said.append(out.splitlines()[0])
    kind = "MiniGrid-LavaGapS5-v0: deterministic, 7 actions, reset with seed"
    assert said == [f"{kind} 0", f"{kind} 1"]


def test_normalise(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "six.tra"
    path.write_text("3 5\n0 0 0.333333\n0 1 0.333333\n0 2 0.333333\n1 1 1\n2 2 1\n")
    source = ["label", str(path), "--fail-states", "1"]
    assert "line 2: state 0, choice 0: probabilities sum to 0.999999, not 1; normalise" in fails(
        capsys, *source
    )
    status, out, err = run(capsys, *source, "--normalise")
    assert (status, err) == (0, "")
    assert "  rows normalised               1\n" in out
    assert json.loads(run(capsys, *source, "--normalise", "--json")[1])["rows_normalised"] == 1


def test_convert(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "lake.npz"
    status, out, _ = run(capsys, "convert", "FrozenLake-v1", "--out", str(path))
    assert status == 0
    assert "16 states" in out
    assert np.array_equal(load_model(path).fail, load_model("FrozenLake-v1").fail)


def test_export(capsys: pytest.CaptureFixture[str], corridor: str, tmp_path: Path) -> None:
    path = tmp_path / "filter.npz"
    status, out, _ = run(capsys, "export", corridor, "--out", str(path))
    assert (status, out) == (0, f"wrote {path}: 1 of 8 actions pass\n")
    exact = load_filter(path)
    assert exact.allowed.tolist() == [[True, False]] + [[False, False]] * 3
    assert exact.recovery.tolist() == [0, 0, 0, 0]
    assert exact.metadata["epsilon_safe"] is None
    # At gamma_safe**H_b the threshold says the same; just above it lets the agent into the hall.
    for threshold, passes in (("1/4", 1), ("0.25", 1), ("0.26", 2)):
        status, out, _ = run(
            capsys, "export", corridor, "--out", str(path), "--gamma-safe", "1/2",
            "--epsilon-safe", threshold,
        )  # fmt: skip
        assert f"{passes} of 8 actions pass" in out
        assert load_filter(path).metadata["gamma_safe"] == "1/2"


def test_an_exported_recovery_is_safe_where_powers_underflow(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """0.01**200 is 0 in floating point, the same as Q* of the action that stays."""
    table = np.arange(1, 202)[:, None] + [0, 0]
    table[0, 1] = 0
    np.savez(tmp_path / "long.npz", next_state=[*table, [0, 0]], fail=np.arange(202) == 201)
    path = tmp_path / "filter.json"
    run(capsys, "export", str(tmp_path / "long.npz"), "--out", str(path), "--gamma-safe", "0.01")
    filtered = load_filter(path)
    assert filtered.recovery[0] == 1
    assert filtered.allowed[0].tolist() == [False, True]


def test_formats_with_labels(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for suffix in (".tra", ".drn"):
        path = str(tmp_path / f"lake{suffix}")
        assert run(capsys, "convert", "FrozenLake-v1", "--out", path)[0] == 0
        status, out, _ = run(capsys, "label", path, "--fail-label", "fail", "--json")
        assert status == 0
        assert [json.loads(out)[key] for key in ("fail", "safe", "at_risk", "terminal")] == [
            4, 5, 7, 1,
        ]  # fmt: skip
        assert "labels: init" in fails(capsys, "explain", path, "0", "--fail-label", "crash")
        certificate = str(tmp_path / "certificate.npz")
        assert run(capsys, "certify", path, "--out", certificate)[0] == 0
        assert run(capsys, "check", certificate, path)[0] == 0


def test_certify_and_check(
    capsys: pytest.CaptureFixture[str], corridor: str, tmp_path: Path
) -> None:
    path = tmp_path / "certificate.json"
    status, out, _ = run(capsys, "certify", corridor, "--out", str(path))
    assert status == 0
    digest = json.loads(path.read_text())["digest"]
    assert f"sha256 {digest}" in out
    status, out, _ = run(capsys, "check", str(path), corridor)
    assert status == 0
    assert out.startswith("accepted: every label is proved")
    certificate = json.loads(path.read_text())
    certificate["rank"][1] = 3
    path.write_text(json.dumps(certificate))
    status, out, err = run(capsys, "check", str(path), corridor)
    assert (status, out) == (1, "")
    assert err == "refused: state 1 (hall): rank is not 1 + the greatest of successors\n"
    status, _, err = run(capsys, "check", str(path), "FrozenLake-v1")
    assert status == 1
    assert "refused" in err


@pytest.mark.parametrize(
    ("state", "expected"), [("1", "hall"), ("hall", "hall"), ("0", "door"), ("pit", "pit")]
)
def test_explain(
    capsys: pytest.CaptureFixture[str], corridor: str, state: str, expected: str
) -> None:
    status, out, err = run(capsys, "explain", corridor, state)
    assert (status, err) == (0, "")
    assert expected in out


def test_explain_json(capsys: pytest.CaptureFixture[str], corridor: str) -> None:
    status, out, err = run(capsys, "explain", corridor, "hall", "--json")
    assert (status, err) == (0, "")
    explanation = json.loads(out)
    _, text, _ = run(capsys, "explain", corridor, "hall")
    assert explanation.pop("text") == text.strip()
    assert explanation == {
        "state": 1,
        "label": "dead",
        "survival_time": 2,
        "action": 0,
        "path": {"states": [1, 2, 3], "actions": [0, 0], "cycle_start": None},
        "safe_path": None,
        "p_min": None,
    }


def test_explain_json_of_a_state_at_risk(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "explain", "FrozenLake-v1", "14", "--json")
    explanation = json.loads(out)
    assert (status, explanation["label"]) == (0, "at-risk")
    lower, upper = explanation["p_min"]
    assert 0 < lower <= upper < 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "arguments are required: COMMAND"),
        (["nonsense"], "invalid choice: 'nonsense'"),
        (["label"], "arguments are required: FILE"),
        (["label", "no-such-file.npz"], "no-such-file.npz: No such file or directory"),
        (["label", "no-such-file"], "no-such-file: neither a file nor an environment id"),
        (["label", "model.xyz"], "model.xyz: unknown format '.xyz' (known: .npz, "),
        (["label", "NoSuchLake-v1"], "NoSuchLake-v1: "),
        (["label", "Taxi-v4"], "Taxi-v4: which states fail is not known"),
        (["label", "CartPole-v1"], "CartPole-v1: the environment has no transition table P"),
        (["label", "FrozenLake-v1", "--seed", "1"], "seed (--seed) means nothing for this kind"),
        (["label", "FrozenLake-v1", "--seed", "-1"], "'-1' is not a seed such as 0, 1 or 2"),
        (["label", "Taxi-v4", "--fail-if", "x"], "condition 'x': unknown name 'x'"),
        (["label", "Taxi-v4", "--fail-label", "x"], "fail_label (--fail-label) means nothing"),
        (["label", "Taxi-v4", "--fail-states", "5,x"], "'x' is neither a state nor a range"),
        (["label", "Taxi-v4", "--fail-states", "0-99999999999"], "are too many states to list"),
        (["label", "Taxi-v4", "--fail-states", "0-" + "9" * 5000], "too many digits for a state"),
        (["label", "Taxi-v4", "--fail-states", "1,12-11"], "'12-11' is no range: 11 comes before"),
        (["label", "Taxi-v4", "--fail-states", "1-9,0-9999999"], "are too many states to list"),
        (["label", "Taxi-v4", "--fail-states", "500"], "500 is not a state (0 to 499)"),
        (["label", "Taxi-v4", "--env-arg", "is_rainy"], "'is_rainy' is not of the form KEY=VALUE"),
        (["label", "Taxi-v4", "--env-arg", "wind=1"], "Taxi-v4: "),
        (["label", "FrozenLake-v1", "--gamma-safe", "x"], "'x' is not a number"),
        (["label", "FrozenLake-v1", "--gamma-safe", "1/0"], "'1/0' is not a number"),
        (["label", "FrozenLake-v1", "--gamma-safe", "1.5"], "1.5 is not in (0, 1]"),
        (["label", "FrozenLake-v1", "--gamma-safe", "nan"], "nan is not in (0, 1]"),
        (["label", "FrozenLake-v1", "--out", "x.txt"], "x.txt: labels are written as .npz, .csv"),
        (["label", "FrozenLake-v1", "--out", "absent/x.csv"], "the folder absent does not exist"),
        (["convert", "FrozenLake-v1", "--out", "x.txt"], "x.txt: models are written as .npz"),
        (["certify", "FrozenLake-v1", "--out", "x.txt"], "x.txt: certificates are written as"),
        (["export", "FrozenLake-v1", "--out", "x.txt"], "must end in .npz or .json"),
        (["export", "Taxi-v4", "--out", "x.npz", "--epsilon-safe", "0"], "0 is not positive"),
        (["export", "Taxi-v4", "--out", "x.npz", "--epsilon-safe", "e"], "'e' is not a number"),
        (["check", "absent.npz", "FrozenLake-v1"], "absent.npz: No such file or directory"),
        (["check", "absent.json", "FrozenLake-v1"], "absent.json: No such file or directory"),
        (["explain", "FrozenLake-v1", "16"], "state 16: states are numbered 0 to 15 and no state"),
        (["explain", "FrozenLake-v1", "-1"], "state -1: states are numbered 0 to 15"),
    ],
)
def test_bad_input_is_one_line(
    arguments: Sequence[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, *arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["label", "certify", "export", "convert", "explain", "page"])
@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--fail-if", "r <= -1000", "no transition satisfies 'r <= -1000'"),
        ("--fail-label", "crash", "no state carries the label 'crash'"),
    ],
)
def test_what_selects_no_state_is_said(
    command: str,
    option: str,
    value: str,
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    path = tmp_path / "model.tra"
    path.write_text("2 3 3\n0 0 0 1\n0 1 1 1\n1 0 1 1\n")
    path.with_suffix(".lab").write_text('0="init" 1="fail" 2="crash"\n0: 0\n1: 1\n')
    source = "CliffWalking-v1" if option == "--fail-if" else str(path)
    suffix = {"export": "npz", "convert": "npz", "certify": "npz", "page": "html"}.get(command)
    out = ["--out", str(tmp_path / f"out.{suffix}")] if suffix else []
    more = ["0"] if command == "explain" else out
    status, _, err = run(capsys, command, source, *more, option, value)
    assert status == 0
    assert err == f"dead-ends: {source}: {said}, so that failure by it is impossible\n"


def test_options_that_say_which_states_fail_may_be_repeated(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def summary(*words: str) -> Any:
        status, out, err = run(capsys, "label", "CliffWalking-v1", "--json", *words)
        assert (status, err) == (0, "")
        return json.loads(out)["fail"]

    assert summary("--fail-states", "1,3-4", "--fail-states", "4-6") == 5
    assert summary("--fail-if", "r <= -100", "--fail-if", "s == 0 and s2 == 1") == 1
    assert summary("--fail-if", "r <= -1000", "--fail-if", "s == 0 and s2 == 1") == 1


def test_other_warnings_are_shown(
    capsys: pytest.CaptureFixture[str], corridor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = load_model(corridor)

    def load_and_warn(*_: Any, **__: Any) -> SafeMDP:
        warnings.warn("of something else", stacklevel=1)
        return model

    monkeypatch.setattr("dead_ends.io.load_model", load_and_warn)
    with pytest.warns(UserWarning, match="of something else"):
        assert run(capsys, "label", corridor)[0] == 0


def test_unnamed_states(capsys: pytest.CaptureFixture[str]) -> None:
    assert "numbered 0 to 500\n" in fails(
        capsys, "explain", "Taxi-v4", "--fail-states", "0", "home"
    )


def test_folders_and_damaged_files(
    capsys: pytest.CaptureFixture[str], corridor: str, tmp_path: Path
) -> None:
    folder = tmp_path / "folder.npz"
    folder.mkdir()
    assert f"{folder}: Is a directory" in fails(capsys, "label", str(folder))
    assert f"{folder}: is a folder" in fails(
        capsys, "convert", "FrozenLake-v1", "--out", str(folder)
    )
    bad = tmp_path / "bad.npz"
    bad.write_bytes(Path(corridor).read_bytes()[:-50])
    assert f"{bad}: not an npz file, or it is truncated" in fails(capsys, "label", str(bad))
    np.savez(bad, next_state=[[4]], fail=np.array([False]))
    assert f"{bad}: state 0, action 0: successor 4 is not a state" in fails(
        capsys, "label", str(bad)
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "bad.npz", "corridor.npz", "folder.npz",
    ]  # fmt: skip


def test_without_gymnasium(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    assert "pip install 'dead-ends[gym]'" in fails(capsys, "label", "FrozenLake-v1")


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (KeyboardInterrupt(), 130, ""),
        (MemoryError(), 2, "dead-ends: not enough memory for this model\n"),
        (MemoryError("labelling needs 9 GiB"), 2, "dead-ends: labelling needs 9 GiB\n"),
        (OSError("the disk is gone"), 2, "dead-ends: the disk is gone\n"),
    ],
)
def test_what_may_happen_meanwhile(
    error: BaseException,
    status: int,
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(dead_ends.io, "load_model", interrupted)
    assert run(capsys, "label", "FrozenLake-v1") == (status, "", said)


def test_nobody_reads_the_output() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    process = subprocess.run(
        [*PYTHON, "label", "CliffWalking-v1"],
        stdout=write_end,
        stderr=subprocess.PIPE,
        timeout=120,
        check=False,
    )
    os.close(write_end)
    assert (process.returncode, process.stderr) == (141, b"")


def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    """Writing stops after 100 bytes, as on a full disk."""
    command = f"import resource; resource.setrlimit({resource.RLIMIT_FSIZE}, (100, 100))\n"
    command += "from dead_ends.__main__ import main\n"
    command += "raise SystemExit(main(['convert', 'FrozenLake-v1', '--out', 'lake.npz']))"
    process = subprocess.run(
        [sys.executable, "-c", command],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert process.returncode == 2
    assert process.stderr == "dead-ends: [Errno 27] File too large\n"
    assert not list(tmp_path.iterdir())


def test_a_real_traceback_never_shows(tmp_path: Path) -> None:
    process = subprocess.run(
        [*PYTHON, "label", str(tmp_path / "absent.npz")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert process.returncode == 2
    assert process.stderr == f"dead-ends: {tmp_path / 'absent.npz'}: No such file or directory\n"
