"""What the commands print of a result."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def seed_lines(seeds: Iterable[dict[str, Any]]) -> Iterable[str]:
    """One line a seed of a result."""
    for entry in seeds:
        violations = "" if entry["tv"] is None else f", {entry['tv']} violations in training"
        yield (
            f"seed {entry['seed']}: ACR {entry['acr']:.3f}, AVR {entry['avr']:.3f}, "
            f"ARR {entry['arr']:.3f}{violations}"
        )
