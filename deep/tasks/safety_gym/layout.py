"""Where robot, goal, hazards and vases are placed, by Safety Gym's rules.

Objects are placed one after another, in this order. Each is drawn uniformly from the square
|x|, |y| <= extent - keepout, up to 100 times, until its distance to every object before it is
at least the sum of both keepouts; if that fails, all begin anew. A goal that was reached is
drawn again by the same rule, up to 10,000 times, against all other objects where they are now.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["GOAL", "GOAL_SIZE", "HAZARDS", "Layout", "place", "place_goal"]

Floats = NDArray[np.float64]

EXTENT = 1.5
GOAL_SIZE = 0.3
ROBOT_KEEPOUT = 0.4
GOAL_KEEPOUT = 0.305
VASE_KEEPOUT = 0.15
GOAL = 1  # the goal's row among the objects; the robot's is 0
HAZARDS = 2  # the first hazard's


@dataclass(frozen=True)
class Layout:
    """The objects of a task, in metres.

    Attributes:
        hazards: how many.
        hazard_size: radius in which the robot's centre is a violation.
        hazard_keepout: how far other objects stay away.
        vases: how many.
        fixed: the places of the goal and of the hazards, where they are always the same.
    """

    hazards: int
    hazard_size: float
    hazard_keepout: float
    vases: int = 0
    fixed: tuple[tuple[float, float], ...] | None = None

    @property
    def objects(self) -> int:
        """The robot, the goal, hazards and vases."""
        return 2 + self.hazards + self.vases

    @cached_property
    def keepouts(self) -> Floats:
        """float64 (objects,)."""
        hazards, vases = (self.hazard_keepout,) * self.hazards, (VASE_KEEPOUT,) * self.vases
        return np.array((ROBOT_KEEPOUT, GOAL_KEEPOUT, *hazards, *vases))

    @cached_property
    def places(self) -> Floats:
        """float64 (objects, 2): fixed places; NaN where they are drawn."""
        places = np.full((self.objects, 2), np.nan)
        if self.fixed is not None:
            places[GOAL : GOAL + len(self.fixed)] = self.fixed
        return places


@njit(cache=True)
def _draw(rng: np.random.Generator, keepout: float, fixed: Floats, out: Floats) -> None:
    for axis in range(2):
        half = EXTENT - keepout
        drawn = rng.random() * 2 * half - half
        out[axis] = drawn if np.isnan(fixed[axis]) else fixed[axis]


@njit(cache=True)
def _free(objects: Floats, keepouts: Floats, i: int, first: int, last: int) -> bool:
    """Whether object i keeps its distance to the objects first, ..., last - 1, save itself."""
    for j in range(first, last):
        distance = np.hypot(objects[i, 0] - objects[j, 0], objects[i, 1] - objects[j, 1])
        if j != i and distance < keepouts[i] + keepouts[j]:
            return False
    return True


@njit(cache=True)
def _place_once(
    rng: np.random.Generator, keepouts: Floats, places: Floats, objects: Floats
) -> bool:
    for i in range(len(keepouts)):
        for attempt in range(101):
            if attempt == 100:
                return False
            _draw(rng, keepouts[i], places[i], objects[i])
            if _free(objects, keepouts, i, 0, i):
                break
    return True


@njit(cache=True)
def place(rng: np.random.Generator, keepouts: Floats, places: Floats, objects: Floats) -> None:
    """Fill ``objects`` (n, objects, 2) with n layouts."""
    for row in range(len(objects)):
        while not _place_once(rng, keepouts, places, objects[row]):
            pass


@njit(cache=True)
def place_goal(rng: np.random.Generator, keepouts: Floats, places: Floats, objects: Floats) -> bool:
    """Draw the goal of one layout (objects, 2) again; False if there is no place for it."""
    attempts = 10_000 if np.isnan(places[GOAL, 0]) else 1
    for _ in range(attempts):
        _draw(rng, keepouts[GOAL], places[GOAL], objects[GOAL])
        if _free(objects, keepouts, GOAL, 0, len(keepouts)):
            return True
    return False
