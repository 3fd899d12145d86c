"""What run folders share: logs that survive a kill, locks, versions, and a polite Ctrl-C."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

import deep.runs.folder
from deep.__main__ import main
from deep.runs.folder import (
    CsvLog,
    InterruptAfterUpdate,
    check_unused,
    new_file,
    only_process,
    refuse_empty_names,
    versions,
)


def test_a_log_drops_what_came_after_the_checkpoint_and_half_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    log = CsvLog(path, ("step", "a", "b"), 0)
    assert path.read_text().splitlines() == ["step,a,b"]
    log.write([(10, "x", ""), (10, "y", 2)])
    log.write([(20, "x", 3)])
    log.write([(30, "x", 4)])
    with path.open("a") as file:
        file.write("40,x")
    CsvLog(path, ("step", "a", "b"), 20).write([(25, "z", 5)])
    rows = ["step,a,b", "10,x,", "10,y,2", "20,x,3", "25,z,5"]
    assert path.read_text().splitlines() == rows
    # A row that is written by half may look like a smaller number.
    with path.open("a") as file:
        file.write("2,x,6")
    CsvLog(path, ("step", "a", "b"), 25)
    assert path.read_text().splitlines() == rows
    CsvLog(path, ("step", "a", "b"), 9)
    assert path.read_text().splitlines() == rows[:1]


def test_versions_name_what_the_numbers_hang_on() -> None:
    found = versions()
    assert set(found) == {"numpy", "torch", "gymnasium", "safetensors", "python", "git"}
    assert all(isinstance(version, str) for version in found.values())


def revision_of(copy: Path) -> str:
    """What a copy of the module takes its revision to be."""
    spec = importlib.util.spec_from_file_location("folder_elsewhere", copy)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: str = module.versions()["git"]
    return found


def test_a_revision_is_that_of_the_codes_own_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> str:
        who = ("-c", "user.name=x", "-c", "user.email=x@y")
        command = ["git", "-C", str(tmp_path), *who, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    # An installed copy inside somebody else's repository.
    copy = tmp_path / "venv" / "folder.py"
    copy.parent.mkdir()
    shutil.copy(deep.runs.folder.__file__, copy)
    assert revision_of(copy) == ""
    git("init", "-q")
    (tmp_path / "theirs.txt").write_text("x")
    git("add", "theirs.txt")
    git("commit", "-qm", "theirs")
    assert revision_of(copy) == ""
    # Nor is it that of a repository that a hook is run in.
    own = versions()["git"]
    monkeypatch.setenv("GIT_DIR", str(tmp_path / ".git"))
    monkeypatch.setenv("GIT_WORK_TREE", str(tmp_path))
    assert versions()["git"] == own != git("rev-parse", "HEAD")
    monkeypatch.undo()
    git("add", "-f", "venv/folder.py")
    git("commit", "-qm", "ours")
    assert revision_of(copy) == git("rev-parse", "HEAD")
    (tmp_path / "theirs.txt").write_text("y")
    assert revision_of(copy) == git("rev-parse", "HEAD") + "+"


def test_one_process_works_in_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "run"
    with (
        only_process(folder),
        pytest.raises(
            ValueError, match=f"^{folder}: another process is at work there: .* {os.getpid()} on"
        ),
        only_process(folder),
    ):
        raise AssertionError("two at once")
    assert not (tmp_path / "a").exists()  # nothing was left in it
    with only_process(folder):
        (folder / "x").touch()
    assert [path.name for path in folder.iterdir()] == ["x"]


def test_a_lock_dies_with_its_process(tmp_path: Path) -> None:
    work = (
        "import sys, time; from pathlib import Path; from deep.runs.folder import only_process\n"
        "with only_process(Path(sys.argv[1])): print('at work', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", work, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "at work\n"
    with pytest.raises(ValueError, match=f"process {process.pid} on "), only_process(tmp_path):
        pass
    process.kill()
    process.wait()
    process.stdout.close()
    # The file stays; so it does if the next process runs on another host.
    (tmp_path / ".lock").write_text("process 7 on elsewhere")
    with only_process(tmp_path):
        assert str(os.getpid()) in (tmp_path / ".lock").read_text()
    assert not (tmp_path / ".lock").exists()


def test_new_files_replace_nothing(tmp_path: Path) -> None:
    path = tmp_path / "new" / "data.hdf5"
    with (
        new_file(path),
        pytest.raises(ValueError, match=r"data\.hdf5: another process is at work"),
        new_file(path),
    ):
        pass
    assert not path.parent.exists()  # nothing was made
    path.parent.mkdir()
    path.touch()
    with (
        pytest.raises(ValueError, match=r"data\.hdf5: it is there already; remove it"),
        new_file(path),
    ):
        pass
    assert list(path.parent.iterdir()) == [path]


COMMANDS: dict[str, Callable[[Path], list[str]]] = {
    "collect": lambda out: ["--task", "brake", "--transitions", "300", "--out", str(out)],
    "pretrain": lambda out: ["--task", "brake", "--updates", "1", "--out", str(out)],
    "train": lambda out: ["--task", "brake", "--out", str(out), "sac"],
    "train-offline": lambda out: ["--task", "brake", "--data", "x", "--out", str(out)],
    "evaluate": lambda out: ["--policy", "x", "--out", str(out)],
    "grid": lambda out: ["--tasks", "brake", "--out", str(out)],
    "compare": lambda out: ["--task", "brake", "--out", str(out)],
    "sweep": lambda out: ["--task", "brake", "--out", str(out)],
    "demo": lambda out: ["--out", str(out)],
    "offline-data": lambda out: ["--run-folder", "x", "--seed", "0", "--out", str(out)],
    "choose-threshold": lambda out: ["--run-folder", "x", "--baseline", "x", "--out", str(out)],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_alone_with_its_output(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr("deep.cli.offline_data.training_run", lambda _: SimpleNamespace(task="x"))
    files = ("collect", "offline-data", "choose-threshold")
    with (new_file if command in files else only_process)(out):
        before = sorted(tmp_path.rglob("*"))
        assert main([command, *COMMANDS[command](out)]) == 2
        assert f"deep: {out}: another process is at work there: it is" in capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before


def test_a_run_does_not_begin_among_others_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_unused(tmp_path / "absent")
    # An evaluation's result would say that the training is finished.
    (tmp_path / "result.json").write_text("{}")
    for command in ("pretrain", "train"):
        assert main([command, *COMMANDS[command](tmp_path)]) == 2
        said = f"deep: {tmp_path}: there is result.json of something else; begin in a new folder"
        assert capsys.readouterr().err.strip() == said
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_a_collection_replaces_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "data.hdf5"
    out.write_text("mine")
    assert main(["collect", *COMMANDS["collect"](out)]) == 2
    assert "it is there already" in capsys.readouterr().err
    assert out.read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["pretrain", "--task", "brake", "--out", ""], "--out"),
        (["pretrain", "--out=", "--task", "brake"], "--out"),
        (["collect", "--task", " ", "--out", "x"], "--task"),
    ],
)
def test_empty_names_are_refused(
    arguments: list[str], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err == f"deep: {option}: an empty name\n"
    refuse_empty_names(["--task", "brake"])


def test_an_interrupt_waits_to_be_asked_for() -> None:
    before = signal.getsignal(signal.SIGINT)
    with InterruptAfterUpdate() as interrupt:
        assert not interrupt.asked
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.asked
    assert signal.getsignal(signal.SIGINT) is before


def test_outside_the_main_thread_interrupts_are_left_alone() -> None:
    before = signal.getsignal(signal.SIGINT)
    handlers = []

    def work() -> None:
        with InterruptAfterUpdate() as interrupt:
            handlers.append((signal.getsignal(signal.SIGINT), interrupt.asked))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [(before, False)]
