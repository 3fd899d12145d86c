"""A Dubins car: constant speed, three steering commands; states (x, y, heading).

Lengths are in units of what the car drives in a step. The action is rounded to u in
{-1, 0, 1}; the car follows the arc that turns its heading by u delta, whose chord is
c(u) = sin(u delta / 2) / (u delta / 2), c(0) = 1:

    p' = p + c(u) (cos, sin)(heading + u delta / 2),   heading' = heading + u delta,
    violation iff p' is nearer to the pillar's centre than its radius or outside the square.

It cannot stop, so every state too near to an obstacle that it faces is dead. No closed
form: ``dead_ends.envs.dubins`` encloses the safe set of these very dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Disc, Outside, Shape, inside_any, nearest_point
from deep.tasks.task import Floats, Observations, Step, Task, clip_action

__all__ = ["Dubins"]


@dataclass(frozen=True)
class Dubins(Task):
    """A car that cannot stop, around a pillar in a walled square.

    Attributes:
        half_width: the square is |x|, |y| <= half_width.
        pillar_radius: of the disc in the middle.
        headings: cells of the heading in the enclosing grid.
        turn: delta, in such cells.
    """

    half_width: float = 4.0
    pillar_radius: float = 1.0
    headings: int = 32
    turn: int = 5

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
        """Follow the arc; the reward is the angle driven around the pillar, in radians."""
        turned = self.delta * np.rint(clip_action(action)[:, 0])
        middle = state[:, 2] + turned / 2
        chord = np.sinc(turned / (2 * np.pi))  # sin(turned / 2) / (turned / 2)
        moved = chord[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1)
        reached = state[:, :2] + moved
        outside = np.abs(reached).max(axis=1) > self.half_width
        violation = outside | (np.hypot(reached[:, 0], reached[:, 1]) < self.pillar_radius)
        position = np.clip(reached, -self.half_width, self.half_width)
        heading = (state[:, 2] + turned + np.pi) % (2 * np.pi) - np.pi
        cross = state[:, 0] * position[:, 1] - state[:, 1] * position[:, 0]
        angle = np.arctan2(cross, (state[:, :2] * position).sum(axis=1))
        following = np.concatenate([position, heading[:, None]], axis=1)
        return Step(following, angle, violation, np.zeros_like(violation))

    @property
    def delta(self) -> float:
        """The greatest turn in a step, radians."""
        return self.turn * 2 * np.pi / self.headings

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
        """The pillar and the wall."""
        return (Disc(0.0, 0.0, self.pillar_radius), Outside(self.half_width))

    def position(self, state: Floats) -> Floats:
        """The car's own position."""
        return state[:, :2]

    def towards_obstacle(self, state: Floats) -> Floats:
        """Turn towards the nearest obstacle."""
        offset = nearest_point(self.obstacles, state[:, :2]) - state[:, :2]
        wanted = np.arctan2(offset[:, 1], offset[:, 0])
        error = (wanted - state[:, 2] + np.pi) % (2 * np.pi) - np.pi
        return np.clip(error / self.delta, -1, 1)[:, None]
