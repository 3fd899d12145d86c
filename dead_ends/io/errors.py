"""How readers say what is wrong: every message begins with the place."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any


class MissingDependencyError(ImportError):
    """An optional package is needed and not installed."""


@contextmanager
def located(place: str | os.PathLike[str]) -> Iterator[None]:
    """Put the place, usually a file, before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None


def optional_module(name: str, purpose: str, extra: str) -> Any:
    """The module ``name``, or an error that says what it is needed for.

    Raises:
        MissingDependencyError: naming the package and the extra that brings it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:
            raise
        raise MissingDependencyError(
            f"{purpose} needs the package {error.name}: pip install 'dead-ends[{extra}]'"
        ) from None
