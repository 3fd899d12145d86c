"""The package deep as a whole: its names, and what importing them costs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import deep
from tests.packages import check_name, check_typed_names


@pytest.mark.parametrize("name", deep.__all__)
def test_every_public_name_can_be_imported(name: str) -> None:
    check_name(deep, name)


def test_type_checkers_see_the_names_that_exist() -> None:
    check_typed_names(deep)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'pretrian'"):
        deep.pretrian  # noqa: B018 (the access is the test)


def test_no_public_name_is_a_folder() -> None:
    """Once imported, the folder would take the name's place."""
    folders = {path.name for path in Path(deep.__path__[0]).iterdir()}
    assert not folders & set(deep.__all__)


@pytest.mark.parametrize("name", ["SafetyFilter", "BehaviorCorrection", "Transitions"])
def test_filters_are_deployed_without_torch(name: str) -> None:
    script = f"import sys, deep; deep.{name}; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"torch", "tyro", "onnx"} & set(done.stdout.split())
