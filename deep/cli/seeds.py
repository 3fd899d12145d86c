"""What the commands print of a result."""

from __future__ import annotations

from collections.abc import Iterable

from deep.train.result import SeedResult


def seed_lines(seeds: Iterable[SeedResult]) -> Iterable[str]:
    """One line a seed of a result."""
    for one in seeds:
        violations = "" if one.tv is None else f", {one.tv} violations in training"
        yield (
            f"seed {one.seed}: ACR {one.acr:.3f}, AVR {one.avr:.3f}, ARR {one.arr:.3f}{violations}"
        )
