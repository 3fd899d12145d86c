"""The Point robot: a ball with an arrow that slides on the plane and turns on its axis.

In the frame of its heading, with velocity (u, w), yaw rate r, centre of mass at (c, 0),
and everything divided by the mass, the accelerations (a_u, a_w, a_r) of the axis solve

    a_u             = F - b u + c r^2
          a_w + c a_r = -b w
    c a_w + k a_r = T - d r,

F = thrust * clip(action_0, -s, s) / s,   T = torque * clip(action_1 - servo * r, -s, s) / s.

The actuators saturate at s = 0.05: all but the smallest actions count by their sign only.
MuJoCo's integrator takes the damping at the end of a substep (b h and d h are added to the
diagonal), changes the velocity first and moves with the new one; so does this. Below its
saturation the yaw servo is unstable at this substep: it chatters around the rate that is
wanted, here as there.

The parameters are the published ones; a fit to rollouts of the MuJoCo robot
(``benchmarks/fit_robots.py``, docs/safety_gym.md) leaves them where they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["POINT", "POINT_STATE", "PointParameters", "advance_point", "point_sensors"]

Floats = NDArray[np.float64]

SATURATION = 0.05
SUBSTEP = 0.002
SUBSTEPS = 10
GRAVITY = 9.81
POINT_STATE = (
    "x (m)",
    "y (m)",
    "heading (rad)",
    "x velocity (m/s)",
    "y velocity (m/s)",
    "yaw rate (rad/s)",
    "forward acceleration (m/s^2)",
    "leftward acceleration (m/s^2)",
)


class PointParameters(NamedTuple):
    """Constants of the robot, divided by its mass.

    Attributes:
        thrust: greatest forward acceleration, m/s^2.
        drag: b, 1/s.
        offset: c, m.
        inertia: k, of the yaw about the axis, m^2.
        yaw_drag: d, m^2/s.
        torque: greatest yaw torque, m^2/s^2.
        servo: of the yaw rate into the servo's input, s.
    """

    thrust: float
    drag: float
    offset: float
    inertia: float
    yaw_drag: float
    torque: float
    servo: float


# A ball of radius 0.1 m and, 0.1 m ahead of its centre, a box of side 0.1 m; 1 kg / m^3.
_BALL, _BOX = 4 / 3 * np.pi * 0.1**3, 0.1**3
_MASS = _BALL + _BOX
POINT = PointParameters(
    thrust=0.3 * SATURATION / _MASS,
    drag=0.01 / _MASS,
    offset=_BOX * 0.1 / _MASS,
    inertia=(0.4 * _BALL * 0.1**2 + _BOX * (0.1**2 / 6 + 0.1**2)) / _MASS,
    yaw_drag=0.005 / _MASS,
    torque=0.3 * SATURATION / _MASS,
    servo=0.3,
)


@njit(cache=True)
def _accelerations(
    u: float, w: float, r: float, action: Floats, p: PointParameters, h: float
) -> tuple[float, float, float]:
    """(a_u, a_w, a_r) of the axis, with the damping taken ``h`` seconds later."""
    thrust = p.thrust * min(max(action[0] / SATURATION, -1.0), 1.0)
    torque = p.torque * min(max((action[1] - p.servo * r) / SATURATION, -1.0), 1.0)
    mass = 1.0 + p.drag * h
    inertia = p.inertia + p.yaw_drag * h
    forward = (thrust - p.drag * u + p.offset * r * r) / mass
    side, turn = -p.drag * w, torque - p.yaw_drag * r
    determinant = mass * inertia - p.offset * p.offset
    sideways = (inertia * side - p.offset * turn) / determinant
    yaw = (mass * turn - p.offset * side) / determinant
    return forward, sideways, yaw


@njit(cache=True)
def advance_point(state: Floats, action: Floats, p: PointParameters) -> None:
    """One control step of one robot, in place: ``state`` begins as in ``POINT_STATE``."""
    for _ in range(SUBSTEPS):
        cosine, sine = np.cos(state[2]), np.sin(state[2])
        u = cosine * state[3] + sine * state[4]
        w = cosine * state[4] - sine * state[3]
        forward, sideways, yaw = _accelerations(u, w, state[5], action, p, SUBSTEP)
        state[3] += SUBSTEP * (cosine * forward - sine * sideways)
        state[4] += SUBSTEP * (sine * forward + cosine * sideways)
        state[5] += SUBSTEP * yaw
        state[0] += SUBSTEP * state[3]
        state[1] += SUBSTEP * state[4]
        state[2] += SUBSTEP * state[5]
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    u = cosine * state[3] + sine * state[4]
    w = cosine * state[4] - sine * state[3]
    state[6], state[7], _ = _accelerations(u, w, state[5], action, p, 0.0)


@njit(cache=True)
def point_sensors(state: Floats, sensors: Floats) -> None:
    """Accelerometer, velocimeter, gyro and magnetometer, (12,), of one robot."""
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    sensors[:] = 0.0
    sensors[0], sensors[1], sensors[2] = state[6], state[7], GRAVITY
    sensors[3] = cosine * state[3] + sine * state[4]
    sensors[4] = cosine * state[4] - sine * state[3]
    sensors[8] = state[5]
    sensors[9], sensors[10] = -0.5 * sine, -0.5 * cosine


@njit(cache=True)
def advance_points(states: Floats, actions: Floats, p: PointParameters) -> None:
    """:func:`advance_point` for n robots."""
    for i in range(len(states)):
        advance_point(states[i], actions[i], p)


@njit(cache=True)
def sense_points(states: Floats, sensors: Floats) -> None:
    """:func:`point_sensors` of n robots, (n, 12)."""
    for i in range(len(states)):
        point_sensors(states[i], sensors[i])
