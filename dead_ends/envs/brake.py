"""The braking car: a car drives towards an obstacle on an integer lattice.

A state is (d, v): the distance to the obstacle and the speed, both integers. An action u,
-b <= u <= a, changes the speed. Two forms of the dynamics, both exact on the lattice:

    semi-implicit:  v' = clip(v + u, 0, v_max),   d' = d - v'
    explicit:       v' = clip(v + u, 0, v_max),   d' = d - v

The car has collided when d < 0; standing at the obstacle, d = 0, is no collision. Since the
car never drives backwards and braking hardest is best, what is dead has a closed form:

    dead  <=>  0 <= d < stopping distance(v),

which is n v - b n (n + 1) / 2 with n = floor(v / b) in the semi-implicit form, and v more in
the explicit one.

The paper's first figure shows the three subsets of this task over distance and speed. In
metres and seconds a lattice unit of distance is ``distance_step``, of speed
``distance_step / time_step``, of acceleration ``distance_step / time_step**2``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = [
    "BrakeLattice",
    "brake",
    "explicit",
    "late_braker",
    "semi_implicit",
    "stopping_distance",
    "uniform_driver",
    "weak_braker",
]

Integers = NDArray[np.int64]
Dynamics = Callable[[Integers, Integers, Integers, int], tuple[Integers, Integers]]


def semi_implicit(
    distance: Integers, speed: Integers, change: Integers, max_speed: int
) -> tuple[Integers, Integers]:
    """(d', v') when the car moves with the speed that it has after the change."""
    new_speed = np.clip(speed + change, 0, max_speed)
    return distance - new_speed, new_speed


def explicit(
    distance: Integers, speed: Integers, change: Integers, max_speed: int
) -> tuple[Integers, Integers]:
    """(d', v') when the car moves with the speed that it had before the change."""
    return distance - speed, np.clip(speed + change, 0, max_speed)


@dataclass(frozen=True)
class BrakeLattice:
    """The size of the lattice, the car's abilities and the units.

    Attributes:
        max_distance, max_speed: the greatest distance and speed, in lattice units.
        max_braking, max_acceleration: b and a, in lattice units; there are b + a + 1
            actions, action i changes the speed by i - b.
        obstacle_depth: how deep a collided car may end in the obstacle: the fail states
            have distances -obstacle_depth to -1.
        dynamics: :func:`semi_implicit` or :func:`explicit`.
        distance_step: metres in a lattice unit of distance.
        time_step: seconds in a step.
    """

    max_distance: int = 480
    max_speed: int = 40
    max_braking: int = 3
    max_acceleration: int = 2
    obstacle_depth: int = 24
    dynamics: Dynamics = semi_implicit
    distance_step: float = 0.125
    time_step: float = 0.25

    def __post_init__(self) -> None:
        for name, least in (
            ("max_distance", 1),
            ("max_speed", 1),
            ("max_braking", 1),
            ("max_acceleration", 0),
            ("obstacle_depth", 1),
        ):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, not {getattr(self, name)}")
        for name in ("distance_step", "time_step"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.dynamics not in (semi_implicit, explicit):
            raise ValueError("dynamics must be semi_implicit or explicit")

    @property
    def shape(self) -> tuple[int, int]:
        """The number of distances (negative ones too) and of speeds."""
        return self.obstacle_depth + self.max_distance + 1, self.max_speed + 1

    @property
    def num_states(self) -> int:
        """The number of cells."""
        return self.shape[0] * self.shape[1]

    @property
    def speed_step(self) -> float:
        """Metres a second in a lattice unit of speed."""
        return self.distance_step / self.time_step

    @property
    def changes(self) -> Integers:
        """(A,), the change of speed of each action, in lattice units."""
        return np.arange(-self.max_braking, self.max_acceleration + 1)

    def coordinates(self) -> tuple[Integers, Integers]:
        """Distance and speed of each state, (S,) each, in lattice units."""
        distance, speed = np.indices(self.shape).reshape(2, -1)
        return distance - self.obstacle_depth, speed

    def state(self, distance: int, speed: int) -> int:
        """The number of the state (distance, speed).

        Raises:
            ValueError: if it lies outside the lattice.
        """
        row = distance + self.obstacle_depth
        if not (0 <= row < self.shape[0] and 0 <= speed < self.shape[1]):
            raise ValueError(f"distance {distance}, speed {speed} lies outside the lattice")
        return row * self.shape[1] + speed


DEFAULT_LATTICE = BrakeLattice()


def brake(lattice: BrakeLattice = DEFAULT_LATTICE) -> SafeMDP:
    """The braking car as a deterministic safe MDP.

    Rewards are the metres driven, at most up to the obstacle. The first state is drawn
    uniformly from those at the greatest distance that can still stop.
    """
    distance, speed = lattice.coordinates()
    new_distance, new_speed = lattice.dynamics(
        distance[:, None], speed[:, None], lattice.changes, lattice.max_speed
    )
    row = np.maximum(new_distance, -lattice.obstacle_depth) + lattice.obstacle_depth
    fail = distance < 0
    driven = np.where(fail[:, None], 0, distance[:, None] - np.maximum(new_distance, 0))
    can_stop = distance >= stopping_distance(lattice, speed)
    next_state = (row * lattice.shape[1] + new_speed).astype(np.int32)
    return SafeMDP.deterministic(
        next_state,
        fail,
        rewards=np.broadcast_to(driven * lattice.distance_step, next_state.shape),
        initial=(distance == lattice.max_distance) & can_stop,
        state_names=_state_names(lattice),
        action_names=[
            f"{change * lattice.speed_step / lattice.time_step:+g} m/s²"
            for change in lattice.changes
        ],
        geometry=_geometry(lattice),
    )


def stopping_distance(lattice: BrakeLattice, speed: Integers) -> Integers:
    """How far the car drives until it stands, braking hardest, by speed; lattice units."""
    braking = lattice.max_braking
    steps = speed // braking
    distance = steps * speed - braking * steps * (steps + 1) // 2
    return distance + speed if lattice.dynamics is explicit else distance


def late_braker(lattice: BrakeLattice, braking_distance: int) -> NDArray[np.int64]:
    """Task policy (S,): full throttle, and full braking once within ``braking_distance``."""
    distance, _ = lattice.coordinates()
    return np.where(distance <= braking_distance, 0, len(lattice.changes) - 1)


def weak_braker(lattice: BrakeLattice, braking: int) -> NDArray[np.int64]:
    """Task policy (S,): always brakes, but only by ``braking`` of its ``max_braking``.

    Raises:
        ValueError: if the car cannot brake so.
    """
    if not 0 <= braking <= lattice.max_braking:
        raise ValueError(f"braking must lie in 0 to {lattice.max_braking}, not {braking}")
    return np.full(lattice.num_states, lattice.max_braking - braking)


def uniform_driver(lattice: BrakeLattice) -> NDArray[np.float64]:
    """Task policy (S, A): each action with the same probability."""
    num_actions = len(lattice.changes)
    return np.full((lattice.num_states, num_actions), 1 / num_actions)


def _state_names(lattice: BrakeLattice) -> list[str]:
    distances = np.arange(lattice.shape[0]) - lattice.obstacle_depth
    speeds = [f"{speed * lattice.speed_step:g} m/s" for speed in range(lattice.shape[1])]
    return [f"{d * lattice.distance_step:g} m, {speed}" for d in distances for speed in speeds]


def _geometry(lattice: BrakeLattice) -> Geometry:
    return Geometry(
        cell=np.indices(lattice.shape, dtype=np.int32).reshape(2, -1).T,
        x_label="distance to the obstacle [m]",
        y_label="speed [m/s]",
        origin=(-lattice.obstacle_depth * lattice.distance_step, 0.0),
        step=(lattice.distance_step, lattice.speed_step),
    )
