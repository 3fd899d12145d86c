"""Would the tests notice? Changes one place of a module at a time and runs the module's tests.

    python scripts/mutate.py dead_ends/values/critic.py --sample 50
    python scripts/mutate.py --changed main

A mutant is the module with one small mistake in it: a comparison or an operator exchanged, a
constant moved, a bound taken on the wrong side, a statement or a keyword argument left out,
two arguments swapped. It is killed if a test fails or takes too long, otherwise it survives:
then a test is missing, or the change changes nothing. ``scripts/mutation.toml`` says of those
why, and they are not tried; it also names the tests of modules whose tests are not where the
folders say. A printed survivor is a line of the module, as Python writes it back from the
syntax tree, before and after the change.

Mutants are run one after the other in a copy of the working tree, each in a process forked
from one that has the libraries loaded. Results are added to a file as they come, and a run
that was stopped goes on from there. A killed mutant is tried again if its module has changed,
a survivor also if the tests have.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import json
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = Path(__file__).with_name("mutation.toml")
LIBRARIES = ("numpy", "scipy.optimize", "scipy.sparse.linalg", "numba", "networkx", "pytest")
MEMORY = 8 << 30
"""Bytes that a mutant may ask for: a wrong size must not take the machine down."""


class NotTried(Exception):
    """Why a module's mutants say nothing."""


@dataclass(frozen=True)
class Mutant:
    """A module with one change.

    Attributes:
        module: the path below the root, such as ``dead_ends/values/critic.py``.
        function: where the change is; "" outside functions.
        before, after: the line, or the statement, that is changed.
        nth: counts equal changes of equal lines in one function, from 0.
        line: in the module as it is.
        source: gives the whole module with the change.
    """

    module: str
    function: str
    before: str
    after: str
    nth: int
    line: int
    source: Callable[[], str]

    @property
    def name(self) -> tuple[str, str, str, str, int]:
        """What stays the same while other lines of the module change."""
        return self.module, self.function, self.before, self.after, self.nth


# What is changed

SWAPS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
}
OPPOSITES = [
    ("min", "max"),
    ("minimum", "maximum"),
    ("argmin", "argmax"),
    ("any", "all"),
    ("floor", "ceil"),
    ("lower", "upper"),
    ("shrink", "grow"),
    ("zeros", "ones"),
    ("zeros_like", "ones_like"),
]
OPPOSITE = dict(OPPOSITES) | {b: a for a, b in OPPOSITES}
SYMMETRIC = {"min", "max", "np.minimum", "np.maximum"}
TYPES = {"annotation", "returns", "decorator_list"}
"""Parts of the tree that are for the reader and the type checker."""


@dataclass(frozen=True, eq=False)
class _Place:
    """A node of the tree, and how to put another one there."""

    node: ast.AST
    parent: ast.AST
    field: str
    index: int | None
    statement: ast.stmt
    function: str
    bound: frozenset[str]

    def put(self, node: ast.AST) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


def mutants(module: str, source: str) -> Iterator[Mutant]:
    """Every mutant of a module."""
    tree = ast.parse(source)
    seen: Counter[tuple[str, str, str]] = Counter()
    for place in _places(tree, None, "", frozenset()):
        before = _line(place.statement)
        for node in _replacements(place):
            if ast.dump(node) == ast.dump(place.node):  # equal arguments swapped
                continue
            place.put(node)
            after = "pass" if isinstance(node, ast.Pass) else _line(place.statement)
            place.put(place.node)
            change = (place.function, before, after)
            text = partial(_source, tree, place, node)
            yield Mutant(module, *change, seen[change], place.statement.lineno, text)
            seen[change] += 1


def _source(tree: ast.Module, place: _Place, node: ast.AST) -> str:
    place.put(node)
    text = ast.unparse(ast.fix_missing_locations(tree))
    place.put(place.node)
    return text


def _places(
    node: ast.AST, statement: ast.stmt | None, function: str, bound: frozenset[str]
) -> Iterator[_Place]:
    """Every node below this one whose value is used when the program runs."""
    if isinstance(node, ast.FunctionDef):
        bound = frozenset(
            argument.arg for argument in ast.walk(node.args) if _is_argument(argument)
        )
    for field, value in ast.iter_fields(node):
        if field in TYPES:
            continue
        children = enumerate(value) if isinstance(value, list) else [(None, value)]
        for index, child in children:
            if not isinstance(child, ast.AST) or _for_types(child):
                continue
            inside = child if isinstance(child, ast.stmt) else statement
            if inside is not None:
                yield _Place(child, node, field, index, inside, function, bound)
            name = function
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                name = f"{function}.{child.name}".removeprefix(".")
            yield from _places(child, inside, name, bound)
            if isinstance(child, ast.Assign):
                bound |= {name.id for name in ast.walk(child) if _is_stored(name)}


def _is_argument(node: ast.AST) -> bool:
    return isinstance(node, ast.arg)


def _is_stored(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)


def _for_types(node: ast.AST) -> bool:
    """Assertions, TYPE_CHECKING, and strict=True say what is true anyway."""
    match node:
        case ast.Assert() | ast.keyword(arg="strict"):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case _:
            return False


def _replacements(place: _Place) -> Iterator[ast.AST]:
    """The nodes to try in a place."""
    node = place.node
    yield from (other() for other in SWAPS.get(type(node), ()))
    if place.field == "test" and not isinstance(node, ast.Compare):
        yield ast.UnaryOp(ast.Not(), node)
    match node:
        case ast.Constant(value=bool(truth)):
            yield ast.Constant(not truth)
        case ast.Constant(value=int(number)):
            yield from (ast.Constant(number + 1), ast.Constant(number - 1))
        case ast.Constant(value=float(number)):
            yield from map(ast.Constant, (2 * number, number / 2) if number else (1.0,))
        case ast.UnaryOp(op=ast.Not() | ast.Invert() | ast.USub()):
            yield node.operand
        case ast.Name(id=name, ctx=ast.Load()) if place.field == "func" and name in OPPOSITE:
            yield ast.Name(OPPOSITE[name], node.ctx)
        case ast.Attribute(attr=name, ctx=ast.Load()) if name in OPPOSITE:
            yield ast.Attribute(node.value, OPPOSITE[name], node.ctx)
        case ast.Call():
            yield from _calls(node)
        case ast.Raise() | ast.Break() | ast.Continue() | ast.AugAssign():
            yield ast.Pass()
        case ast.Expr(value=ast.Call()):
            yield ast.Pass()
        case ast.Assign(targets=[target]) if _is_bound(target, place.bound):
            yield ast.Pass()


def _calls(call: ast.Call) -> Iterator[ast.Call]:
    """The call without one of its keywords, and with neighbouring arguments swapped."""
    for keyword in call.keywords:
        if keyword.arg and not _for_types(keyword):
            rest = [other for other in call.keywords if other is not keyword]
            yield ast.Call(call.func, call.args, rest)
    symmetric = ast.unparse(call.func) in SYMMETRIC
    for k in range(0 if symmetric else len(call.args) - 1):
        first, second = call.args[k : k + 2]
        if not isinstance(first, ast.Starred) and not isinstance(second, ast.Starred):
            args = [*call.args[:k], second, first, *call.args[k + 2 :]]
            yield ast.Call(call.func, args, call.keywords)


def _is_bound(target: ast.expr, bound: frozenset[str]) -> bool:
    """Whether the program can go on without this assignment."""
    if isinstance(target, ast.Tuple):
        return all(_is_bound(element, bound) for element in target.elts)
    return not isinstance(target, ast.Name) or target.id in bound


def _line(statement: ast.stmt) -> str:
    """A statement in one line; of a block the line that heads it."""
    text = ast.unparse(ast.fix_missing_locations(statement))
    if hasattr(statement, "body"):
        return next(line for line in text.splitlines() if not line.startswith("@"))
    return " ".join(text.split())


# How it is tried


class Tests:
    """A copy of the working tree in which the tests of one module run."""

    def __init__(self, root: Path, module: str, tests: list[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="mutants-")
        self.copy = Path(self._folder.name) / "copy"
        self.module, self.tests, self.seconds = module, tests, 3600
        listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listing, cwd=root, check=True, capture_output=True, text=True).stdout
        for name in filter(None, names.split("\0")):
            source, target = root / name, self.copy / name
            if source.is_file() and not name.startswith(("results/", "figures/")):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, target)
        self.path = self.copy / module
        self.source = self.path.read_text(encoding="utf-8")
        # Compiled functions are cached by their own file: callers would keep what they inlined.
        package, stem = self.path.parent, self.path.stem
        users = (path.read_text(encoding="utf-8") for path in package.glob("*.py"))
        inlined = any(f".{stem} import" in text and "compiled" in text for text in users)
        self.stale = "*.nbi" if inlined else f"{stem}.*.nbi"

    def __enter__(self) -> Tests:
        """Finds out how much the tests work, and that they pass."""
        _load_libraries([*LIBRARIES, *(["torch"] if self.module.startswith("deep/") else [])])
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        if not self.pass_with(self.source, first=True):
            self._folder.cleanup()
            raise NotTried(f"{self.module}: its tests fail as it is: {' '.join(self.tests)}")
        used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        self.seconds = 5 + int(1.5 * used)
        # Python knows bytecode by a second and a size, and mutants may share both.
        for path in self.path.parent.glob(f"__pycache__/{self.path.stem}.*.pyc"):
            path.unlink()
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def pass_with(self, source: str, first: bool = False) -> bool:
        """Whether all tests pass with this source of the module, without working much longer."""
        self.path.write_text(source, encoding="utf-8")
        for path in self.copy.rglob(self.stale):
            path.unlink()
        process = multiprocessing.get_context("fork").Process(target=self._run, args=(first,))
        process.start()
        try:
            process.join(60 + 10 * self.seconds)
        finally:
            with suppress(ProcessLookupError):  # also what its tests have started
                os.killpg(process.pid or 0, signal.SIGKILL)
            process.kill()
            process.join()
        return process.exitcode == 0

    def _run(self, first: bool) -> None:
        """In a process of its own; the first leaves its bytecode to the others."""
        os.setsid()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.chdir(self.copy)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (self.seconds, self.seconds))
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        sys.dont_write_bytecode = not first
        os.environ |= {"PYTHONPATH": str(self.copy), "PYTHONDONTWRITEBYTECODE": "1", "CI": "1"}
        sys.path.insert(0, str(self.copy))
        import pytest

        options = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-profile=mutation"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # of loaded libraries
        os._exit(pytest.main([*options, *self.tests]))


def _load_libraries(libraries: list[str]) -> None:
    """What every test needs, once. Failing examples of Hypothesis need not be made small."""
    from hypothesis import Phase, settings

    phases = [Phase.explicit, Phase.generate]
    settings.register_profile(
        "mutation", deadline=None, derandomize=True, database=None, phases=phases
    )
    for library in libraries:
        with suppress(ImportError):
            importlib.import_module(library)


# What is known


class Results:
    """A file with a line of JSON for every mutant that was tried."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._known: dict[tuple[str, ...], dict[str, Any]] = {}
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        for line in text.splitlines():
            with suppress(json.JSONDecodeError):  # the last line of a run that was killed
                self._remember(json.loads(line))
        self._unfinished = "" if text.endswith("\n") or not text else "\n"

    def _remember(self, result: dict[str, Any]) -> None:
        self._known[result["module"], *result["mutant"]] = result

    def killed(self, mutant: Mutant, code: str, tests: str) -> bool | None:
        """What came out; None if it is not known, or no longer."""
        result = self._known.get((mutant.module, *_words(mutant)))
        if result is None or result["code"] != code:
            return None
        return True if result["killed"] else False if result["tests"] == tests else None

    def add(self, mutant: Mutant, code: str, tests: str, killed: bool) -> None:
        """One more."""
        result = {
            "module": mutant.module,
            "line": mutant.line,
            "killed": killed,
            "mutant": _words(mutant),
            "code": code,
            "tests": tests,
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(self._unfinished + json.dumps(result) + "\n")
        self._unfinished = ""
        self._remember(result)


def _words(mutant: Mutant) -> list[str]:
    return [str(part) for part in mutant.name[1:]]


def read_settings(path: Path) -> dict[str, Any]:
    """Tests and explained mutants, see the file itself."""
    return tomllib.loads(path.read_text(encoding="utf-8"))


def equivalent(settings: dict[str, Any], module: str) -> set[tuple[Any, ...]]:
    """The names of the mutants of a module of which it is known that they change nothing."""
    return {
        (module, each["function"], each["before"], after, nth)
        for each in settings.get("equivalent", {}).get(module, [])
        for after in ([each["after"]] if isinstance(each["after"], str) else each["after"])
        for nth in each.get("nth", [0])
    }


def mapped_tests(settings: dict[str, Any], module: str, root: Path) -> list[str]:
    """The files with a module's tests."""
    known: dict[str, list[str]] = settings.get("tests", {})
    path = Path(module)
    below = Path(*path.parts[1:-1]) if path.parts[0] == "dead_ends" else path.parent
    tests = known.get(module, [str(Path("tests") / below / f"test_{path.name}")])
    for test in tests:
        if not (root / test.split("::")[0]).is_file():
            raise NotTried(f"{module}: no {test}; name its tests in {SETTINGS.name}")
    return tests


def judge(
    root: Path, module: str, settings: dict[str, Any], results: Results, sample: int, seed: int
) -> list[Mutant]:
    """The survivors among a module's mutants, or a sample of them."""
    tests = mapped_tests(settings, module, root)
    source = (root / module).read_text(encoding="utf-8")
    code = _digest(source)
    of_tests = _digest(*((root / test.split("::")[0]).read_text("utf-8") for test in tests))
    nothing = equivalent(settings, module)
    every = list(mutants(module, source))
    chosen = [mutant for mutant in every if mutant.name not in nothing]
    for name in sorted(nothing - {mutant.name for mutant in every}):
        print(f"{module}: {SETTINGS.name} explains a mutant that is none: {name[1:]}")
    chosen.sort(key=lambda mutant: _digest(str(seed), *_words(mutant)))
    chosen = chosen[:sample] if sample else chosen
    unknown = [each for each in chosen if results.killed(each, code, of_tests) is None]
    if unknown:
        with Tests(root, module, tests) as runs:
            for mutant in unknown:
                results.add(mutant, code, of_tests, not runs.pass_with(mutant.source()))
    survivors = [each for each in chosen if not results.killed(each, code, of_tests)]
    print(f"{module}: {len(chosen) - len(survivors)} of {len(chosen)} killed", flush=True)
    for each in survivors:
        print(f"  line {each.line}, {each.function}:\n    {each.before}\n    {each.after}")
    return survivors


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def changed_since(base: str) -> list[str]:
    """The modules of the package that differ from a revision."""
    listing = ["git", "diff", "--name-only", "--diff-filter=d", base, "--", "dead_ends", "deep"]
    names = subprocess.run(listing, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in names.split() if name.endswith(".py")]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("modules", nargs="*", help="such as dead_ends/values/critic.py")
    parser.add_argument("--changed", metavar="BASE", help="the modules changed since a revision")
    parser.add_argument(
        "--sample",
        type=int,
        default=0,
        help="mutants a module, at most; a larger sample holds the smaller ones",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--results", type=Path, default=ROOT / ".mutants.jsonl")
    options = parser.parse_args()
    if options.sample < 0:
        parser.error(f"--sample must not be negative, not {options.sample}")
    for module in options.modules:
        if not (ROOT / module).is_file():
            parser.error(f"there is no {module} below {ROOT}")
    modules = options.modules + (changed_since(options.changed) if options.changed else [])
    settings = read_settings(SETTINGS)
    results = Results(options.results)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))  # and cleans up
    os.environ.pop("NUMBA_CACHE_DIR", None)  # each copy keeps what it compiles to itself
    wanting = 0
    for module in modules:
        try:
            survivors = judge(ROOT, module, settings, results, options.sample, options.seed)
        except NotTried as reason:
            print(reason, flush=True)
            wanting += 1
        else:
            wanting += len(survivors)
    sys.exit(1 if wanting else 0)


if __name__ == "__main__":
    main()
