"""A Dubins car: constant speed, bounded turning rate; states (x, y, heading).

    heading' = heading + W u dt,  p' = p + dt v (cos, sin)(heading'),
    violation iff p' lies in the disc or touches the wall           (u in [-1, 1])

It cannot stop, so every state too near to an obstacle that it faces is dead. No closed
form: the dead set is bracketed on a grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Disc, Outside, Shape, inside_any, nearest_point
from deep.tasks.task import Floats, Observations, Step, Task, clip_action

__all__ = ["Dubins"]


DISC = Disc(0.0, 0.0, 0.5)


@dataclass(frozen=True)
class Dubins(Task):
    """A car that cannot stop, around a disc in a walled square.

    Attributes:
        dt: seconds a step.
        speed: the constant speed.
        turn_rate: greatest turning rate, radians a second.
        half_width: the wall is at |x| = |y| = half_width.
        disc: the obstacle.
    """

    dt: float = 0.2
    speed: float = 1.0
    turn_rate: float = 2.0
    half_width: float = 2.0
    disc: Disc = DISC

    name: ClassVar[str] = "dubins"
    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "heading (rad)")
    action_dim: ClassVar[int] = 1
    observation_dim: ClassVar[int] = 4
    time_limit: ClassVar[int] = 100

    @property
    def low(self) -> Floats:
        """A corner of the square; heading -pi."""
        return -self.high

    @property
    def high(self) -> Floats:
        """The opposite corner; heading pi."""
        return np.array([self.half_width, self.half_width, np.pi])

    def reset(self, rng: np.random.Generator, n: int) -> Floats:
        """Uniform over the free positions and all headings."""
        state = rng.uniform(self.low, self.high, size=(n, 3))
        while (hit := inside_any(self.obstacles, state[:, :2])).any():
            state[hit] = rng.uniform(self.low, self.high, size=(int(hit.sum()), 3))
        return state

    def step(
        self,
        state: Floats,
        action: NDArray[np.floating],
        rng: np.random.Generator,  # noqa: ARG002  (part of the interface; no noise here)
    ) -> Step:
        """Turn, then drive; the reward is the angle driven around the disc, in radians."""
        heading = state[:, 2] + self.turn_rate * self.dt * clip_action(action)[:, 0]
        heading = (heading + np.pi) % (2 * np.pi) - np.pi
        moved = self.dt * self.speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        position = np.clip(state[:, :2] + moved, -self.half_width, self.half_width)
        violation = inside_any(self.obstacles, position)
        before, after = state[:, :2] - self._centre, position - self._centre
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        angle = np.arctan2(cross, (before * after).sum(axis=1))
        following = np.concatenate([position, heading[:, None]], axis=1)
        return Step(following, angle, violation, np.zeros_like(violation))

    @property
    def _centre(self) -> tuple[float, float]:
        return (self.disc.x, self.disc.y)

    def observe(self, state: Floats) -> Observations:
        """float32 (n, 4): the scaled position, and cosine and sine of the heading."""
        heading = state[:, 2:]
        parts = [state[:, :2] / self.half_width, np.cos(heading), np.sin(heading)]
        return np.concatenate(parts, axis=1, dtype=np.float64).astype(np.float32)

    @property
    def view(self) -> tuple[float, float, float, float]:
        """The square."""
        edge = 1.05 * self.half_width
        return (-edge, edge, -edge, edge)

    @property
    def obstacles(self) -> tuple[Shape, ...]:
        """The disc and the wall."""
        return (self.disc, Outside(self.half_width))

    def position(self, state: Floats) -> Floats:
        """The car's own position."""
        return state[:, :2]

    def towards_obstacle(self, state: Floats) -> Floats:
        """Turn towards the nearest obstacle."""
        offset = nearest_point(self.obstacles, state[:, :2]) - state[:, :2]
        wanted = np.arctan2(offset[:, 1], offset[:, 0])
        error = (wanted - state[:, 2] + np.pi) % (2 * np.pi) - np.pi
        return np.clip(error / (self.turn_rate * self.dt), -1, 1)[:, None]
