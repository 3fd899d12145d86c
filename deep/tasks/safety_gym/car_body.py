"""The Car's masses and lengths, and the constants of its contacts that are fitted.

Masses and lengths are those published with the robot. Its contacts' constants begin at
MuJoCo's defaults, ``CAR_PUBLISHED``; ``CAR`` is the fit of ``benchmarks/fit_robots.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["CAR", "CAR_PUBLISHED", "CarParameters"]


class CarParameters(NamedTuple):
    """What is fitted.

    Attributes:
        wheel_friction, ball_friction: mu.
        rate: how fast the velocity of a contact is removed, 1/s.
        stiffness: of a contact, 1/s^2.
        wheel_softness, ball_softness: 1/kg, of a contact at d = 1/2.
        wheel_damping, ball_damping: of the axles, N m s.
    """

    wheel_friction: float
    ball_friction: float
    rate: float
    stiffness: float
    wheel_softness: float
    ball_softness: float
    wheel_damping: float
    ball_damping: float


CAR_PUBLISHED = CarParameters(1.0, 1.0, 105.263, 2770.08, 416.9, 256.9, 0.001, 0.001)
CAR = CarParameters(1.03167, 1.00691, 109.318, 2814.31, 412.631, 258.669, 0.00101674, 0.00102739)


# Masses (kg) of the body, a wheel, the ball; the body's centre and moments of inertia.
_BODY, _CENTRE_Y, _CENTRE_Z = 0.0239, 0.00395397, 0.10100418
_BODY_X, _BODY_Y, _BODY_Z = 1.73900582e-4, 9.48118437e-5, 2.28442072e-4
RADIUS = 0.05
_WHEEL = 5 * np.pi * RADIUS**2 * 0.05
_BALL = 5 * 4 / 3 * np.pi * RADIUS**3
MASS = _BODY + 2 * _WHEEL + _BALL
CENTRE = (_BODY * _CENTRE_Y + 0.1 * (2 * _WHEEL - _BALL)) / MASS
HEIGHT = (_BODY * _CENTRE_Z + RADIUS * (2 * _WHEEL + _BALL)) / MASS
_WHEEL_ACROSS = _WHEEL * (3 * RADIUS**2 + 0.05**2) / 12
FRONT, BACK, HUB = 0.1 - CENTRE, 0.1 + CENTRE, HEIGHT - RADIUS
WHEEL_SPIN, BALL_SPIN = _WHEEL * RADIUS**2 / 2, 0.4 * _BALL * RADIUS**2
PITCH = (
    _BODY_X
    + _BODY * ((_CENTRE_Y - CENTRE) ** 2 + (_CENTRE_Z - HEIGHT) ** 2)
    + 2 * _WHEEL * (FRONT**2 + HUB**2)
    + _BALL * (BACK**2 + HUB**2)
)
ROLL = (
    _BODY_Y
    + _BODY * (_CENTRE_Z - HEIGHT) ** 2
    + 2 * (_WHEEL * (0.13**2 + HUB**2) + _WHEEL_ACROSS)
    + _BALL * HUB**2
)
YAW = (
    _BODY_Z
    + _BODY * (_CENTRE_Y - CENTRE) ** 2
    + 2 * (_WHEEL * (0.13**2 + FRONT**2) + _WHEEL_ACROSS)
    + _BALL * BACK**2
)
