"""What is wrong is said in one line with status 2, and nothing is left behind."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from deep.__main__ import main
from deep.data.collect import collect, random_policy
from deep.data.formats import write_hdf5
from deep.runs.folder import read_object, versions
from deep.tasks import make_task
from deep.train.evaluation import evaluate_policies
from deep.train.run import train
from tests.deep.filters import linear_filter
from tests.deep.online_runs import SEEDS, TINY, blocking_filter, hand_made

SHORT = (
    *("--steps", "40", "--start-steps", "20", "--copies", "4", "--episodes", "2"),
    *("--evaluate-every", "20", "--evaluation-episodes", "1", "--log-every", "20"),
    *("--checkpoint-every", "20", "--replay", "40"),
)


@pytest.fixture(scope="module")
def sac(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of SAC on the brake."""
    out = tmp_path_factory.mktemp("runs") / "sac"
    train(TINY, out, quiet=True)
    return out


@pytest.fixture(scope="module")
def critics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pretraining run on the brake for the same seeds."""
    filters = {seed: blocking_filter(0.0, 0.4) for seed in SEEDS}
    return hand_made(tmp_path_factory.mktemp("critics") / "run", filters)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recorded transitions of the brake."""
    path = tmp_path_factory.mktemp("data") / "brake.hdf5"
    task = make_task("brake")
    write_hdf5(collect(task, random_policy(task), np.random.default_rng(0), 300), path)
    return path


def said(words: Sequence[object], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line about what is wrong."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("deep: ")
    return line.removeprefix("deep: ")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--task", "nowhere"], "there is no task 'nowhere'; there are brake, "),
        (["--task", "gym:Nowhere-v1"], "there is no Gymnasium environment 'Nowhere-v1': "),
        (["--task", "real:nowhere"], "there is no real task 'nowhere'; there are static-env, "),
        (["--task", "brake", "--safety", "CRITICS", "--seeds", "5"], ": seed 5 was not pretrained"),
        (["--task", "brake", "--seeds"], "seeds: give at least one"),
        (["--task", "brake", "--seeds", "1", "1"], "seeds must be distinct non-negative"),
        (["--task", "brake", "--safety", "CRITICS/no"], "no: there is no run here"),
        (["--task", "brake", "--safety", "SAC"], "sac/config.json: not a pretraining run ("),
        (
            ["--task", "brake", "--safety", "CRITICS", "--threshold", "2"],
            "threshold must lie in (0, 1], not 2.0",
        ),
        (
            ["--task", "dubins", "--safety", "CRITICS"],
            "its filters take observations in R^2 and actions in R^1, dubins has ",
        ),
    ],
)
def test_training_that_cannot_begin_leaves_no_folder(
    given: list[str],
    message: str,
    critics: Path,
    sac: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = [w.replace("CRITICS", str(critics)).replace("SAC", str(sac)) for w in given]
    out = tmp_path / "run"
    assert message in said(["train", "--out", out, *words, *SHORT, "sac"], capsys)
    assert not out.exists()


def test_the_simulator_must_be_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", "--out", tmp_path / "run", "--task", "real:point-goal1", *SHORT, "sac"]
    monkeypatch.delenv("DEAD_ENDS_SAFETY_PYTHON", raising=False)
    assert "scripts/install_safety_gymnasium.sh FOLDER" in said(words, capsys)
    monkeypatch.setenv("DEAD_ENDS_SAFETY_PYTHON", str(tmp_path / "python"))
    assert "cannot be run (No such file or directory)" in said(words, capsys)
    assert not (tmp_path / "run").exists()


def test_data_that_are_none_leave_no_folder(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(data.read_bytes()[:1000])
    out = tmp_path / "run"
    for words in (
        ["train-offline", "--task", "brake", "--data", broken, "--out", out],
        ["pretrain", "--data", broken, "--horizon", "5", "--out", out],
    ):
        assert f"{broken}: not an HDF5 file" in said(words, capsys)
        assert not out.exists()
    words = ["train-offline", "--task", "point-goal1", "--data", data, "--out", out]
    assert "actions in R^1, point-goal1 has R^60 and R^2" in said(words, capsys)
    assert not out.exists()


def test_a_folder_that_is_none(
    sac: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "file"
    taken.write_text("mine")
    words = ["train", "--task", "brake", "--out", taken, *SHORT, "sac"]
    assert str(taken) in said(words, capsys)
    assert str(taken) in said(
        ["offline-data", "--run-folder", sac, "--seed", 3, "--out", taken / "x.hdf5"], capsys
    )
    assert taken.read_text() == "mine"


def test_a_configuration_that_is_none_is_named(
    critics: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", "--task", "brake", "--out", tmp_path, *SHORT, "sac"]
    config = tmp_path / "config.json"
    for text, message in (
        ("{}", "'run' is missing"),
        ("[1]", "expected a JSON object"),
        ("no", "not a readable JSON file (Expecting value: line 1 column 1 (char 0))"),
    ):
        config.write_text(text)
        assert said(words, capsys) == f"{config}: {message}"
    (tmp_path / "result.json").write_text('{"task": "brake"}')
    out = ["--out", tmp_path / "out"]
    line = said(["evaluate", "--policy", tmp_path, *out], capsys)
    assert line == f"{tmp_path / 'result.json'}: 'method' is missing"
    line = said(["offline-data", "--run-folder", critics, "--seed", "0", *out], capsys)
    assert line.startswith(f"{critics / 'config.json'}: not a training run (")
    assert not (tmp_path / "out").exists()


def test_policies_and_filters_that_do_not_fit_are_refused(sac: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    message = r"sac: its policies take observations in R\^2 and actions in R\^1, point-goal1 has"
    with pytest.raises(ValueError, match=message):
        evaluate_policies(sac, None, out, episodes=2, task="point-goal1")
    wide = linear_filter([0.0, 0.0, 0.0], 0.0, 0.0, 0.0, threshold=0.5)
    folder = hand_made(tmp_path / "wide", dict.fromkeys(SEEDS, wide))
    with pytest.raises(ValueError, match=r"wide: its filters take observations in R\^3 and act"):
        evaluate_policies(sac, folder, out, episodes=2)
    assert not out.exists()


def test_an_unfinished_pretraining_is_no_filter(sac: Path, tmp_path: Path) -> None:
    one = hand_made(tmp_path / "one", {0: blocking_filter(0.0, 0.4)})
    begun = hand_made(tmp_path / "begun", {})
    out = tmp_path / "out"
    for folder, seed in ((tmp_path / "none", 0), (begun, 0), (one, 3)):
        message = (
            f"{folder}: not a finished pretraining run of seed {seed} "
            f"(no filters/seed{seed}.safetensors)"
        )
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            evaluate_policies(sac, folder, out, episodes=2)
    assert not out.exists()


def test_a_threshold_without_filters_is_refused(
    sac: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "--policy", sac, "--out", tmp_path / "out", "--episodes", "2"]
    assert said([*words, "--threshold", "0.5"], capsys) == "threshold needs filters: safety"
    choice = tmp_path / "choice.json"
    choice.write_text('{"threshold": 0.5}')
    assert said([*words, "--threshold-from", choice], capsys) == "threshold needs filters: safety"
    assert not (tmp_path / "out").exists()


def test_a_threshold_is_given_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    choice = tmp_path / "choice.json"
    choice.write_text('{"threshold": 0.5}')
    words = ["train", "--task", "brake", "--out", tmp_path / "out", *SHORT]
    words += ["--threshold-from", choice]
    given = [*words, "wcsac", "--cost-limit", "0.1"]
    assert said(given, capsys) == "give either cost_limit or threshold_from"
    given = [*words, "--threshold", "0.4", "sac"]
    assert said(given, capsys).endswith(
        "threshold, safety_seeds and finetune need a pretraining run: safety"
    )
    assert not (tmp_path / "out").exists()


def test_an_evaluation_replaces_no_run(sac: Path) -> None:
    before = (sac / "result.json").read_bytes()
    with pytest.raises(ValueError, match="sac holds a run, whose result an evaluation would"):
        evaluate_policies(sac, None, sac, episodes=2)
    assert (sac / "result.json").read_bytes() == before


def test_without_git_there_is_no_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert versions()["git"] == ""


def test_objects_are_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(json.dumps({"a": 1, "b": None}))
    assert read_object(path, "a", "b") == {"a": 1, "b": None}
    with pytest.raises(ValueError, match=r"none.json: not a readable JSON file \(.*No such file"):
        read_object(tmp_path / "none.json")
