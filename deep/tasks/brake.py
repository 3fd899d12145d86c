"""The braking car: a distance d to an obstacle, a speed v, and a bounded deceleration.

    v' = clip(v + A u, 0, v_max),  d' = d - v',  violation iff d' <= 0   (u in [-1, 1])

(one unit of time a step: on integer speeds and distances with u A integer these are the
dynamics of the tabular braking car). The shortest way to stop is to brake fully: it
passes d - D_k after k steps, D_k(v) = k v - A k (k + 1) / 2, as long as v > k A. So

    dead  <=>  0 < d <= D(v) = max_k D_k(v),      T = least k with D_k(v) >= d,

because full braking is, step by step, never faster than any other choice. H is the
largest k with v_max > k A. The paper's Figure 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Rectangle
from deep.tasks.task import Bools, Floats, Step, Task, clip_action

__all__ = ["Brake"]


@dataclass(frozen=True)
class Brake(Task):
    """The braking car; states (n, 2) are distance to the obstacle and speed.

    Attributes:
        max_distance: starts are uniform over distances up to this one.
        max_speed: greatest speed, distance a step.
        acceleration: greatest change of speed a step, either way.
    """

    max_distance: float = 30.0
    max_speed: float = 8.0
    acceleration: float = 2.0

    name: ClassVar[str] = "brake"
    state_names: ClassVar[tuple[str, ...]] = ("distance to the obstacle", "speed")
    action_dim: ClassVar[int] = 1
    observation_dim: ClassVar[int] = 2
    time_limit: ClassVar[int] = 100

    @property
    def low(self) -> Floats:
        """Touching the obstacle; standing."""
        return np.array([0.0, 0.0])

    @property
    def high(self) -> Floats:
        """The greatest starting distance; the greatest speed."""
        return np.array([self.max_distance, self.max_speed])

    def reset(self, rng: np.random.Generator, n: int) -> Floats:
        """Uniform over distances in (0, max_distance] and speeds."""
        unit = 1.0 - rng.random((n, 2))  # (0, 1]: a distance of 0 is a violation
        return unit * self.high

    def step(
        self,
        state: Floats,
        action: NDArray[np.floating],
        rng: np.random.Generator,  # noqa: ARG002  (part of the interface; no noise here)
    ) -> Step:
        """Change the speed, then move; the reward is the distance moved over max_speed."""
        speed = np.clip(
            state[:, 1] + self.acceleration * clip_action(action)[:, 0], 0, self.max_speed
        )
        distance = state[:, 0] - speed
        violation = distance <= 0
        following = np.stack([np.maximum(distance, 0.0), speed], axis=1)
        return Step(following, speed / self.max_speed, violation, np.zeros_like(violation))

    def stopping_distance(self, speed: Floats) -> Floats:
        """D(v): what full braking still covers; float (...)."""
        steps = np.arange(self.horizon + 1)
        covered = np.multiply.outer(speed, steps) - self.acceleration * steps * (steps + 1) / 2
        return np.asarray(covered.max(axis=-1))

    def dead(self, state: Floats) -> Bools:
        """bool (n,): the exact dead set."""
        return (state[:, 0] > 0) & (state[:, 0] <= self.stopping_distance(state[:, 1]))

    def survival_time(self, state: Floats) -> NDArray[np.int64]:
        """int (n,): T for dead states, 0 for fail states, -1 for safe ones."""
        distance, speed = state[:, 0], state[:, 1]
        time = np.where(distance > 0, -1, 0)
        for k in range(self.horizon, 0, -1):
            covered = k * speed - self.acceleration * k * (k + 1) / 2
            time = np.where((distance > 0) & (covered >= distance), k, time)
        return time

    def boundary_distance(self, state: Floats) -> Floats:
        """float (n,): how far the distance is from its boundary value D(v)."""
        return np.abs(state[:, 0] - self.stopping_distance(state[:, 1]))

    @property
    def horizon(self) -> int:
        """H: the most steps a dead state survives."""
        return max(int(np.ceil(self.max_speed / self.acceleration)) - 1, 0)

    def safest_action(self, state: Floats) -> Floats:
        """float (n, 1): full braking."""
        return np.full((len(state), 1), -1.0)

    @property
    def view(self) -> tuple[float, float, float, float]:
        """The road, from the farthest start to behind the obstacle."""
        half = self.max_distance / 8
        return (-self.max_distance, self.max_distance / 10, -half, half)

    @property
    def obstacles(self) -> tuple[Rectangle, ...]:
        """Everything from the obstacle's edge on."""
        return (Rectangle(0.0, self.max_distance, -self.max_distance, self.max_distance),)

    def position(self, state: Floats) -> Floats:
        """The car drives from the left towards 0."""
        return np.stack([-state[:, 0], np.zeros(len(state))], axis=1)

    def towards_obstacle(self, state: Floats) -> Floats:
        """Full acceleration."""
        return np.ones((len(state), 1))
