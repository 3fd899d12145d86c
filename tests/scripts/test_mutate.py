"""The mutation run: which changes it makes, and that it tells kills from survivors."""

from __future__ import annotations

import ast
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "mutate.py"


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mutate", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutate"] = module  # where dataclasses look for their own module
    spec.loader.exec_module(module)
    return module


mutate = script()


def changes(source: str) -> list[tuple[str, str]]:
    return [(mutant.before, mutant.after) for mutant in mutate.mutants("m.py", source)]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("a < b", ["a <= b", "a >= b"]),
        ("a == b", ["a != b"]),
        ("a <= b < c", ["a < b < c", "a > b < c", "a <= b <= c", "a <= b >= c"]),
        ("a + b * c", ["a - b * c", "a + b / c"]),
        ("a and b", ["a or b"]),
        ("not a", ["a"]),
        ("~a & b", ["~a | b", "a & b"]),
        ("-a", ["a"]),
        ("3", ["4", "2"]),
        ("0.5", ["1.0", "0.25"]),
        ("True", ["False"]),
        ("'word'", []),
        ("min(a)", ["max(a)"]),
        ("a.any()", ["a.all()"]),
        ("shrink(a)", ["grow(a)"]),
        ("a if b else c", ["a if not b else c"]),
        ("f(a, b, k=c)", ["f(a, b)", "f(b, a, k=c)"]),
        ("f(a, a)", []),
        ("np.minimum(a, b)", ["np.maximum(a, b)"]),
        ("zip(a, *b, strict=True)", []),
    ],
)
def test_what_is_changed_in_an_expression(line: str, expected: list[str]) -> None:
    assert sorted(changes(f"x = {line}")) == sorted((f"x = {line}", f"x = {e}") for e in expected)


def test_statements_that_are_left_out() -> None:
    source = """
def f(a: int | None, b=None):
    '''Not changed: this text, types, and what is only said to be true.'''
    a = g
    c = a
    a[c] = b
    c += b
    h(c)
    assert a < c
    for each in c:
        break
    if a:
        raise error
    return c
"""
    left_out = ["a = g", "a[c] = b", "c += b", "h(c)", "break", "raise error"]
    expected = [(line, "pass") for line in left_out]
    expected += [("c += b", "c -= b"), ("if a:", "if not a:")]
    assert sorted(changes(source)) == sorted(expected)


def test_every_mutant_is_one_module_with_a_name_of_its_own() -> None:
    source = (ROOT / "deep" / "data" / "normalisation.py").read_text(encoding="utf-8")
    whole = ast.unparse(ast.parse(source))
    every = list(mutate.mutants("deep/data/normalisation.py", source))
    assert len({mutant.name for mutant in every}) == len(every) > 100
    for mutant in every:
        compile(mutant.source(), "m.py", "exec")
        assert mutant.source() != whole
    inside = {mutant.function for mutant in every}
    assert {"", "normalise", "_moments"} <= inside


def test_every_explanation_is_one() -> None:
    """Those of lines that have changed since are reported by the script itself."""
    explained = mutate.read_settings(mutate.SETTINGS)["equivalent"]
    for module, mutants in explained.items():
        assert (ROOT / module).is_file()
        assert len(mutate.equivalent({"equivalent": explained}, module)) >= len(mutants)
        assert all(len(each["reason"]) > 20 for each in mutants)


MODULE = """
def bound(x):
    return x + 2
"""
TESTS = """
from dead_ends.bounds import bound

def test_bound():
    assert bound(3) >= 3
"""
EXPLAINED = """
[[equivalent."dead_ends/bounds.py"]]
function = "bound"
before = "return x + 2"
after = ["return x + 3", "return x + 1"]
reason = "Any bound will do."
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A repository with one module, whose test asks for too little; and the script."""
    for name, text in (
        ("dead_ends/bounds.py", MODULE),
        ("dead_ends/__init__.py", ""),
        ("tests/test_bounds.py", TESTS),
        ("scripts/mutation.toml", ""),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    shutil.copy(SCRIPT, tmp_path / "scripts")
    subprocess.run(["git", "init", "--quiet"], cwd=tmp_path, check=True)
    return tmp_path


def run(project: Path, module: str = "dead_ends/bounds.py") -> tuple[int, str]:
    command = [sys.executable, "scripts/mutate.py", module]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_a_survivor_is_told_from_a_kill_and_results_are_kept(project: Path) -> None:
    status, text = run(project)
    assert status == 1
    assert "dead_ends/bounds.py: 1 of 3 killed" in text
    for after in ("return x + 3", "return x + 1"):
        assert f"  line 3, bound:\n    return x + 2\n    {after}\n" in text
    assert (project / "dead_ends" / "bounds.py").read_text() == MODULE
    kept = project / ".mutants.jsonl"
    results = [json.loads(line) for line in kept.read_text().splitlines()]
    assert [each["killed"] for each in results if "x - 2" in each["mutant"][2]] == [True]

    # Stopped in the middle of a line: what was complete is not tried again.
    (project / "tests" / "test_bounds.py").rename(project / "tests" / "test_other.py")
    kept.write_text(kept.read_text() + '{"module": "dead_')
    assert "no tests/test_bounds.py; name its tests in mutation.toml" in run(project)[1]
    (project / "tests" / "test_other.py").rename(project / "tests" / "test_bounds.py")
    assert run(project) == (status, text)

    status, text = run(project, "dead_ends/bond.py")
    assert (status, "there is no dead_ends/bond.py below" in text) == (2, True)

    # Survivors that are explained are not tried; a sharper test kills them all.
    settings = project / "scripts" / "mutation.toml"
    settings.write_text(EXPLAINED)
    assert run(project) == (0, "dead_ends/bounds.py: 1 of 1 killed\n")
    settings.write_text(EXPLAINED.replace("x + 1", "x - 1"))
    assert "mutation.toml explains a mutant that is none: ('bound'," in run(project)[1]
    settings.write_text("")
    (project / "tests" / "test_bounds.py").write_text(TESTS.replace(">= 3", "== 5"))
    assert run(project) == (0, "dead_ends/bounds.py: 3 of 3 killed\n")
    (project / "tests" / "test_bounds.py").write_text(TESTS.replace(">= 3", "== 4"))
    (project / "dead_ends" / "bounds.py").write_text(MODULE.replace("2", "9"))
    assert run(project)[1].endswith("its tests fail as it is: tests/test_bounds.py\n")
