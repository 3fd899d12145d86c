"""The command that runs a study: its exit status, its table, and its options."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deep.__main__ import main
from deep.study.schedule import Job

OK = ("collect", "--task", "brake", "--transitions", "300", "--out")


def test_a_study_ends_with_0_or_with_1_and_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / "data.hdf5", tmp_path / "out"
    good = Job("t/good", (*OK, str(data)), data)
    bad = Job("t/bad", ("report", "--study", str(tmp_path), "--out", "x"), tmp_path / "never")
    more = Job("t/more", (), tmp_path / "never", ("t/bad",))
    monkeypatch.chdir(Path(__file__).parents[3])
    command = ["grid", "--out", str(out), "--workers", "2", "--tasks", "brake", "--methods", "sac"]

    monkeypatch.setattr("deep.cli.grid.study_jobs", lambda _: (good, bad, more))
    assert main(command) == 1
    said = capsys.readouterr()
    assert said.out == (
        f"{out}: 1 jobs finished, 0 were finished before, 1 failed, 1 need a failed one\n"
    )
    table = said.err.splitlines()[-2:]
    assert table[0].startswith("t/bad   failed   exit status 2: deep: ")
    assert table[0].endswith(f"({out}/logs/t/bad.log)")
    assert table[1] == "t/more  blocked  a job that it needs failed"

    monkeypatch.setattr("deep.cli.grid.study_jobs", lambda _: (good,))
    assert main(command) == 0
    assert "0 jobs finished, 1 were finished before, 0 failed" in capsys.readouterr().out


def test_options_reach_the_study_and_the_jobs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = ["grid", "--out", str(tmp_path)]
    assert main([*study, "--methods", "ppo"]) == 2
    assert capsys.readouterr().err.startswith("deep: there is no method 'ppo'; there are sac, ")
    assert main([*study, "--address", "auto"]) == 2
    assert "it needs the backend ray" in capsys.readouterr().err


def test_a_folder_holds_one_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("deep.cli.grid.study_jobs", lambda _: ())
    out = tmp_path / "out"
    study = ["grid", "--out", str(out), "--tasks", "brake", "--seeds", "0", "1"]
    assert main(study) == 0
    before = (out / "study.json").read_bytes()
    assert main([*study, "--methods", "sac"]) == 0  # fewer or more runs of the same settings
    assert main(["grid", "--out", str(out), "--seeds", "0", "1"]) == 0
    capsys.readouterr()
    assert main([*study, "--steps", "400000"]) == 2
    assert capsys.readouterr().err == (
        f"deep: {out} holds a study with steps 1000000, not 400000\n"
    )
    assert main(["grid", "--out", str(out), "--tasks", "brake", "--seeds", "0"]) == 2
    assert capsys.readouterr().err.endswith("holds a study with seeds [0, 1], not [0]\n")
    assert (out / "study.json").read_bytes() == before
    assert main([*study, "--time-limit", "5"]) == 2
    assert "holds a study with rules {" in capsys.readouterr().err
    content = json.loads(before)
    del content["rules"]
    (out / "study.json").write_text(json.dumps(content))
    assert main(study) == 0
