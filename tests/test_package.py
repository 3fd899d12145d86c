"""The package as a whole: its names, and what importing it costs."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import dead_ends
import deep

PACKAGES = [dead_ends, deep]
NAMES = [(package, name) for package in PACKAGES for name in package.__all__]


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_every_public_name_can_be_imported(package: ModuleType, name: str) -> None:
    value = getattr(package, name)
    if callable(value):
        assert value.__doc__


@pytest.mark.parametrize("package", PACKAGES)
def test_type_checkers_see_the_names_that_exist(package: ModuleType) -> None:
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


@pytest.mark.parametrize("package", PACKAGES)
def test_an_unknown_name_is_an_attribute_error(package: ModuleType) -> None:
    with pytest.raises(AttributeError, match="has no attribute 'clasify'"):
        package.clasify  # noqa: B018 (the access is the test)


def test_no_public_name_of_deep_is_a_folder_of_it() -> None:
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
