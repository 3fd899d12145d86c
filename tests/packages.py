"""What holds of both packages' lists of public names."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType


def check_name(package: ModuleType, name: str) -> None:
    """It can be imported, and says what it is."""
    value = getattr(package, name)
    if callable(value):
        assert value.__doc__


def check_typed_names(package: ModuleType) -> None:
    """Type checkers see the names that exist, from the modules where they are."""
    assert package.__file__
    tree = ast.parse(Path(package.__file__).read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {
        (alias.name, node.module)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    listed = package._MODULE_OF.items()
    assert seen == {(name, f"{package.__name__}.{module}") for name, module in listed}
