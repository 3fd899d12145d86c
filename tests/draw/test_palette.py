"""One palette: no color stands beside it, and no two of its meanings look alike."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import pytest

from dead_ends.draw import palette

ROOT = Path(palette.__file__).parents[2]
MEANINGS = {
    name: value
    for name, value in vars(palette).items()
    if name.isupper() and isinstance(value, str)
}


@pytest.mark.parametrize("folder", ["dead_ends", "deep/score", "deep/tasks", "proofs_check"])
def test_no_color_is_defined_elsewhere(folder: str) -> None:
    places = [
        f"{path.relative_to(ROOT)}: {line}"
        for path in (ROOT / folder).rglob("*.py")
        if path != Path(palette.__file__)
        for line in re.findall(r'.*"#[0-9A-Fa-f]{6}".*', path.read_text(encoding="utf-8"))
    ]
    assert places == []


@pytest.mark.parametrize(("one", "other"), list(combinations(MEANINGS, 2)))
def test_meanings_differ_to_the_eye(one: str, other: str) -> None:
    """By at least a fourteenth of the range in red, green or blue."""
    first, second = palette.rgb(MEANINGS[one]), palette.rgb(MEANINGS[other])
    assert max(abs(a - b) for a, b in zip(first, second, strict=True)) >= 18


def test_rgb() -> None:
    assert palette.rgb("#0B4F8A") == (11, 79, 138)
