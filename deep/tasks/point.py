"""A point with momentum among discs, in a walled square: states (x, y, vx, vy).

    v' = clip(v + A u dt, -v_max, v_max) by coordinate,  p' = p + (v + v') dt / 2,
    violation iff p' lies in a disc or touches the wall       (u in [-1, 1]^2)

Four dimensions, no closed form: ``dead_ends.envs.point`` encloses the safe set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Disc, Outside, Shape, inside_any, nearest_point
from deep.tasks.task import Floats, Step, Task, clip_action

__all__ = ["PointAmongDiscs"]

DISCS = (Disc(0.0, 0.0, 0.35), Disc(-0.75, 0.7, 0.25), Disc(0.7, -0.75, 0.25))


@dataclass(frozen=True)
class PointAmongDiscs(Task):
    """A point mass that must not touch three discs or the wall of its square.

    Attributes:
        dt: seconds a step.
        max_speed: greatest velocity by coordinate.
        acceleration: greatest acceleration by coordinate.
        half_width: the wall is at |x| = |y| = half_width.
        discs: the obstacles.
        goal: where the reward leads: progress towards it.
    """

    dt: float = 0.2
    max_speed: float = 1.0
    acceleration: float = 1.0
    half_width: float = 1.5
    discs: tuple[Disc, ...] = DISCS
    goal: tuple[float, float] = (1.1, 1.1)

    name: ClassVar[str] = "point"
    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "x velocity", "y velocity")
    action_dim: ClassVar[int] = 2
    observation_dim: ClassVar[int] = 4
    time_limit: ClassVar[int] = 100

    @property
    def low(self) -> Floats:
        """A corner of the square, at full speed."""
        return -self.high

    @property
    def high(self) -> Floats:
        """The opposite corner."""
        return np.array([self.half_width, self.half_width, self.max_speed, self.max_speed])

    def reset(self, rng: np.random.Generator, n: int) -> Floats:
        """Uniform over the free positions and all velocities."""
        state = rng.uniform(self.low, self.high, size=(n, 4))
        while (hit := inside_any(self.obstacles, state[:, :2])).any():
            state[hit] = rng.uniform(self.low, self.high, size=(int(hit.sum()), 4))
        return state

    def step(
        self,
        state: Floats,
        action: NDArray[np.floating],
        rng: np.random.Generator,  # noqa: ARG002  (part of the interface; no noise here)
    ) -> Step:
        """Accelerate for dt; the reward is the progress towards the goal."""
        change = self.acceleration * self.dt * clip_action(action)
        velocity = np.clip(state[:, 2:] + change, -self.max_speed, self.max_speed)
        position = state[:, :2] + (state[:, 2:] + velocity) * (self.dt / 2)
        position = np.clip(position, -self.half_width, self.half_width)
        violation = inside_any(self.obstacles, position)
        before = np.linalg.norm(state[:, :2] - self.goal, axis=1)
        progress = before - np.linalg.norm(position - self.goal, axis=1)
        following = np.concatenate([position, velocity], axis=1)
        return Step(following, progress, violation, np.zeros_like(violation))

    @property
    def view(self) -> tuple[float, float, float, float]:
        """The square."""
        edge = 1.05 * self.half_width
        return (-edge, edge, -edge, edge)

    @property
    def drawn_state(self) -> Floats:
        """Fast to the right: at rest nothing is dead."""
        return np.array([0.0, 0.0, 0.9 * self.max_speed, 0.0])

    @property
    def obstacles(self) -> tuple[Shape, ...]:
        """The discs and the wall."""
        return (*self.discs, Outside(self.half_width))

    @property
    def goals(self) -> tuple[Disc, ...]:
        """A mark at the goal."""
        return (Disc(*self.goal, 0.1),)

    def position(self, state: Floats) -> Floats:
        """The point's own position."""
        return state[:, :2]

    def towards_obstacle(self, state: Floats) -> Floats:
        """Full acceleration towards the nearest obstacle, by coordinate."""
        offset = nearest_point(self.obstacles, state[:, :2]) - state[:, :2]
        return np.asarray(offset / np.maximum(np.abs(offset).max(axis=1, keepdims=True), 1e-12))
