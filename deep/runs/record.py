"""Values of a known type from a JSON file; what is missing or wrong is named with its place."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

__all__ = ["Record"]

Value = TypeVar("Value")


@dataclass(frozen=True)
class Record:
    """A JSON object that is asked for values of a type.

    Attributes:
        content: what is in the file.
        place: the file, and where in it.

    Raises:
        ValueError: naming place and entry, if it is no object, or an entry is missing or wrong.
    """

    content: Any
    place: str

    def __post_init__(self) -> None:
        if not isinstance(self.content, dict):
            raise ValueError(f"{self.place}: expected an object, not {self.content!r}")

    @classmethod
    def read(cls, path: Path) -> Record:
        """What is in a JSON file."""
        try:
            content = json.loads(path.read_text())
        except (ValueError, OSError) as error:
            raise ValueError(f"{path}: not a readable JSON file ({error})") from error
        return cls(content, str(path))

    def _get(self, key: str) -> Any:
        if key not in self.content:
            raise ValueError(f"{self.place}: {key!r} is missing")
        return self.content[key]

    def _wrong(self, key: str, expected: str) -> ValueError:
        return ValueError(f"{self.place}: {key!r} must be {expected}, not {self.content[key]!r}")

    def text(self, key: str) -> str:
        """A string."""
        value = self._get(key)
        if not isinstance(value, str):
            raise self._wrong(key, "a string")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        value = self._get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(key, "a number")
        if not math.isfinite(value):
            raise self._wrong(key, "finite")
        return float(value)

    def share(self, key: str) -> float:
        """A number in [0, 1]."""
        value = self.number(key)
        if not 0 <= value <= 1:
            raise self._wrong(key, "in [0, 1]")
        return value

    def amount(self, key: str) -> float:
        """A number, not negative."""
        value = self.number(key)
        if value < 0:
            raise self._wrong(key, "at least 0")
        return value

    def count(self, key: str) -> int:
        """A whole number, not negative."""
        value = self.number(key)
        if value < 0 or value != int(value):
            raise self._wrong(key, "a count")
        return int(value)

    def maybe(self, key: str, get: Callable[[str], Value]) -> Value | None:
        """What one of the methods above finds there; None where there is nothing, or null."""
        return get(key) if self.content.get(key) is not None else None

    def record(self, key: str) -> Record:
        """An object."""
        return Record(self._get(key), f"{self.place}, {key!r}")

    def records(self, key: str) -> tuple[Record, ...]:
        """A list of objects."""
        value = self._get(key)
        if not isinstance(value, list):
            raise self._wrong(key, "a list")
        return tuple(Record(item, f"{self.place}, {key!r}") for item in value)

    def texts(self, key: str) -> Mapping[str, str]:
        """An object whose values are written out as strings."""
        return {name: str(value) for name, value in self.record(key).content.items()}
