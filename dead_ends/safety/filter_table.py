"""A safety filter as a file: the allowed actions and the recovery policy of each state.

Two formats, chosen by the suffix, so that a runtime needs only NumPy or only a JSON reader:

    .npz    arrays ``allowed`` (bool, S x A), ``recovery`` (integers, S), ``metadata`` (a string
            that holds a JSON object)
    .json   an object with the same keys: S lists of A booleans, S integers, an object

To apply it in state s to a task action a: execute a if allowed[s, a], else recovery[s].
``metadata`` is for people and tools: it says how the table was made.

Three lists of strings may be there too: ``state_names`` (S), ``action_names`` (A) and ``keys``,
which say for the first states by which key their environment knows them, see
:mod:`dead_ends.io.environment_model`. The states after them were added for violations and ends.
``metadata["table"]``, if it is there, tells the environment's transition table from others.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from dead_ends.io.environment_model import canonical_key, key_text
from dead_ends.io.errors import located
from dead_ends.io.npz import read_arrays
from dead_ends.model.checks import Names, plain_array, read_only
from dead_ends.model.policy_table import check_actions
from dead_ends.model.safe_mdp import require_type

__all__ = ["FilterTable", "load_filter", "save_filter"]

KEYS = ("allowed", "recovery", "metadata")
NAMES = ("state_names", "action_names", "keys")


@dataclass(frozen=True, eq=False)
class FilterTable:
    """A safety filter over finite states and actions.

    Attributes:
        allowed: bool (S, A), the actions that pass.
        recovery: int64 (S,), what is executed instead of an action that does not.
        metadata: how the table was made; JSON values.
        state_names, action_names: S and A names, or None.
        keys: the texts of the first states' keys, each once, or None.

    Raises:
        ValueError: naming the array, and the state where one is at fault.
    """

    allowed: NDArray[np.bool_]
    recovery: NDArray[np.int64]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    state_names: Sequence[str] | None = None
    action_names: Sequence[str] | None = None
    keys: Sequence[str] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "allowed", _allowed(plain_array("allowed", self.allowed)))
        recovery = check_actions("recovery", self.recovery, Names(None, None, *self.allowed.shape))
        object.__setattr__(self, "recovery", read_only(recovery))
        if not isinstance(self.metadata, Mapping):
            raise ValueError(f"metadata must be an object of JSON, not {self.metadata!r}")
        num_states, num_actions = self.allowed.shape
        for name, least, most in (
            ("state_names", num_states, num_states),
            ("action_names", num_actions, num_actions),
            ("keys", 0, num_states),
        ):
            object.__setattr__(self, name, _strings(getattr(self, name), name, least, most))
        if self.keys is not None and len(self._numbers) < len(self.keys):
            raise ValueError("keys: two states have the same key")

    def find(self, key: Any) -> int | None:
        """The number of the state that the environment knows by this key; None if there is none."""
        return self._numbers.get(key_text(canonical_key(key)))

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {key: state for state, key in enumerate(self.keys or ())}


def save_filter(table: FilterTable, path: str | os.PathLike[str]) -> None:
    """Write a safety filter to an npz or a JSON file, by the suffix; whole or not at all.

    Args:
        table: the filter, as :func:`dead_ends.safety_filter` gives.
        path: a name that ends in .npz or .json.

    Raises:
        ValueError: for another suffix, or metadata that is not JSON.
    """
    require_type(table, FilterTable, "save_filter")
    write = {".npz": _write_npz, ".json": _write_json}[_suffix(path)]
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
        names = (contents.get(name) for name in NAMES)
        return FilterTable(allowed, recovery, contents["metadata"], *names)


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix
    if suffix not in (".npz", ".json"):
        raise ValueError(f"{path}: a filter's name must end in .npz or .json")
    return suffix


def _write_npz(path: Path, table: FilterTable, description: str) -> None:
    arrays: dict[str, Any] = {
        "allowed": table.allowed,
        "recovery": table.recovery,
        "metadata": np.array(description),
    }
    arrays |= {name: np.array(strings, dtype=np.str_) for name, strings in _names(table).items()}
    np.savez_compressed(path, **arrays)


def _write_json(path: Path, table: FilterTable, description: str) -> None:
    contents = {
        "allowed": table.allowed.tolist(),
        "recovery": table.recovery.tolist(),
        "metadata": json.loads(description),
        **_names(table),
    }
    path.write_text(json.dumps(contents), encoding="utf-8")


def _read_npz(path: Path) -> dict[str, Any]:
    contents: dict[str, Any] = read_arrays(path)
    if "metadata" in contents:
        with located(f"{path}: metadata"):
            contents["metadata"] = json.loads(str(contents["metadata"]))
    for name in contents.keys() & set(NAMES):
        contents[name] = contents[name].tolist()
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
    return read_only(array.copy())


def _names(table: FilterTable) -> dict[str, list[str]]:
    """The lists of strings that the table has."""
    given = {name: getattr(table, name) for name in NAMES}
    return {name: list(strings) for name, strings in given.items() if strings is not None}


def _strings(strings: Any, name: str, least: int, most: int) -> tuple[str, ...] | None:
    if strings is None:
        return None
    if not isinstance(strings, list | tuple) or not all(isinstance(s, str) for s in strings):
        raise ValueError(f"{name} must be a list of strings")
    if not least <= len(strings) <= most:
        raise ValueError(f"{name} must have {most} entries, not {len(strings)}")
    return tuple(strings)
