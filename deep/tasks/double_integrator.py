"""A mass between two walls: position x, velocity v, bounded acceleration, no friction.

    v' = clip(v + A u dt, -v_max, v_max),  x' = x + (v + v') dt / 2,
    violation iff |x'| >= 1                                          (u in [-1, 1])

exact for accelerations that are constant over a step (a clipped velocity is reached by a
smaller one). For v > 0 full braking passes x + D_k(v), D_k(v) = k v dt - A (k dt)^2 / 2,
after k steps and is nowhere farther right than any other choice. With
D(v) = max_{k >= 0} D_k(v), and D(v) = 0 for v <= A dt / 2:

    dead  <=>  |x| < 1 and (x + D(v) >= 1 or -x + D(-v) >= 1),
    T = least k at which full braking reaches a wall.

A state with x + D(v) < 1 and -x + D(-v) < 1 is safe: brake fully until the velocity
changes sign (at most one step, from |v| < A dt), then stop; the other wall is far (checked
at construction: twice the greatest D plus A dt^2 is less than the gap).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Rectangle
from deep.tasks.task import Bools, Floats, Step, Task, clip_action

__all__ = ["DoubleIntegrator"]

GOAL = 0.8


@dataclass(frozen=True)
class DoubleIntegrator(Task):
    """The mass between walls at -1 and 1; states (n, 2) are position and velocity.

    Attributes:
        dt: seconds a step.
        max_speed: greatest velocity, either way.
        acceleration: greatest acceleration, either way.
    """

    dt: float = 0.2
    max_speed: float = 1.0
    acceleration: float = 1.0

    name: ClassVar[str] = "double-integrator"
    state_names: ClassVar[tuple[str, ...]] = ("position", "velocity")
    action_dim: ClassVar[int] = 1
    observation_dim: ClassVar[int] = 2
    time_limit: ClassVar[int] = 100

    def __post_init__(self) -> None:
        reach = 2 * float(self.stopping_distance(np.array(self.max_speed)))
        if reach + self.acceleration * self.dt**2 >= 2:
            raise ValueError(
                f"double integrator: at speed {self.max_speed} the mass cannot stop in half of "
                "the gap between the walls; take a smaller max_speed or a larger acceleration"
            )

    @property
    def low(self) -> Floats:
        """The left wall; full speed leftwards."""
        return np.array([-1.0, -self.max_speed])

    @property
    def high(self) -> Floats:
        """The right wall; full speed rightwards."""
        return np.array([1.0, self.max_speed])

    def reset(self, rng: np.random.Generator, n: int) -> Floats:
        """Uniform between the walls, at any velocity."""
        state = rng.uniform(self.low, self.high, size=(n, 2))
        state[:, 0] = np.clip(state[:, 0], -1 + 1e-9, 1 - 1e-9)
        return state

    def step(
        self,
        state: Floats,
        action: NDArray[np.floating],
        rng: np.random.Generator,  # noqa: ARG002  (part of the interface; no noise here)
    ) -> Step:
        """Accelerate for dt; the reward is 1 minus the distance to a goal near a wall."""
        change = self.acceleration * self.dt * clip_action(action)[:, 0]
        velocity = np.clip(state[:, 1] + change, -self.max_speed, self.max_speed)
        position = state[:, 0] + (state[:, 1] + velocity) * (self.dt / 2)
        violation = np.abs(position) >= 1
        following = np.stack([np.clip(position, -1, 1), velocity], axis=1)
        return Step(following, 1 - np.abs(position - GOAL), violation, np.zeros_like(violation))

    def stopping_distance(self, velocity: Floats) -> Floats:
        """D(v): how far full braking still moves in the direction v > 0; 0 for v <= 0."""
        covered = [self._covered(velocity, k) for k in range(self._most_steps + 1)]
        return np.asarray(np.max(covered, axis=0))

    def _covered(self, velocity: Floats, k: int) -> Floats:
        """D_k(v), where full braking is after k steps."""
        return np.asarray(k * self.dt * velocity - self.acceleration * (k * self.dt) ** 2 / 2)

    @property
    def _most_steps(self) -> int:
        """No D_k(v) is greatest at a larger k."""
        return int(np.ceil(self.max_speed / (self.acceleration * self.dt)))

    def dead(self, state: Floats) -> Bools:
        """bool (n,): the exact dead set."""
        position, velocity = state[:, 0], state[:, 1]
        right = position + self.stopping_distance(velocity) >= 1
        left = -position + self.stopping_distance(-velocity) >= 1
        return (np.abs(position) < 1) & (right | left)

    def survival_time(self, state: Floats) -> NDArray[np.int64]:
        """int (n,): T for dead states, 0 for fail states, -1 for safe ones."""
        position, velocity = state[:, 0], state[:, 1]
        inside = np.abs(position) < 1
        time = np.where(inside, -1, 0)
        for k in range(self._most_steps, 0, -1):
            right = position + self._covered(velocity, k) >= 1
            left = -position + self._covered(-velocity, k) >= 1
            time = np.where(inside & (right | left), k, time)
        return time

    def boundary_distance(self, state: Floats) -> Floats:
        """float (n,): how far the position is from its nearer boundary value."""
        position, velocity = state[:, 0], state[:, 1]
        right = np.abs(1 - position - self.stopping_distance(velocity))
        left = np.abs(1 + position - self.stopping_distance(-velocity))
        return np.minimum(right, left)

    @property
    def horizon(self) -> int:
        """H: the most steps a dead state survives, where D_k at full speed is greatest."""
        top = np.array(self.max_speed)
        covered = [float(self._covered(top, k)) for k in range(self._most_steps + 1)]
        return int(np.argmax(covered))

    def safest_action(self, state: Floats) -> Floats:
        """float (n, 1): stop, or brake fully where stopping would still touch a wall."""
        position, velocity = state[:, 0], state[:, 1]
        stop = np.clip(-velocity / (self.acceleration * self.dt), -1, 1)
        after = velocity + stop * self.acceleration * self.dt
        touches = np.abs(position + (velocity + after) * (self.dt / 2)) >= 1
        return np.where(touches, -np.sign(velocity), stop)[:, None]

    @property
    def view(self) -> tuple[float, float, float, float]:
        """Both walls."""
        return (-1.2, 1.2, -0.3, 0.3)

    @property
    def obstacles(self) -> tuple[Rectangle, ...]:
        """The two walls."""
        return (Rectangle(-2.0, -1.0, -2.0, 2.0), Rectangle(1.0, 2.0, -2.0, 2.0))

    @property
    def goals(self) -> tuple[Rectangle, ...]:
        """Where the reward is greatest."""
        return (Rectangle(GOAL - 0.02, GOAL + 0.02, -0.3, 0.3),)

    def position(self, state: Floats) -> Floats:
        """On the x axis."""
        return np.stack([state[:, 0], np.zeros(len(state))], axis=1)

    def towards_obstacle(self, state: Floats) -> Floats:
        """Full acceleration to the wall that it moves to."""
        return np.where(state[:, 1] >= 0, 1.0, -1.0)[:, None]
