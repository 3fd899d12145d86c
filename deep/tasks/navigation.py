"""Navigation 1 and 2 of Recovery RL (Thananjeyan et al., 2021): a point without momentum.

    s' = s + u + 0.05 N(0, I),   u in [-1, 1]^2,   violation iff s' lies in an obstacle,

reward -||s|| of the state before the step, success once ||s|| < 4 before the step, at
most 100 steps from (-50, 0) + N(0, I). A point that can stop has no dead-ends: the negative
control, where a critic of dead-ends should forbid nothing but the last step before an
obstacle.

What "no dead-ends" means: unbounded noise hits an obstacle sooner or later whatever the
agent does, so let the noise be cut off at ``NOISE_BOUND``, six standard deviations (a
coordinate of a step is beyond with probability 2e-9). An action is then fine iff the
square of half-width ``NOISE_BOUND`` around s + u misses every obstacle, unsafe iff an
obstacle holds all of it. From each state outside the obstacles ``safest_action`` is fine,
as no two of them face each other within 3 units: all of them are safe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Disc, Rectangle, inside_any, nearest_point
from deep.tasks.task import Bools, Floats, Step, Task, clip_action

__all__ = ["Navigation", "navigation1", "navigation2"]

CORRIDOR = (
    Rectangle(-100.0, 150.0, 5.0, 10.0),
    Rectangle(-100.0, -80.0, -10.0, 10.0),
    Rectangle(-100.0, 150.0, -10.0, -5.0),
)
BLOCK = (Rectangle(-30.0, -20.0, -7.5, 7.5),)
START = (-50.0, 0.0)
START_NOISE = 1.0
STEP_NOISE = 0.05
GOAL_RADIUS = 4.0
NOISE_BOUND = 6 * STEP_NOISE
FULL_STEP = 1.0 + 2 * NOISE_BOUND
"""Beyond this distance an obstacle cannot be hit in the next step."""


@dataclass(frozen=True)
class Navigation(Task):
    """A point that walks to the origin past rectangles; states (n, 2) are its position.

    Attributes:
        rectangles: the obstacles, edges included.
        half_width, half_height: positions are cut off there (no episode of 100 steps from
            the start passes it without a violation or a turn back).
    """

    rectangles: tuple[Rectangle, ...] = CORRIDOR
    half_width: float = 160.0
    half_height: float = 120.0

    name: ClassVar[str] = "navigation"
    state_names: ClassVar[tuple[str, ...]] = ("x", "y")
    action_dim: ClassVar[int] = 2
    observation_dim: ClassVar[int] = 2
    time_limit: ClassVar[int] = 100

    @property
    def low(self) -> Floats:
        """The lower left corner of the plane that is kept."""
        return -self.high

    @property
    def high(self) -> Floats:
        """The upper right corner."""
        return np.array([self.half_width, self.half_height])

    def reset(self, rng: np.random.Generator, n: int) -> Floats:
        """The start of the task, with unit noise; starts in an obstacle are drawn again."""
        state = START + START_NOISE * rng.standard_normal((n, 2))
        while (hit := inside_any(self.obstacles, state)).any():
            state[hit] = START + START_NOISE * rng.standard_normal((int(hit.sum()), 2))
        return state

    def step(self, state: Floats, action: NDArray[np.floating], rng: np.random.Generator) -> Step:
        """Walk; the reward is minus the distance to the origin before the step."""
        distance = np.linalg.norm(state, axis=1)
        noise = STEP_NOISE * rng.standard_normal(state.shape)
        following = np.clip(state + clip_action(action) + noise, self.low, self.high)
        violation = inside_any(self.obstacles, following)
        success = (distance < GOAL_RADIUS) & ~violation
        return Step(following, -distance, violation, success)

    @property
    def view(self) -> tuple[float, float, float, float]:
        """Start, obstacles and goal."""
        return (-90.0, 30.0, -30.0, 30.0)

    @property
    def region(self) -> tuple[Floats, Floats]:
        """Around the way from start to goal, where walks meet the obstacles."""
        return np.array([-60.0, -15.0]), np.array([10.0, 15.0])

    @property
    def obstacles(self) -> tuple[Rectangle, ...]:
        """The rectangles."""
        return self.rectangles

    @property
    def goals(self) -> tuple[Disc, ...]:
        """The disc around the origin in which an episode succeeds."""
        return (Disc(0.0, 0.0, GOAL_RADIUS),)

    def position(self, state: Floats) -> Floats:
        """The point itself."""
        return state

    def towards_obstacle(self, state: Floats) -> Floats:
        """A full step towards the nearest obstacle, by coordinate."""
        offset = nearest_point(self.obstacles, state) - state
        return np.asarray(offset / np.maximum(np.abs(offset).max(axis=1, keepdims=True), 1e-12))

    def safest_action(self, state: Floats) -> Floats:
        """A full step away from every obstacle within reach, by coordinate."""
        away = np.zeros_like(state)
        for rectangle in self.obstacles:
            offset = state - rectangle.nearest(state)
            within = np.abs(offset).max(axis=1, keepdims=True) <= FULL_STEP
            away += np.where(within, np.sign(offset), 0.0)
        return np.clip(away, -1.0, 1.0)

    def misses(self, state: Floats, action: NDArray[np.floating]) -> Bools:
        """bool (n,): whether no noise within its bound leads into an obstacle."""
        return ~self._hits(state + clip_action(action), NOISE_BOUND)

    def enters(self, state: Floats, action: NDArray[np.floating]) -> Bools:
        """bool (n,): whether all noise within its bound leads into one obstacle."""
        return self._hits(state + clip_action(action), -NOISE_BOUND)

    def _hits(self, point: Floats, margin: float) -> Bools:
        grown = tuple(
            Rectangle(r.left - margin, r.right + margin, r.bottom - margin, r.top + margin)
            for r in self.obstacles
        )
        return inside_any(grown, point)


class Navigation1(Navigation):
    """The corridor."""

    name: ClassVar[str] = "navigation1"


class Navigation2(Navigation):
    """The block in the way."""

    name: ClassVar[str] = "navigation2"


def navigation1() -> Navigation1:
    """Navigation1: a corridor of width 10 (Recovery RL: gamma_safe 0.8, epsilon 0.3)."""
    return Navigation1(CORRIDOR)


def navigation2() -> Navigation2:
    """Navigation2: a block between start and goal (Recovery RL: 0.65 and 0.2)."""
    return Navigation2(BLOCK)
