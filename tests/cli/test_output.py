"""What commands write, and what they refuse to overwrite."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dead_ends.__main__ import main
from dead_ends.io import load_model, save_model
from dead_ends.model.safe_mdp import SafeMDP

WRITING = ("label", "certify", "convert", "export", "page")


@pytest.fixture(autouse=True)
def _files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The model in model.npz and model.tra, in the working folder."""
    monkeypatch.chdir(tmp_path)
    model = SafeMDP.deterministic([[0, 1], [1, 1]], [False, True], state_names=["a", "b"])
    for suffix in ("npz", "tra"):
        save_model(model, f"model.{suffix}")


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    try:
        status = main(arguments)
    except SystemExit as error:
        status = int(error.code or 0)
    captured = capsys.readouterr()
    assert (status, captured.out, captured.err.count("\n")) == (2, "", 1)
    return captured.err


@pytest.mark.parametrize("command", WRITING)
@pytest.mark.parametrize("name", ["model.npz", "./model.npz", "link.npz", "hard.npz"])
def test_the_input_is_not_overwritten(
    capsys: pytest.CaptureFixture[str], command: str, name: str
) -> None:
    Path("link.npz").symlink_to("model.npz")
    Path("hard.npz").hardlink_to("model.npz")
    before = Path("model.npz").read_bytes()
    if command == "page":
        Path("model.npz").rename("model.html")
        Path("link.npz").unlink()
        Path("model.npz").symlink_to("model.html")
        name = "model.html"
    err = refused(capsys, command, "model.npz", "--out", name)
    assert "is read as input (model.npz) and would be overwritten" in err
    assert Path("model.npz").read_bytes() == before


@pytest.mark.parametrize("command", WRITING)
@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("", "the name of the file is empty"),
        ("folder.npz", "folder.npz: is a folder, not a file to write"),
        ("nowhere/a.npz", "nowhere/a.npz: the folder nowhere does not exist"),
    ],
)
def test_a_name_that_is_none_is_refused_before_anything_is_read(
    capsys: pytest.CaptureFixture[str], command: str, out: str, message: str
) -> None:
    Path("folder.npz").mkdir()
    assert message in refused(capsys, command, "no-such-file.npz", "--out", out)


def test_what_lies_beside_an_explicit_model_is_input_and_output_too(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert "is read as input (model.lab)" in refused(
        capsys, "label", "model.tra", "--out", "model.lab"
    )
    Path("other.sta").symlink_to("model.sta")
    assert "is read as input (model.sta)" in refused(
        capsys, "convert", "model.tra", "--out", "other.tra"
    )
    assert main(["convert", "model.tra", "--out", "new.tra"]) == 0
    assert load_model("new.tra").state_names == ("a", "b")


def test_a_policy_is_not_overwritten(capsys: pytest.CaptureFixture[str]) -> None:
    np.save("policy.npy", [0, 0])
    Path("policy.npy").rename("policy.html")
    err = refused(capsys, "page", "model.npz", "--policy", "policy.html", "--out", "policy.html")
    assert "is read as input (policy.html)" in err
