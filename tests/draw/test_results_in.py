"""Pictures are drawn of results: what draw imports of the package is types, never a solver."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import dead_ends.draw

MODULES = sorted(Path(dead_ends.draw.__file__).parent.glob("*.py"))


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """(module, name) of what a file takes from other folders of the package."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not any(alias.name.startswith("dead_ends") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            assert node.module is not None
            if node.module.split(".")[0] == "dead_ends" and "dead_ends.draw" not in node.module:
                yield from ((node.module, alias.name) for alias in node.names)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_draw_solves_nothing(path: Path) -> None:
    functions = [
        f"{module}.{name}"
        for module, name in imported(path)
        if not isinstance(getattr(import_module(module), name, import_module), type | int)
    ]
    assert set(functions) <= {"dead_ends.model.safe_mdp.require_type"}
