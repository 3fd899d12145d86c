"""Enclosing the fixed point of a monotone operator: guess, verify, iterate.

Let F be monotone on an interval of vectors, with exactly one fixed point x* there. Then

    l <= F(l)  implies  l <= x*,       u >= F(u)  implies  x* <= u,

and applying F to a bound gives a bound that is at least as good. Every F that is used here
comes with two versions, rounded downward and upward, so that the implications hold for the
bounds that the computer holds, and for each operator whose numbers round to those given.

1. Value iteration from a lower and an upper bound (sound by itself; slow near gamma = 1).
2. Policy iteration with floating-point linear solves guesses x*; its errors do not matter.
3. For a vector d > 0 the fixed points of F - d and F + d, guessed in the same way, pass the
   test above if d exceeds the rounding errors. These are measured at the guess of x*; d is
   twice the error of each component, and, if that fails, twice the greatest error.
4. More value iteration from these bounds, until they are as close as wanted.

The idea of verifying guesses is that of optimistic value iteration (Hartmanns and Kaminski,
CAV 2020).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dead_ends.values.fixed_point.linear import LinearSolver
from dead_ends.values.fixed_point.rounding import TINY, Csr, Float
from dead_ends.values.precision import UndecidedError

__all__ = ["Enclosure", "MonotoneOperator", "check_width", "enclose"]

WARM_UP = 20
SHIFTED_ITERATIONS = 8
SWEEPS = 10
WORTHWHILE = 100
"""So many times the sweeps that were made may be advised; what takes longer is no advice."""
USEFUL = 0.01
"""The greatest tolerance that is advised: wider bounds tell hardly anything."""
EPSILON = 2.0**-52

Solve = Callable[[Csr, Float, Float], Float | None]
"""(M, c, start) -> an approximate solution of x = M x + c."""


class MonotoneOperator(Protocol):
    """F, a vector (n,) to a vector (n,), monotone, and piecewise linear."""

    def value(self, x: Float) -> Float:
        """F(x), to nearest."""

    def lower(self, x: Float) -> Float:
        """At most F(x), for every operator that rounds to this one."""

    def upper(self, x: Float) -> Float:
        """At least F(x), for every operator that rounds to this one."""

    def linear(self, x: Float) -> tuple[Csr, Float]:
        """(M, c) with F(x) = M x + c: the choices that F makes at x."""


@dataclass(frozen=True, eq=False)
class Enclosure:
    """lower <= x* <= upper, an estimate between them, and the sweeps that were made.

    Attributes:
        lower, estimate, upper: (n,).
        iterations: the sweeps that were made.
        rounding: by how much one sweep widens the bounds by rounding; 0 if they are close enough.
    """

    lower: Float
    estimate: Float
    upper: Float
    iterations: int
    rounding: float


def enclose(
    operator: MonotoneOperator,
    lower: Float,
    upper: Float,
    tolerance: float,
    max_iterations: int,
) -> Enclosure:
    """Bounds of the fixed point, improved until they are within ``tolerance``.

    Args:
        operator: F, with one fixed point between ``lower`` and ``upper``.
        lower, upper: bounds to start from; ``upper`` may be infinite.
        tolerance: the width that is wanted (relative where the value is above 1).
        max_iterations: sweeps of value iteration, at most.

    Returns:
        The best bounds found; the caller decides what it means that they are too wide.
    """
    if len(lower) == 0:
        return Enclosure(lower, lower, upper, 0, 0.0)
    warm_up = min(WARM_UP, max_iterations)
    for _ in range(warm_up):
        lower, upper = _sweep(operator, lower, upper)
    guess = _guess(operator, lower)
    if guess is not None:
        guess = np.clip(guess, lower, upper)
        low, high = _verified(operator, guess)
        upper = np.minimum(upper, high)
        lower = np.minimum(np.maximum(lower, low), upper)
    iterations = warm_up
    while iterations < max_iterations and _widths(lower, upper).max() > tolerance:
        next_lower, next_upper = _sweep(operator, lower, upper)
        iterations += 1
        if (next_lower == lower).all() and (next_upper == upper).all():
            break
        lower, upper = next_lower, next_upper
    middle = lower + (upper - lower) / 2 if guess is None else np.clip(guess, lower, upper)
    wide = _widths(lower, upper).max() > tolerance and np.isfinite(middle).all()
    rounding = np.max(operator.upper(middle) - operator.lower(middle)) if wide else 0.0
    return Enclosure(lower, middle, upper, iterations, float(rounding))


def _sweep(operator: MonotoneOperator, lower: Float, upper: Float) -> tuple[Float, Float]:
    """One sweep of value iteration from below and from above.

    The lower bound stays under the upper one also where rows sum to slightly more than 1.
    """
    upper = np.minimum(upper, operator.upper(upper))
    return np.minimum(np.maximum(lower, operator.lower(lower)), upper), upper


def check_width(
    bounds: Enclosure, tolerance: float, name: Callable[[int], str], gamma: float | None = None
) -> None:
    """The bounds are within the tolerance.

    Args:
        bounds: what was found.
        tolerance: what was wanted.
        name: what the unknowns are called.
        gamma: the discount; None if the equations have none.

    Raises:
        UndecidedError: with ``name`` of the place where they are farthest apart, and what helps.
            More iterations are advised where it is certain that they do.
    """
    width = _widths(bounds.lower, bounds.upper)
    if len(width) and not width.max() <= tolerance:
        worst = int(width.argmax())
        helps = {"exact": "use exact=True"}
        if gamma == 1:
            helps["gamma_safe"] = "a gamma_safe below 1"
        enough = _enough_sweeps(bounds, float(width[worst]), tolerance, gamma)
        if enough is not None:
            helps["max_iterations"] = f"raise max_iterations to {enough}"
        if width[worst] < USEFUL:
            helps["tolerance"] = f"accept tolerance={1.05 * width[worst]:.2g}"
        raise UndecidedError(
            f"after {bounds.iterations} sweeps the value of {name(worst)} is only known to lie in "
            f"[{bounds.lower[worst]:.9g}, {bounds.upper[worst]:.9g}]",
            helps,
        )


def _enough_sweeps(
    bounds: Enclosure, width: float, tolerance: float, gamma: float | None
) -> int | None:
    """A number of sweeps that surely reaches the tolerance; None if none is known, or too many.

    A sweep multiplies the greatest width by gamma at most, and adds its rounding. Without a
    discount there is no such rate: the bounds may shrink for a while and then hardly at all.
    """
    if gamma is None or gamma == 1 or bounds.rounding / (1 - gamma) > tolerance / 2:
        return None
    more = math.ceil(math.log(tolerance / 2 / width) / math.log(gamma))
    enough = bounds.iterations + more
    return enough if enough <= WORTHWHILE * bounds.iterations else None


def _widths(lower: Float, upper: Float) -> Float:
    """upper - lower, relative where the value is above 1."""
    return np.asarray((upper - lower) / np.maximum(lower, 1.0))


def _guess(operator: MonotoneOperator, x: Float) -> Float | None:
    """The fixed point, first quickly, then with small relative errors where that is possible."""
    solver = LinearSolver(operator.linear(x)[0])
    rough = _policy_iteration(operator, solver.quickly, x, 60, np.max)
    if rough is None:
        return None
    careful = _policy_iteration(operator, solver.carefully, rough, 12, np.abs)
    return rough if careful is None else careful


def _policy_iteration(
    operator: MonotoneOperator,
    solve: Solve,
    x: Float,
    rounds: int,
    scale: Callable[[Float], Float],
) -> Float | None:
    """The fixed point by policy iteration, from x; None if a linear solve fails.

    Between two solves some sweeps of value iteration carry improvements further. It ends when
    the values, in units of ``scale``, change by rounding errors only.
    """
    previous = np.inf
    for _ in range(rounds):
        matrix, constant = operator.linear(x)
        solved = solve(matrix, constant, x)
        if solved is None:
            return None
        change = np.max(np.abs(solved - x) / np.maximum(scale(solved), TINY))
        x = solved
        if change <= 1e-14 or (change <= 1e-10 and change > previous / 2):
            break
        previous = change
        for _ in range(SWEEPS):
            x = operator.value(x)
    return x


def _verified(operator: MonotoneOperator, x: Float) -> tuple[Float, Float]:
    """Bounds near the guess x that pass the test; 0 and infinity where none is found."""
    lower, upper = np.zeros_like(x), np.full_like(x, np.inf)
    error = np.maximum(operator.upper(x) - x, x - operator.lower(x))
    margin = 2.0 * error + EPSILON * x
    for shift in (margin, np.full_like(x, margin.max())):
        low = _shifted(operator, x, -shift, lambda l: l <= operator.lower(l))
        high = _shifted(operator, x, shift, lambda u: u >= operator.upper(u))
        lower = lower if low is None else np.maximum(lower, low)
        upper = upper if high is None else np.minimum(upper, high)
        if low is not None and high is not None:
            break
    return lower, upper


def _shifted(
    operator: MonotoneOperator,
    x: Float,
    shift: Float,
    holds: Callable[[Float], NDArray[np.bool_]],
) -> Float | None:
    """The fixed point of F + shift (or a multiple of it), if it passes the test."""
    matrix, _ = operator.linear(x)
    solver = LinearSolver(matrix)
    for factor in (1.0, 8.0, 64.0):
        candidate = x
        for _ in range(SHIFTED_ITERATIONS):
            matrix, constant = operator.linear(candidate)
            solved = solver.carefully(matrix, constant + factor * shift, candidate)
            if solved is None:
                return None
            candidate = np.maximum(solved, 0.0)
            if holds(candidate).all():
                return candidate
    return None
