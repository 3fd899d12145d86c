"""A model of an environment that knows which of the environment's states is which.

A *key* tells the states of an environment apart: a value with all that the future depends on,
such as the observation, or a position together with a velocity. Keys may be numbers, texts,
arrays, or lists, dictionaries and dataclasses of them. Two keys are the same if their canonical
forms are equal:

* arrays and lists become tuples, dictionaries and sets become sorted tuples;
* numbers that are equal become the same number, whatever their type: 1, 1.0 and True.

A filter in a file knows its states by the text of this form, or its SHA-256 if it is long.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["Ended", "EnvironmentModel", "canonical_key", "key_text", "model_of_environment"]

MAX_TEXT = 64
"""The longest text of a key that is kept as it is: as long as a SHA-256 in hexadecimal digits."""


@dataclass(frozen=True)
class Ended:
    """The key of a state in which the episode has ended: not the same place before."""

    key: Hashable


@dataclass(frozen=True, eq=False, repr=False)
class EnvironmentModel(SafeMDP):
    """A safe MDP, with the keys of its states.

    Attributes:
        keys: the keys of the first states in canonical form, ``Ended`` where the episode is over;
            the states after them were added for violations and ends.
        seed: of the environment's reset, which may draw a layout; None: it was not reset.
        table: the SHA-256 of the environment's transition table; None if it has none.
    """

    keys: tuple[Hashable, ...] = ()
    seed: int | None = None
    table: str | None = None

    def state_of(self, key: Any) -> int:
        """The number of the state that has this key.

        Raises:
            ValueError: if there is none.
        """
        place = canonical_key(key)
        if place not in self._numbers:
            raise ValueError(f"no state has the key {short(place)}")
        return self._numbers[place]

    @cached_property
    def _numbers(self) -> dict[Hashable, int]:
        return {key: state for state, key in enumerate(self.keys)}

    def __repr__(self) -> str:
        seed = "" if self.seed is None else f", reset with seed {self.seed}"
        return f"{super().__repr__()[:-1]}{seed})"


def model_of_environment(
    model: SafeMDP,
    keys: Iterable[Hashable],
    *,
    seed: int | None = None,
    table: str | None = None,
) -> EnvironmentModel:
    """The same model with the keys, in canonical form, of its first states, and whose it is."""
    contents = {field.name: getattr(model, field.name) for field in fields(SafeMDP)}
    return EnvironmentModel(**contents, keys=tuple(keys), seed=seed, table=table)


def canonical_key(key: Any) -> Hashable:
    """The canonical form of a key, which is hashed and compared by value.

    Raises:
        ValueError: naming the type of something that is not told apart by its value.
    """
    if key is None or isinstance(key, str | bytes):
        return key
    if isinstance(key, bool | int | float | np.bool_ | np.integer | np.floating):
        return _number(key)
    if isinstance(key, np.ndarray):
        return canonical_key(key.tolist())
    if isinstance(key, list | tuple):
        return tuple(canonical_key(part) for part in key)
    if isinstance(key, Mapping):
        return _sorted((canonical_key(name), canonical_key(key[name])) for name in key)
    if isinstance(key, set | frozenset):
        return _sorted(canonical_key(part) for part in key)
    if isinstance(key, Ended):
        return Ended(canonical_key(key.key))
    if isinstance(key, Enum):
        return type(key).__name__, key.name
    if is_dataclass(key):
        parts = (canonical_key(getattr(key, field.name)) for field in fields(key))
        return type(key).__name__, *parts
    if not isinstance(key, Hashable) or type(key).__hash__ is object.__hash__:
        kind = type(key).__name__
        raise ValueError(
            f"a key holds something of type {kind}, which is not told apart by its value"
        )
    return key


def key_text(key: Hashable) -> str:
    """What stands for a canonical key in a file: its text, or the SHA-256 of a long one.

    Raises:
        ValueError: if a part of the key has no text that says its value.
    """
    text = repr(key)
    if re.search(r" at 0x[0-9a-f]+>", text):
        raise ValueError(f"the key {short(key)} has no text that says its value")
    return text if len(text) <= MAX_TEXT else hashlib.sha256(text.encode()).hexdigest()


def short(key: Hashable) -> str:
    """A key for a sentence."""
    text = repr(key)
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]}..."


def _number(value: Any) -> int | float | str:
    number = value.item() if isinstance(value, np.generic) else value
    if isinstance(number, float) and not number.is_integer():
        return "nan" if math.isnan(number) else number
    return int(number)


def _sorted(parts: Iterable[Hashable]) -> tuple[Hashable, ...]:
    return tuple(sorted(parts, key=repr))
