"""What a task knows about its robot: the size of its state, its dynamics, its sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deep.tasks.safety_gym.car_body import CAR
from deep.tasks.safety_gym.car_robot import CAR_STATE, advance_cars, sense_cars
from deep.tasks.safety_gym.point_robot import POINT, POINT_STATE, advance_points, sense_points

__all__ = ["CAR_ROBOT", "POINT_ROBOT", "Robot"]

Floats = NDArray[np.float64]
IDENTITY = 19  # where the unit quaternion of the car's ball has its 1


@dataclass(frozen=True)
class Robot:
    """A robot; its state begins with x, y, heading, x and y velocity and yaw rate.

    Attributes:
        state_names: one a coordinate, with units.
        sensors: how many numbers it senses.
        radius: within which it pushes vases, m.
        top_speed: about as fast as it drives, m/s.
        advance: one control step of n robots, (states, actions), in place.
        sense: (states, sensors (n, sensors)), in place.
        steer: actions that drive straight on and turn left, for a wish in [-1, 1].
        drives_towards: the angle from its x axis to where positive actions drive.
    """

    state_names: tuple[str, ...]
    sensors: int
    radius: float
    top_speed: float
    advance: Callable[[Floats, Floats], None]
    sense: Callable[[Floats, Floats], None]
    steer: Callable[[Floats], Floats]
    drives_towards: float

    def at_rest(self, n: int) -> Floats:
        """float64 (n, state): at the origin."""
        state = np.zeros((n, len(self.state_names)))
        if len(self.state_names) > IDENTITY:
            state[:, IDENTITY] = 1.0
        return state


def _advance_points(states: Floats, actions: Floats) -> None:
    advance_points(states, actions, POINT)


def _advance_cars(states: Floats, actions: Floats) -> None:
    advance_cars(states, actions, CAR)


def _steer_point(turn: Floats) -> Floats:
    return np.stack([1 - np.abs(turn), turn], axis=1)


def _steer_car(turn: Floats) -> Floats:
    ahead = 1 - np.abs(turn)
    return np.clip(np.stack([ahead + turn, ahead - turn], axis=1), -1, 1)


POINT_ROBOT = Robot(POINT_STATE, 12, 0.1, 1.5, _advance_points, sense_points, _steer_point, 0.0)
CAR_ROBOT = Robot(CAR_STATE, 24, 0.15, 0.8, _advance_cars, sense_cars, _steer_car, -np.pi / 2)
