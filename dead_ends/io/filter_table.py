"""A safety filter as a file: the allowed actions and the recovery policy of each state.

Two formats, chosen by the suffix, so that a runtime needs only NumPy or only a JSON reader:

    .npz    arrays ``allowed`` (bool, S x A), ``recovery`` (integers, S), ``metadata`` (a string
            that holds a JSON object)
    .json   an object with the same keys: S lists of A booleans, S integers, an object

To apply it in state s to a task action a: execute a if allowed[s, a], else recovery[s].
``metadata`` is for people and tools (how the table was made); no number in it is used.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.io.atomic import atomic_path
from dead_ends.io.errors import located
from dead_ends.io.npz import read_arrays
from dead_ends.model_input import plain_array

__all__ = ["FilterTable", "load_filter", "save_filter"]

KEYS = ("allowed", "recovery", "metadata")


@dataclass(frozen=True, eq=False)
class FilterTable:
    """A safety filter over finite states and actions.

    Attributes:
        allowed: bool (S, A), the actions that pass.
        recovery: int64 (S,), what is executed instead of an action that does not.
        metadata: how the table was made; JSON values.

    Raises:
        ValueError: naming the array, and the state where one is at fault.
    """

    allowed: NDArray[np.bool_]
    recovery: NDArray[np.int64]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "allowed", _allowed(self.allowed))
        object.__setattr__(self, "recovery", _recovery(self.recovery, *self.allowed.shape))
        if not isinstance(self.metadata, Mapping):
            raise ValueError(f"metadata must be an object of JSON, not {self.metadata!r}")


def save_filter(
    path: str | os.PathLike[str],
    allowed: ArrayLike,
    recovery: ArrayLike,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write a safety filter to an npz or a JSON file, by the suffix; whole or not at all.

    Args:
        path: a name that ends in .npz or .json.
        allowed: bool (S, A), as :func:`dead_ends.allowed_actions` gives.
        recovery: integers (S,), as :func:`dead_ends.recovery_policy` gives.
        metadata: JSON values that say how the table was made.

    Raises:
        ValueError: for another suffix, a wrong array or metadata that is not JSON.
    """
    write = {".npz": _write_npz, ".json": _write_json}[_suffix(path)]
    table = FilterTable(
        plain_array("allowed", allowed), plain_array("recovery", recovery), metadata or {}
    )
    try:
        description = json.dumps(dict(table.metadata))
    except TypeError as error:
        raise ValueError(f"metadata: {error}") from None
    with atomic_path(path) as temporary:
        write(temporary, table, description)


def load_filter(path: str | os.PathLike[str]) -> FilterTable:
    """Read a safety filter that :func:`save_filter` wrote.

    Raises:
        ValueError: naming the file and what is wrong with it.
        OSError: if it cannot be read.
    """
    read = {".npz": _read_npz, ".json": _read_json}[_suffix(path)]
    contents = read(Path(path))
    with located(path):
        missing = [key for key in KEYS if key not in contents]
        if missing:
            raise ValueError(f"key {missing[0]!r} is missing")
        allowed, recovery = (np.asarray(contents[key]) for key in KEYS[:2])
        return FilterTable(allowed, recovery, contents["metadata"])


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix
    if suffix not in (".npz", ".json"):
        raise ValueError(f"{path}: a filter's name must end in .npz or .json")
    return suffix


def _write_npz(path: Path, table: FilterTable, description: str) -> None:
    np.savez_compressed(
        path, allowed=table.allowed, recovery=table.recovery, metadata=np.array(description)
    )


def _write_json(path: Path, table: FilterTable, description: str) -> None:
    contents = {
        "allowed": table.allowed.tolist(),
        "recovery": table.recovery.tolist(),
        "metadata": json.loads(description),
    }
    path.write_text(json.dumps(contents), encoding="utf-8")


def _read_npz(path: Path) -> dict[str, Any]:
    contents: dict[str, Any] = read_arrays(path)
    if "metadata" in contents:
        with located(f"{path}: metadata"):
            contents["metadata"] = json.loads(str(contents["metadata"]))
    return contents


def _read_json(path: Path) -> dict[str, Any]:
    with located(path):
        contents = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(contents, dict):
            raise ValueError("the file does not hold a JSON object")
        return contents


def _allowed(array: NDArray[Any]) -> NDArray[np.bool_]:
    if array.dtype != np.bool_:
        raise ValueError(f"allowed must be boolean, not {array.dtype}")
    if array.ndim != 2 or 0 in array.shape:
        raise ValueError(f"allowed must have shape (S, A), not {array.shape}")
    return _frozen(array.copy())


def _recovery(array: NDArray[Any], num_states: int, num_actions: int) -> NDArray[np.int64]:
    if not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"recovery must hold integers, not {array.dtype}")
    if array.shape != (num_states,):
        raise ValueError(f"recovery must have shape ({num_states},), not {array.shape}")
    bad = np.flatnonzero((array < 0) | (array >= num_actions))
    if len(bad):
        raise ValueError(
            f"recovery: state {bad[0]} has action {array[bad[0]]}, "
            f"but actions are 0 to {num_actions - 1}"
        )
    return _frozen(array.astype(np.int64))


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array
