"""A point with momentum among discs in a walled square, enclosed on a lattice.

Along each axis, with velocities in units of a dt and lengths in units of a dt**2 (a: the
greatest acceleration, dt: the time step), the agent chooses the next velocity v',

    |v' - v| <= 1,   |v'| <= V,   p' = p + (v + v') / 2.

Violation, at the ends of the steps: p' in a closed disc, or not strictly inside the square.
With z = p + v / 2 the same reads

    z' = z + v',   p' = (z + z') / 2,

so velocities that are multiples of h = 1 / m move whole cells [i h, (i + 1) h) of z:

    inner   v = k h. All of cell i goes to cell i' = i + k', |k' - k| <= m. Violation if one
            p' is one.
    outer   k h <= v < (k + 1) h. Then |k' - k| <= m, and i' is i + k' or i + k' + 1, which
            the agent chooses. Violation if every p' is one.

In both, p' lies in [i + i', i + i' + 2) h / 2, and both are deterministic. A point is safe if
an action leads it to an inner state that need not fail: the run goes on along such states. It
is dead if no action may lead it to an outer state that need not fail.

The agent of the models chooses the next x velocity first, then the next y velocity: two of their
steps are one of the point, with 2 (2 m + 1) actions instead of (2 m + 1)**2.

Rounding: h is smaller (inner) or greater (outer) than 1 / m by a factor of 1e-9, and obstacles
are grown or shrunk by as much. Inner: a controller that is off by less reaches the lattice in
one step. Outer: a run that starts off its computed cell by a rounding error is the shifted run
of a point inside, whose shift over H steps is a millionth of that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numba import njit, uint32
from numpy.typing import NDArray

__all__ = ["PointBracket", "PointModel", "point_among_discs"]

MARGIN = 1e-9

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Disc: TypeAlias = tuple[float, float, float]
Box: TypeAlias = tuple[float, float, float, float]
"""Least and greatest x, least and greatest y."""


class Lattice(NamedTuple):
    """What the compiled functions know of a model.

    Attributes:
        outer: 1 if velocities are cells and the agent chooses z's cell, 0 for the inner model.
        steps: m, the most that k changes in a step.
        spacing: h.
        cells: of z along an axis, an even number; number 0 begins at -cells h / 2.
        speeds: values of k along an axis.
        slowest: the least k.
        reach: the greatest |v' - v|.
        max_speed: V.
        half_width: of the square.
        discs: float (n, 3), x, y and radius.
    """

    outer: int
    steps: int
    spacing: float
    cells: int
    speeds: int
    slowest: int
    reach: float
    max_speed: float
    half_width: float
    discs: Floats


@dataclass(frozen=True, eq=False)
class PointModel:
    """One of the two models, as ``classify_implicit`` takes them.

    States: first those between two steps of the point, ((kx, ky), (ix, iy)) with the last
    fastest; then, in the same order, those at which x's next velocity is chosen already; at
    last the violation.

    Attributes:
        successor, fail, num_states, num_actions: the model.
        lattice: its numbers, in units of a dt and a dt**2.
        units: metres a unit of length, metres per second a unit of velocity.
    """

    successor: Callable[[int, int], int]
    fail: Callable[[int], bool]
    num_states: int
    num_actions: int
    lattice: Lattice
    units: tuple[float, float]

    @property
    def between(self) -> slice:
        """The states between two steps of the point."""
        return slice(0, self.num_states // 2)

    def next_velocity(self, points: Floats, lasting: Bools) -> Floats:
        """A velocity that may be reached in one step, and from which no violation need follow.

        Args:
            points: float (n, 4), x, y, and their velocities.
            lasting: bool, which of the states :attr:`between` steps need not fail.

        Returns:
            float (n, 2), NaN where there is none: then, in the outer model, the point is
            dead. In the inner model, if there is one, the point is safe.
        """
        length, speed = self.units
        velocity = points[:, 2:] / speed
        z = points[:, :2] / length + velocity / 2
        return np.asarray(_next_velocity(z, velocity, self.lattice, lasting) * speed)


@dataclass(frozen=True, eq=False)
class PointBracket:
    """The models that enclose the safe set."""

    inner: PointModel
    outer: PointModel


def point_among_discs(
    discs: Sequence[Disc],
    half_width: float,
    max_speed: float,
    resolution: int,
    *,
    acceleration: float = 1.0,
    time_step: float = 1.0,
) -> PointBracket:
    """The models that enclose the point's safe set.

    Args:
        discs: x, y and radius of each, in m.
        half_width: the square is |x|, |y| < half_width, in m.
        max_speed: greatest velocity along each axis, in m/s.
        resolution: m, the cells in each unit of velocity and length.
        acceleration, time_step: a and dt, in m/s² and s.

    Raises:
        ValueError: for a resolution below 1 or too fine for 2**32 states, a size that is not
            positive and finite, a disc whose numbers are not finite or whose radius is negative.
    """
    if resolution < 1:
        raise ValueError(f"resolution must be at least 1, not {resolution}")
    for name, size in (
        ("half_width", half_width),
        ("max_speed", max_speed),
        ("acceleration", acceleration),
        ("time_step", time_step),
    ):
        if not 0 < size < math.inf:
            raise ValueError(f"{name} must be positive and finite, not {size}")
    for number, disc in enumerate(discs):
        if not all(map(math.isfinite, disc)) or disc[2] < 0:
            raise ValueError(
                f"disc {number}: x, y and radius must be finite, the radius not negative; "
                f"not {tuple(disc)}"
            )
    speed = acceleration * time_step
    length = speed * time_step
    scaled = np.array(discs, dtype=np.float64).reshape(-1, 3) / length

    def model(outer: int) -> PointModel:
        lattice = _lattice(outer, scaled, half_width / length, max_speed / speed, resolution)
        return _model(lattice, (length, speed))

    return PointBracket(inner=model(0), outer=model(1))


def _lattice(outer: int, discs: Floats, half_width: float, max_speed: float, m: int) -> Lattice:
    """The numbers of a model, rounded outward; lengths in units."""
    sign = 1 if outer else -1
    spacing = (1 + sign * MARGIN) / m
    reach = 1 + sign * MARGIN / 2
    fastest = max_speed * reach / spacing
    speeds = 2 * math.ceil(fastest) if outer else 2 * math.floor(fastest) + 1
    margin = MARGIN * half_width
    return Lattice(
        outer=outer,
        steps=m,
        spacing=spacing,
        # |p| < half_width means |z| < half_width + V / 2; whoever is farther out is outside.
        cells=2 * (math.ceil((half_width + max_speed / 2) / spacing) + 1),
        speeds=speeds,
        slowest=-(speeds // 2),
        reach=reach,
        max_speed=max_speed * reach,
        half_width=half_width + sign * margin,
        discs=discs - np.array([0, 0, sign * margin]),
    )


def _model(lattice: Lattice, units: tuple[float, float]) -> PointModel:
    num_states = 2 * lattice.speeds**2 * lattice.cells**2 + 1
    if num_states > 2**32:
        raise ValueError(
            f"resolution {lattice.steps} makes {num_states:,} states, more than 2**32; "
            "take a coarser one"
        )
    successor, fail = _compiled(lattice, _blocked(lattice))
    return PointModel(
        successor=successor,
        fail=fail,
        num_states=num_states,
        num_actions=(2 * lattice.steps + 1) * (1 + lattice.outer) ** 2,
        lattice=lattice,
        units=units,
    )


def _compiled(
    lattice: Lattice, blocked: Bools
) -> tuple[Callable[[int, int], int], Callable[[int], bool]]:
    """successor and fail. Constants of their own: as arguments, arrays cost five times as much."""
    cells, speeds, steps, outer = lattice.cells, lattice.speeds, lattice.steps, lattice.outer
    slowest, choices = lattice.slowest, 1 + lattice.outer
    layer = speeds**2 * cells**2

    @njit(error_model="numpy")
    def successor(state: int, action: int) -> int:
        x_chosen = state >= layer
        rest, iy = _divide(state - layer if x_chosen else state, cells)
        rest, ix = _divide(rest, cells)
        kx, ky = _divide(rest, speeds)
        if not x_chosen:
            kx = _changed(kx, action, steps, speeds, slowest)
            return -1 if kx < 0 else layer + ((kx * speeds + ky) * cells + ix) * cells + iy
        ky = _changed(ky, action // choices**2, steps, speeds, slowest)
        if ky < 0:
            return -1
        next_ix = ix + kx + slowest + (action // choices & outer)
        next_iy = iy + ky + slowest + (action & outer)
        if not (0 <= next_ix < cells and 0 <= next_iy < cells):
            return 2 * layer
        if blocked[ix + next_ix, iy + next_iy]:
            return 2 * layer
        return ((kx * speeds + ky) * cells + next_ix) * cells + next_iy

    @njit()
    def fail(state: int) -> bool:
        return state == 2 * layer

    return successor, fail


@njit(cache=True, error_model="numpy")
def _divide(number: int, by: int) -> tuple[int, int]:
    """Quotient and remainder; 32 bits divide several times as fast as 64."""
    quotient = uint32(number) // uint32(by)
    return int(quotient), int(uint32(number) - quotient * uint32(by))


@njit(cache=True)
def _changed(k: int, action: int, steps: int, speeds: int, slowest: int) -> int:
    """The next velocity's number, -1 for none; action 0 brakes (or accelerates) hardest."""
    if action > 2 * steps:
        return -1
    change = action - steps
    changed = k + change if k + slowest > 0 else k - change
    return changed if 0 <= changed < speeds else -1


@njit(cache=True)
def _violation(box: Box, lattice: Lattice) -> bool:
    """Whether every point of a box (outer), or one of them (inner), is a violation."""
    low_x, high_x, low_y, high_y = box
    if lattice.outer:
        beyond = max(low_x, -high_x, low_y, -high_y)
    else:
        beyond = max(high_x, -low_x, high_y, -low_y)
    if beyond >= lattice.half_width:
        return True
    for x, y, radius in lattice.discs:
        if lattice.outer:
            along_x, along_y = max(high_x - x, x - low_x), max(high_y - y, y - low_y)
        else:
            along_x, along_y = max(low_x - x, x - high_x, 0.0), max(low_y - y, y - high_y, 0.0)
        if radius >= 0 and along_x**2 + along_y**2 <= radius**2:
            return True
    return False


@njit(cache=True)
def _blocked(lattice: Lattice) -> Bools:
    """bool (2 cells - 1,) * 2: the violations among the boxes of p', by i + i' of x and y."""
    cells, h = lattice.cells, lattice.spacing
    blocked = np.empty((2 * cells - 1, 2 * cells - 1), dtype=np.bool_)
    for sum_x in range(2 * cells - 1):
        for sum_y in range(2 * cells - 1):
            x, y = (sum_x - cells) * h / 2, (sum_y - cells) * h / 2
            blocked[sum_x, sum_y] = _violation((x, x + h, y, y + h), lattice)
    return blocked


@njit(cache=True)
def _velocities(v: float, lattice: Lattice) -> tuple[int, int, float, float]:
    """The first and last k that v may go to, and the least and greatest velocity."""
    low = max(v - lattice.reach, -lattice.max_speed)
    high = min(v + lattice.reach, lattice.max_speed)
    first = math.floor(low / lattice.spacing) if lattice.outer else math.ceil(low / lattice.spacing)
    return first, math.floor(high / lattice.spacing), low, high


@njit(cache=True)
def _next_velocity(z: Floats, v: Floats, lattice: Lattice, lasting: Bools) -> Floats:
    """For each point the least corner of the first box of next velocities that last."""
    found = np.full(v.shape, np.nan)
    h = lattice.spacing
    width = h * lattice.outer
    for point in range(len(z)):
        x, y = z[point]
        first_x, last_x, least_x, most_x = _velocities(v[point, 0], lattice)
        first_y, last_y, least_y, most_y = _velocities(v[point, 1], lattice)
        for kx in range(first_x, last_x + 1):
            low_x, high_x = max(kx * h, least_x), min(kx * h + width, most_x)
            for ky in range(first_y, last_y + 1):
                low_y, high_y = max(ky * h, least_y), min(ky * h + width, most_y)
                passed = x + low_x / 2, x + high_x / 2, y + low_y / 2, y + high_y / 2
                reached = x + low_x, x + high_x, y + low_y, y + high_y
                if not _violation(passed, lattice) and _lasts(kx, ky, reached, lattice, lasting):
                    found[point] = low_x, low_y
                    break
            if not np.isnan(found[point, 0]):
                break
    return found


@njit(cache=True)
def _lasts(kx: int, ky: int, box: Box, lattice: Lattice, lasting: Bools) -> bool:
    """Whether a state with these velocities and with z in this box, at most h wide, lasts."""
    speeds, cells, h = lattice.speeds, lattice.cells, lattice.spacing
    kx, ky = kx - lattice.slowest, ky - lattice.slowest
    if not (0 <= kx < speeds and 0 <= ky < speeds):
        return False
    first_x, first_y = math.floor(box[0] / h), math.floor(box[2] / h)
    # A box of width h meets two cells; a third one by rounding only.
    last_x = min(math.floor(box[1] / h), first_x + 1)
    last_y = min(math.floor(box[3] / h), first_y + 1)
    for ix in range(first_x + cells // 2, last_x + cells // 2 + 1):
        for iy in range(first_y + cells // 2, last_y + cells // 2 + 1):
            inside = 0 <= ix < cells and 0 <= iy < cells
            if inside and lasting[((kx * speeds + ky) * cells + ix) * cells + iy]:
                return True
    return False
