"""The Car robot: two driven wheels and a ball that rolls freely behind them.

A rigid body on five points of contact (two on each wheel, one under the ball), with small
pitch and roll. Axes: x to the right, y to the wheels, z up, turned by the heading; positive
actions drive towards -y. Its velocities are

    q' = (v_x, v_y, v_z, pitch rate, roll rate, yaw rate, spins of the wheels,
          spin of the ball about x, about y),

all absolute, so that the mass matrix M is diagonal. A substep of h seconds:

    M a = gravity + motors - D q' + contacts (``car_contacts``),    (M + h D) q'' = M a,

D being the damping of the axles, which acts on spins relative to the body; then velocities,
then positions with the new velocities, as MuJoCo's integrator does. The motors saturate at
0.02 of the action range: all but the smallest actions count by their sign only.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deep.tasks.safety_gym.car_body import (
    BALL_SPIN,
    CENTRE,
    PITCH,
    ROLL,
    WHEEL_SPIN,
    CarParameters,
)
from deep.tasks.safety_gym.car_contacts import CONTACTS, FACETS, WORK, solve_contacts

__all__ = ["CAR_STATE", "advance_car", "advance_cars", "car_sensors", "sense_cars"]

Floats = NDArray[np.float64]

CAR_STATE = (
    "x (m)",
    "y (m)",
    "heading (rad)",
    "x velocity (m/s)",
    "y velocity (m/s)",
    "yaw rate (rad/s)",
    "rightward acceleration (m/s^2)",
    "wheelward acceleration (m/s^2)",
    "upward acceleration and gravity (m/s^2)",
    "height (m)",
    "pitch (rad)",
    "roll (rad)",
    "upward velocity (m/s)",
    "pitch rate (rad/s)",
    "roll rate (rad/s)",
    "left wheel's spin (rad/s)",
    "right wheel's spin (rad/s)",
    "ball's spin about the world's x (rad/s)",
    "ball's spin about the world's y (rad/s)",
    "ball's quaternion w",
    "ball's quaternion x",
    "ball's quaternion y",
    "ball's quaternion z",
)

SATURATION = 0.02
SUBSTEP = 0.004
SUBSTEPS = 10
GRAVITY = 9.81


@njit(cache=True, fastmath=True, inline="always")
def _damp(a: Floats, p: CarParameters) -> None:
    """(M + h D)^-1 M a, where D damps the spins relative to the body."""
    wheel, ball = SUBSTEP * p.wheel_damping, SUBSTEP * p.ball_damping
    by_wheel, by_ball = 1 + wheel / WHEEL_SPIN, 1 + ball / BALL_SPIN
    back = wheel * (a[6] + a[7] - 2 * a[3]) / by_wheel + ball * (a[8] - a[3]) / by_ball
    back /= PITCH + 2 * wheel / by_wheel + ball / by_ball
    left, right = (a[6] - a[3] - back) / by_wheel, (a[7] - a[3] - back) / by_wheel
    along = (a[8] - a[3] - back) / by_ball
    across = (a[9] - a[4]) / (by_ball + ball / ROLL)
    a[3] += back
    a[4] += ball * across / ROLL
    a[6] -= wheel * left / WHEEL_SPIN
    a[7] -= wheel * right / WHEEL_SPIN
    a[8] -= ball * along / BALL_SPIN
    a[9] -= ball * across / BALL_SPIN


@njit(cache=True, fastmath=True, inline="always")
def _free(v: Floats, left: float, right: float, p: CarParameters, a: Floats) -> None:
    """Accelerations by gravity, motors and the damping of the axles alone."""
    left -= p.wheel_damping * (v[6] - v[3])
    right -= p.wheel_damping * (v[7] - v[3])
    along, across = p.ball_damping * (v[3] - v[8]), p.ball_damping * (v[4] - v[9])
    a[:] = 0.0
    a[2] = -GRAVITY
    a[3] = -(left + right + along) / PITCH
    a[4] = -across / ROLL
    a[6], a[7] = left / WHEEL_SPIN, right / WHEEL_SPIN
    a[8], a[9] = along / BALL_SPIN, across / BALL_SPIN


@njit(cache=True, fastmath=True, inline="always")
def _turn_ball(state: Floats, x: float, y: float) -> None:
    """Turn the ball's quaternion by the spin (x, y, 0) relative to the car, for a substep."""
    w, i, j, k = state[19], state[20], state[21], state[22]
    half = SUBSTEP / 2
    w, i, j, k = (
        w - half * (x * i + y * j),
        i + half * (x * w + y * k),
        j + half * (y * w - x * k),
        k + half * (x * j - y * i),
    )
    scale = 1 / np.sqrt(w * w + i * i + j * j + k * k)
    state[19], state[20], state[21], state[22] = w * scale, i * scale, j * scale, k * scale


@njit(cache=True, fastmath=True, inline="always")
def _velocities(state: Floats, c: float, s: float, v: Floats) -> None:
    """q' of a state: of the centre of mass, along the car's axes, spins absolute."""
    v[0] = c * state[3] + s * state[4] - CENTRE * state[5]
    v[1] = c * state[4] - s * state[3]
    v[2], v[3], v[4], v[5] = state[12], state[13], state[14], state[5]
    v[6], v[7] = state[15] + v[3], state[16] + v[3]
    v[8], v[9] = c * state[17] + s * state[18], c * state[18] - s * state[17]


@njit(cache=True, fastmath=True, inline="always")
def _move(state: Floats, c: float, s: float, v: Floats) -> None:
    """Enter q' into the state, and move with it for a substep."""
    across = v[0] + CENTRE * v[5]
    state[3], state[4], state[5] = c * across - s * v[1], s * across + c * v[1], v[5]
    state[12], state[13], state[14] = v[2], v[3], v[4]
    state[15], state[16] = v[6] - v[3], v[7] - v[3]
    state[17], state[18] = c * v[8] - s * v[9], s * v[8] + c * v[9]
    _turn_ball(state, v[8] - v[3], v[9] - v[4])
    for position in range(3):
        state[position] += SUBSTEP * state[3 + position]
        state[9 + position] += SUBSTEP * state[12 + position]


@njit(cache=True, fastmath=True)
def advance_car(state: Floats, action: Floats, p: CarParameters) -> None:
    """One control step of one robot, in place: ``state`` begins as in ``CAR_STATE``."""
    left = min(max(action[0], -SATURATION), SATURATION)
    right = min(max(action[1], -SATURATION), SATURATION)
    a, v = np.zeros(10), np.zeros(10)
    force, work = np.zeros((CONTACTS, FACETS)), np.zeros((CONTACTS, WORK))
    for _ in range(SUBSTEPS):
        c, s = np.cos(state[2]), np.sin(state[2])
        _velocities(state, c, s, v)
        _free(v, left, right, p, a)
        solve_contacts(a, v, state[9:12], c, s, force, p, work)
        _damp(a, p)
        v += SUBSTEP * a
        _move(state, c, s, v)
    state[6], state[7] = a[0] + CENTRE * a[5], a[1]
    state[8] = a[2] + GRAVITY - CENTRE * a[3]


@njit(cache=True)
def car_sensors(state: Floats, sensors: Floats) -> None:
    """Accelerometer, velocimeter, gyro, magnetometer, the ball's spin and matrix, (24,)."""
    c, s = np.cos(state[2]), np.sin(state[2])
    sensors[0], sensors[1], sensors[2] = state[6], state[7], state[8]
    sensors[3] = c * state[3] + s * state[4]
    sensors[4] = c * state[4] - s * state[3]
    sensors[5] = state[12] - CENTRE * state[13]
    sensors[6], sensors[7], sensors[8] = state[13], state[14], state[5]
    sensors[9], sensors[10], sensors[11] = -0.5 * s, -0.5 * c, 0.0
    w, i, j, k = state[19], state[20], state[21], state[22]
    matrix = sensors[15:24]
    matrix[0], matrix[1], matrix[2] = (
        1 - 2 * (j * j + k * k),
        2 * (i * j - w * k),
        2 * (i * k + w * j),
    )
    matrix[3], matrix[4], matrix[5] = (
        2 * (i * j + w * k),
        1 - 2 * (i * i + k * k),
        2 * (j * k - w * i),
    )
    matrix[6], matrix[7], matrix[8] = (
        2 * (i * k - w * j),
        2 * (j * k + w * i),
        1 - 2 * (i * i + j * j),
    )
    x = c * state[17] + s * state[18] - state[13]
    y = c * state[18] - s * state[17] - state[14]
    for column in range(3):
        sensors[12 + column] = matrix[column] * x + matrix[3 + column] * y


@njit(cache=True)
def advance_cars(states: Floats, actions: Floats, p: CarParameters) -> None:
    """:func:`advance_car` for n robots."""
    for i in range(len(states)):
        advance_car(states[i], actions[i], p)


@njit(cache=True)
def sense_cars(states: Floats, sensors: Floats) -> None:
    """:func:`car_sensors` of n robots, (n, 24)."""
    for i in range(len(states)):
        car_sensors(states[i], sensors[i])
