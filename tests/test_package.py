"""The package as a whole: its names, and what importing it costs."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import dead_ends
from tests.packages import check_name, check_typed_names


@pytest.mark.parametrize("name", dead_ends.__all__)
def test_every_public_name_can_be_imported(name: str) -> None:
    check_name(dead_ends, name)


def test_type_checkers_see_the_names_that_exist() -> None:
    check_typed_names(dead_ends)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'clasify'"):
        dead_ends.clasify  # noqa: B018 (the access is the test)


def test_importing_the_package_imports_nothing_heavy() -> None:
    """numba, scipy and matplotlib are imported by those who need them."""
    script = "import sys, dead_ends; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"numba", "scipy", "matplotlib", "numpy"} & set(done.stdout.split())


def test_models_are_built_without_numba() -> None:
    """Nor are models: numba is imported at the first solve."""
    script = (
        "import sys, numpy, dead_ends; "
        "dead_ends.SafeMDP.deterministic([[0]], numpy.array([False])); "
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"numba", "scipy", "matplotlib"} & set(done.stdout.split())


PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
REQUIREMENTS = [
    *PROJECT["dependencies"],
    *(line for extra in PROJECT["optional-dependencies"].values() for line in extra),
]


@pytest.mark.parametrize("requirement", sorted(set(REQUIREMENTS)))
def test_every_dependency_names_its_lowest_version(requirement: str) -> None:
    """CI installs those of the exact half and runs its tests with them."""
    assert requirement.startswith("dead-ends[") or ">=" in requirement


def test_one_package_has_one_lowest_version() -> None:
    lowest: dict[str, set[str]] = {}
    for requirement in REQUIREMENTS:
        name, _, version = requirement.partition(">=")
        lowest.setdefault(name.partition("[")[0], set()).add(version.partition(",")[0])
    lowest.pop("dead-ends")
    assert {name for name, versions in lowest.items() if len(versions) > 1} == set()


def test_the_list_of_commands_costs_no_solver() -> None:
    script = (
        "import sys; from dead_ends.__main__ import make_parser; make_parser().format_help(); "
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    heavy = {"numba", "scipy", "matplotlib", "networkx", "gymnasium"}
    assert not heavy & set(done.stdout.split())
