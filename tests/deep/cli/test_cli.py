"""The commands of ``python -m deep``: that they are all there, what they cost, what is missing."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import deep.cli
from deep.__main__ import PACKAGES, main

ROOT = Path(__file__).parents[3]


def test_every_command_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(deep.cli.__file__).parent
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__", "seeds"}
    assert {name.replace("-", "_") for name in deep.cli.COMMANDS} == modules
    with pytest.raises(SystemExit, match="^0$"):
        main(["--help"])
    listed = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.strip()}
    assert listed > set(deep.cli.COMMANDS)


@pytest.mark.parametrize("command", deep.cli.COMMANDS)
def test_a_command_describes_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="^0$"):
        main([command, "--help"])
    assert capsys.readouterr().out.startswith(f"usage: python -m deep {command} [-h] ")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "deep: the following arguments are required: COMMAND"),
        (["pretrian", "--out", "x"], "deep: argument COMMAND: invalid choice: 'pretrian'"),
        (["--out", "x", "train"], "deep: the following arguments are required: COMMAND"),
    ],
)
def test_a_wrong_command_is_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="^2$"):
        main(arguments)
    err = capsys.readouterr().err
    assert err.startswith(said)
    assert err.endswith("(see python -m deep --help)\n")
    assert err.count("\n") == 1


def imported(*arguments: str) -> set[str]:
    """The packages that are in memory when ``python -m deep ARGUMENTS`` ends."""
    script = (
        "import atexit, sys\n"
        "atexit.register(lambda: print('\\n', *{m.split('.')[0] for m in sys.modules}))\n"
        "from deep.__main__ import main\n"
        f"main({list(arguments)})"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(done.stdout.splitlines()[-1].split())


def test_the_list_of_commands_costs_nothing() -> None:
    heavy = {*PACKAGES, "numpy", "scipy", "numba", "matplotlib", "ray"}
    assert not heavy & imported("--help")


@pytest.mark.parametrize("command", ["choose-threshold", "report"])
def test_who_only_reads_results_needs_no_torch(command: str) -> None:
    assert not {"torch", "gymnasium"} & imported(command, "--help")


def test_without_the_extra_one_sentence_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("torch", "tyro"):
        monkeypatch.setitem(sys.modules, package, None)
    for arguments in ([], ["demo"], ["train", "--help"]):
        assert main(arguments) == 2
        assert capsys.readouterr() == (
            "",
            "deep: it needs torch, tyro: pip install 'dead-ends[deep]'\n",
        )
    with pytest.raises(SystemExit, match="^0$"):
        main(["--help"])


def test_the_extra_brings_what_is_looked_for() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    brought = [
        line.split(">=")[0]
        for extra in ("gym", "deep")
        for line in extras["optional-dependencies"][extra]
    ]
    assert {*PACKAGES, "dead-ends[gym]"} == set(brought)
