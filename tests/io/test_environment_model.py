"""Keys: what is the same, what is not, and what stands for them in a file."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from typing import Any

import numpy as np
import pytest

from dead_ends.io.environment_model import canonical_key, key_text


class Door(Enum):
    OPEN = 1
    SHUT = 2


@dataclass
class Place:
    x: int
    door: Door = Door.OPEN


class Unhashable(dict[str, int]):
    def __iter__(self) -> Iterator[str]:
        return super().__iter__()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, np.float32(1)),
        (True, 1),
        (0.0, -0.0),
        (float("nan"), np.float64("nan")),
        ([1, (2, 3)], (1.0, [2, np.int8(3)])),
        (np.array([[1, 2], [3, 4]]), [[1, 2], [3, 4]]),
        ({"a": 1, "b": np.zeros(2)}, Unhashable(b=np.zeros(2, int), a=True)),
        ({3, 1, 2}, frozenset((1, 2, 3))),
        (Place(1), Place(1, Door.OPEN)),
    ],
)
def test_keys_that_are_the_same(one: Any, other: Any) -> None:
    assert canonical_key(one) == canonical_key(other)
    assert hash(canonical_key(one)) == hash(canonical_key(other))
    assert key_text(canonical_key(one)) == key_text(canonical_key(other))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, "1"),
        (b"1", "1"),
        ((1, 2), (2, 1)),
        (0.5, 0.25),
        (Place(1), Place(1, Door.SHUT)),
        (None, 0),
    ],
)
def test_keys_that_are_different(one: Any, other: Any) -> None:
    assert canonical_key(one) != canonical_key(other)
    assert key_text(canonical_key(one)) != key_text(canonical_key(other))


def test_a_long_text_is_kept_as_its_digest() -> None:
    assert key_text("x" * 62) == repr("x" * 62)
    assert key_text("x" * 63) == sha256(repr("x" * 63).encode()).hexdigest()


class Plain:
    def __hash__(self) -> int:
        return 1

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plain)


@pytest.mark.parametrize("value", [object(), [lambda: 0], bytearray(b"x")])
def test_what_has_no_value_of_its_own(value: Any) -> None:
    with pytest.raises(
        ValueError, match="a key holds something of type .*, which is not told apart"
    ):
        canonical_key(value)


def test_a_value_without_a_text() -> None:
    assert canonical_key([Plain()]) == (Plain(),)
    with pytest.raises(ValueError, match="has no text that says its value"):
        key_text((Plain(),))
