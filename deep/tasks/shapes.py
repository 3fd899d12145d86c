"""Discs and rectangles: obstacles as sets, and as something to draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Disc", "Outside", "Rectangle", "Shape", "inside_any", "nearest_point"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Disc:
    """The closed disc around (x, y)."""

    x: float
    y: float
    radius: float

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """bool (n,) for points (n, 2); the edge belongs to the disc."""
        offset = points - (self.x, self.y)
        return np.asarray((offset**2).sum(axis=-1) <= self.radius**2)

    def nearest(self, points: Floats) -> Floats:
        """float (n, 2): the disc's point that is nearest to each point outside it."""
        offset = points - (self.x, self.y)
        length = np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-12)
        return np.asarray((self.x, self.y) + offset * (self.radius / length))


@dataclass(frozen=True)
class Rectangle:
    """The closed rectangle [left, right] x [bottom, top]."""

    left: float
    right: float
    bottom: float
    top: float

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """bool (n,) for points (n, 2); the edge belongs to the rectangle."""
        x, y = points[..., 0], points[..., 1]
        return (x >= self.left) & (x <= self.right) & (y >= self.bottom) & (y <= self.top)

    def nearest(self, points: Floats) -> Floats:
        """float (n, 2): the rectangle's point that is nearest to each point."""
        return np.clip(points, (self.left, self.bottom), (self.right, self.top))


@dataclass(frozen=True)
class Outside:
    """All that is not strictly inside the square |x| < half, |y| < half: an arena's wall."""

    half: float

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """bool (n,) for points (n, 2); the edge belongs to the wall."""
        return np.asarray(np.abs(points).max(axis=-1) >= self.half)

    def nearest(self, points: Floats) -> Floats:
        """float (n, 2): the wall's point that is nearest to each point inside."""
        axis = np.abs(points).argmax(axis=-1)
        rows = np.arange(len(points))
        wall = points.copy()
        wall[rows, axis] = np.where(points[rows, axis] >= 0, self.half, -self.half)
        return wall


Shape: TypeAlias = Disc | Rectangle | Outside


def inside_any(shapes: tuple[Shape, ...], points: Floats) -> NDArray[np.bool_]:
    """bool (n,): whether each point (n, 2) lies in one of the shapes."""
    hit = np.zeros(points.shape[:-1], dtype=np.bool_)
    for shape in shapes:
        hit |= shape.contains(points)
    return hit


def nearest_point(shapes: tuple[Shape, ...], points: Floats) -> Floats:
    """float (n, 2): the nearest point of any shape, for points outside all of them."""
    candidates = np.stack([shape.nearest(points) for shape in shapes])
    distance = np.linalg.norm(candidates - points, axis=-1)
    chosen = distance.argmin(axis=0)
    return np.asarray(candidates[chosen, np.arange(len(points))])
