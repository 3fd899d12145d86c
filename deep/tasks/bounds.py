"""Within what the numbers of a task lie: its actions, and what was seen of its observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

__all__ = ["CONSTANT", "LARGEST", "LEAST", "ROUNDING", "Bounds", "action_bounds"]


ROUNDING = 1e-3
"""The share by which it may be narrower: logged actions are rounded."""

LARGEST, LEAST = float(np.finfo(np.float32).max), float(np.finfo(np.float32).tiny)
"""What networks compute in holds no greater number, and none nearer to 0 in full precision."""


CONSTANT = 1e-6
"""A coordinate that deviates by less, relative to its size or 1, is constant up to rounding."""


@dataclass(frozen=True)
class Bounds:
    """low <= x <= high, one number a coordinate.

    Attributes:
        low, high: the ends; finite in single precision.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.low) != len(self.high):
            raise ValueError(f"bounds: {len(self.low)} lower ends for {len(self.high)} upper ones")
        if not all(abs(x) <= LARGEST for x in (*self.low, *self.high)):
            raise ValueError(f"bounds must be finite, not {self}, in single precision")
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError(f"bounds must not cross, as {self} do")

    def __str__(self) -> str:
        return f"{_numbers(self.low)} to {_numbers(self.high)}"

    @classmethod
    def of(cls, low: NDArray[Any], high: NDArray[Any]) -> Bounds:
        """From arrays, each of one number a coordinate."""
        return cls(tuple(low.astype(float).tolist()), tuple(high.astype(float).tolist()))

    @classmethod
    def covered(cls, rows: NDArray[Any]) -> Bounds:
        """The least and the greatest of rows (n, d)."""
        return cls.of(rows.min(axis=0), rows.max(axis=0))

    @classmethod
    def unit(cls, dim: int) -> Bounds:
        """[-1, 1] in every coordinate."""
        return cls((-1.0,) * dim, (1.0,) * dim)

    def widened(self, share: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Low and high (d,), moved apart by a share of the width and by rounding, at each end."""
        low, high = np.array(self.low), np.array(self.high)
        size = np.maximum(1, np.maximum(abs(low), abs(high)))
        margin = share * (high - low) + CONSTANT * size
        return low - margin, high + margin


def _numbers(values: Sequence[float]) -> str:
    """(a, b, ...), a long list cut in its middle."""
    shown = [f"{x:.4g}" for x in values]
    shown = shown if len(shown) <= 8 else [*shown[:6], "...", shown[-1]]
    return f"({', '.join(shown)})"


def action_bounds(space: Any) -> Bounds:
    """The bounds of an environment's actions, in its own units.

    Raises:
        ValueError: if they are not vectors of real numbers within finite bounds.
    """
    if isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary):
        raise ValueError(
            f"discrete actions are not for this filter: it corrects vectors of real numbers, and "
            f"the environment's actions are {space}"
        )
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"the environment's actions must be vectors (Box), not {space}")
    if not np.issubdtype(space.dtype, np.floating):
        raise ValueError(f"the environment's actions must be real numbers, not {space.dtype}")
    if not space.is_bounded():
        raise ValueError(
            f"the environment's actions are not bounded ({space}); a filter needs finite bounds: "
            "rescale them in a wrapper, and put ClipAction around the filter, not within it"
        )
    return Bounds.of(space.low, space.high)
