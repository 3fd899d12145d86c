"""The Car's contacts with the ground: soft, with pyramids of friction, as MuJoCo has them.

Each contact presses along facets e of a pyramid, e = n + m t with the tangents t along the
*world's* axes and m = +-mu, and e = n. Their forces f_e >= 0 solve, with rows J_e,

    f_e = max(0, -(J_e q'' + rate J_e q' - stiffness d depth) / ((1 - d) softness / d)),

where q'' is the acceleration with all forces and d rises from 0.9 to 0.95 over the first
millimetre. Contacts that slide push the car up, so that it hops as it does there. The forces
are found by Gauss-Seidel sweeps over contacts and facets.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deep.tasks.safety_gym.car_body import (
    BACK,
    BALL_SPIN,
    FRONT,
    HEIGHT,
    HUB,
    MASS,
    PITCH,
    RADIUS,
    ROLL,
    WHEEL_SPIN,
    YAW,
    CarParameters,
)

__all__ = ["CONTACTS", "FACETS", "WORK", "solve_contacts"]

Floats = NDArray[np.float64]

SWEEPS = 4
FACETS = 5
NORMALS = 6  # the facets of turning and rolling friction are nearly normal: six of them in one
ALONG_X = (0.0, 1.0, -1.0, 0.0, 0.0)
ALONG_Y = (0.0, 0.0, 0.0, 1.0, -1.0)
WORK = 15
CONTACTS = 5
CONTACT_X = np.array([-0.155, -0.105, 0.105, 0.155, 0.0])
CONTACT_Y = np.array([FRONT, FRONT, FRONT, FRONT, -BACK])
SPIN = np.array([6, 6, 7, 7, 8])  # which velocity spins the contact along y
BALL = 4  # the contact under the ball, which spins along x too


@njit(cache=True, fastmath=True, inline="always")
def _at_contact(q: Floats, i: int) -> tuple[float, float, float]:
    """(n, x, y) of a velocity or acceleration at contact i, along the car's axes."""
    x, y = CONTACT_X[i], CONTACT_Y[i]
    normal = q[2] + y * q[3] - x * q[4]
    along = q[1] + x * q[5] + HUB * q[3] + RADIUS * q[SPIN[i]]
    across = q[0] - y * q[5] - HUB * q[4]
    across -= RADIUS * (q[9] if i == BALL else q[4])
    return normal, across, along


@njit(cache=True, fastmath=True, inline="always")
def _push(q: Floats, i: int, n: float, x: float, y: float) -> None:
    """Add the accelerations of the force (n, x, y) at contact i."""
    cx, cy = CONTACT_X[i], CONTACT_Y[i]
    q[0] += x / MASS
    q[1] += y / MASS
    q[2] += n / MASS
    q[3] += (cy * n + HUB * y) / PITCH
    q[5] += (cx * y - cy * x) / YAW
    if i == BALL:
        q[4] -= (cx * n + HUB * x) / ROLL
        q[8] += RADIUS * y / BALL_SPIN
        q[9] -= RADIUS * x / BALL_SPIN
    else:
        q[4] -= (cx * n + HEIGHT * x) / ROLL
        q[SPIN[i]] += RADIUS * y / WHEEL_SPIN


@njit(cache=True, fastmath=True, inline="always")
def _response(i: int, c: float, s: float, response: Floats) -> None:
    """J M^-1 J^T of contact i along (n, world x, world y): nn, n1, n2, 11, 12, 22."""
    x, y = CONTACT_X[i], CONTACT_Y[i]
    ball = i == BALL
    arm = HUB if ball else HEIGHT
    spin = RADIUS * RADIUS / (BALL_SPIN if ball else WHEEL_SPIN)
    xx = 1 / MASS + y * y / YAW + arm * arm / ROLL + (spin if ball else 0.0)
    yy = 1 / MASS + x * x / YAW + HUB * HUB / PITCH + spin
    xy = -x * y / YAW
    nx, ny = x * arm / ROLL, y * HUB / PITCH
    response[0] = 1 / MASS + y * y / PITCH + x * x / ROLL
    response[1] = c * nx - s * ny
    response[2] = s * nx + c * ny
    response[3] = c * c * xx - 2 * c * s * xy + s * s * yy
    response[4] = c * s * (xx - yy) + (c * c - s * s) * xy
    response[5] = s * s * xx + 2 * c * s * xy + c * c * yy


@njit(cache=True, fastmath=True, inline="always")
def _reciprocals(mu: float, work: Floats) -> None:
    """1 / (J_e M^-1 J_e^T + softness) of the five facets."""
    nn, n1, n2, soft = work[0], work[1], work[2], work[6]
    one, two = nn + mu * mu * work[3] + soft, nn + mu * mu * work[5] + soft
    work[10] = 1 / (nn + soft / NORMALS)
    work[11], work[12] = 1 / (one + 2 * mu * n1), 1 / (one - 2 * mu * n1)
    work[13], work[14] = 1 / (two + 2 * mu * n2), 1 / (two - 2 * mu * n2)


@njit(cache=True, fastmath=True, inline="always")
def _impedance(depth: float) -> float:
    """d: from 0.9 at the surface to 0.95 a millimetre below, in two parabolas."""
    x = min(depth * 1000.0, 1.0)
    return 0.9 + 0.05 * (2 * x * x if x < 0.5 else 1 - 2 * (1 - x) * (1 - x))


@njit(cache=True, fastmath=True, inline="always")
def _sweep(
    acceleration: Floats, i: int, mu: float, c: float, s: float, force: Floats, work: Floats
) -> None:
    """Renew the forces of contact i's facets one after another."""
    nn, n1, n2, a11, a12, a22 = work[0], work[1], work[2], work[3], work[4], work[5]
    n, x, y = _at_contact(acceleration, i)
    one, two = c * x - s * y + work[8], s * x + c * y + work[9]
    n += work[7]
    total, first, second = 0.0, 0.0, 0.0
    for f in range(FACETS):
        m1, m2 = mu * ALONG_X[f], mu * ALONG_Y[f]
        soft = work[6] / NORMALS if f == 0 else work[6]
        residual = n + m1 * one + m2 * two + soft * force[f]
        new = max(0.0, force[f] - residual * work[10 + f])
        change = new - force[f]
        force[f] = new
        total += change
        first += m1 * change
        second += m2 * change
        n += (nn + m1 * n1 + m2 * n2) * change
        one += (n1 + m1 * a11 + m2 * a12) * change
        two += (n2 + m1 * a12 + m2 * a22) * change
    _push(acceleration, i, total, c * first + s * second, c * second - s * first)


@njit(cache=True, fastmath=True, inline="always")
def _prepare(
    velocity: Floats, i: int, depth: float, c: float, s: float, p: CarParameters, work: Floats
) -> None:
    """What the sweeps need of contact i: response, softness, target, reciprocals."""
    _response(i, c, s, work)
    d = _impedance(depth)
    work[6] = (p.ball_softness if i == BALL else p.wheel_softness) * (1 - d) / d
    n, x, y = _at_contact(velocity, i)
    work[7] = p.rate * n - p.stiffness * d * depth
    work[8] = p.rate * (c * x - s * y)
    work[9] = p.rate * (s * x + c * y)
    _reciprocals(p.ball_friction if i == BALL else p.wheel_friction, work)


@njit(cache=True, fastmath=True)
def solve_contacts(
    acceleration: Floats, velocity: Floats, height: Floats, c: float, s: float, force: Floats,
    p: CarParameters, work: Floats,
) -> None:  # fmt: skip
    """Add the contacts' accelerations to the free ones.

    Args:
        acceleration, velocity: (10,), of the coordinates q.
        height: (3,), the centre's height above rest, pitch and roll.
        c, s: cosine and sine of the heading.
        force: (5, 5), of contacts and facets: where the sweeps start, and end.
        p: the contacts' constants.
        work: (5, 15), overwritten.
    """
    for i in range(CONTACTS):
        depth = -(height[0] + CONTACT_Y[i] * height[1] - CONTACT_X[i] * height[2])
        if depth < 0:
            force[i] = 0.0
            work[i, 6] = 0.0
            continue
        _prepare(velocity, i, depth, c, s, p, work[i])
        mu = p.ball_friction if i == BALL else p.wheel_friction
        x, y = mu * (force[i, 1] - force[i, 2]), mu * (force[i, 3] - force[i, 4])
        _push(acceleration, i, force[i].sum(), c * x + s * y, c * y - s * x)
    for _ in range(SWEEPS):
        for i in range(CONTACTS):
            if work[i, 6] > 0:
                mu = p.ball_friction if i == BALL else p.wheel_friction
                _sweep(acceleration, i, mu, c, s, force[i], work[i])
