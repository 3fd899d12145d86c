"""The pages under docs/ and the README say what is true: their examples are run."""

from __future__ import annotations

import contextlib
import doctest
import io
import re
import shlex
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from dead_ends import SafeMDP, load_filter, save_filter, save_model
from dead_ends.__main__ import main
from dead_ends.safety.filter_table import FilterTable

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_tutorial_runs() -> None:
    failed, tried = doctest.testfile(
        str(ROOT / "docs" / "tutorial.md"),
        module_relative=False,
        optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS,
    )
    assert tried > 20
    assert failed == 0


MODELS = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
NEEDS = {"robot.prism": "stormpy", "MiniGrid-LavaGapS5-v0": "minigrid"}


def run_command(line: str) -> None:
    """What one sees in a terminal, on either stream, of ``python -m dead_ends ...``."""
    python, module, package, *arguments = shlex.split(line)
    assert (python, module, package) == ("python", "-m", "dead_ends")
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        main(arguments)
    print(said.getvalue(), end="")


def test_the_page_about_models_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its commands, too, each with its output."""
    monkeypatch.chdir(tmp_path)
    text = re.sub(r"^    \$ (.*)$", r"    >>> run_command(r'''\1''')", MODELS, flags=re.MULTILINE)
    test = doctest.DocTestParser().get_doctest(
        text, {"run_command": run_command}, "models.md", "docs/models.md", 0
    )
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    runner.run(test)
    assert runner.summarize() == (0, len(test.examples))
    assert sum("run_command" in example.source for example in test.examples) > 6


@pytest.mark.parametrize("command", re.findall(r"^\|.*`(python -m .*)` \|$", MODELS, re.MULTILINE))
def test_each_format_has_a_command_that_runs(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = shlex.split(command)[4]
    if source in NEEDS:
        pytest.importorskip(NEEDS[source], reason=f"{NEEDS[source]} is not installed")
    monkeypatch.chdir(tmp_path)
    model = SafeMDP.deterministic([[0, 1], [1, 1]], np.array([False, True]))
    for name in ("model.npz", "model.tra", "model.drn"):
        save_model(model, name)
    Path("robot.prism").write_text(
        "mdp const int N; module robot x : [0..N] init 1; [left] x>0 -> (x'=x-1); "
        '[stay] true -> true; endmodule label "pit" = x=0;'
    )
    assert main(shlex.split(command)[3:]) == 0
    assert capsys.readouterr().out.startswith(f"{source}: ")


def test_the_runtime_needs_no_package_at_all(tmp_path: Path) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", MODELS, re.DOTALL)
    allowed = np.random.default_rng(0).random((20, 3)) < 0.5
    save_filter(FilterTable(allowed, np.arange(20) % 3), tmp_path / "filter.json")
    table = load_filter(tmp_path / "filter.json")
    script = block + (
        "\nruntime = SafetyFilter('filter.json')\n"
        "print(*[runtime(s, a) for s in range(20) for a in range(3)])\n"
    )
    done = subprocess.run(  # without site-packages
        [sys.executable, "-I", "-S", "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    expected = [
        a if table.allowed[s, a] else int(table.recovery[s])
        for s, a in product(range(20), range(3))
    ]
    assert [int(action) for action in done.stdout.split()] == expected


def test_the_examples_of_the_readme_run() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert blocks
    for block in blocks:
        exec(block, {})  # the reader would, too


README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_commands_of_the_readme_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an empty folder: what one reads, an earlier one has written."""
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^    python -m dead_ends (.*)$", README, re.MULTILINE)
    assert len(commands) > 3
    for command in commands:
        assert main(shlex.split(command, comments=True)) == 0, command


def test_the_first_line_of_the_readme_installs_what_its_commands_need() -> None:
    installs = re.findall(r"^    pip install (?:-c \S+ )?-e (\S+)", README, re.MULTILINE)
    assert installs == ['".[gym]"', '".[deep]"', '".[test]"']


def test_the_cpu_wheel_is_advised_before_a_line_downloads_torch() -> None:
    assert 0 < README.find("CPU wheel") < README.find('".[deep]"') < README.find('".[test]"')


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_tests_exist(page: Path) -> None:
    for name in re.findall(r"`((?:tests|proofs_check)/[\w/.]+)`", page.read_text()):
        assert (ROOT / name).exists(), name
