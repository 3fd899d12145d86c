"""How readers say what is wrong or odd: every message begins with the place."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import import_module
from typing import Any


class MissingDependencyError(ImportError):
    """An optional package is needed and not installed."""


class NoFailureWarning(UserWarning):
    """What says which states fail selects none of them: failure is impossible."""


_PLACES: ContextVar[tuple[str, ...]] = ContextVar("places", default=())
"""The places around what runs, from the outermost."""


@contextmanager
def located(place: str | os.PathLike[str]) -> Iterator[None]:
    """Put the place, usually a file, before a ValueError's message and before what is warned of."""
    token = _PLACES.set((*_PLACES.get(), str(place)))
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None
    finally:
        _PLACES.reset(token)


def warn_no_failure(selection: str) -> None:
    """Say that one of the ways to say which states fail, a sentence's beginning, selects none."""
    message = ": ".join((*_PLACES.get(), f"{selection}, so that failure by it is impossible"))
    warnings.warn(message, NoFailureWarning, stacklevel=2)


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
