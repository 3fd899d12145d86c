"""Enclosing the fixed point of a monotone operator: guess, verify, iterate.

Let F be monotone on an interval of vectors, with exactly one fixed point x* there. Then

    l <= F(l)  implies  l <= x*,       u >= F(u)  implies  x* <= u,

and applying F to a bound gives a bound that is at least as good. Every F that is used here
comes with two versions, rounded downward and upward, so that the implications hold for the
bounds that the computer holds, and for each operator whose numbers round to those given.

1. Value iteration from a lower and an upper bound (sound by itself; slow near gamma = 1).
2. Policy iteration with floating-point linear solves guesses x*; its errors do not matter.
3. The guess x is widened to x -+ d h, where h > 0 solves h = w + max over the nearly optimal
   choices of P h. Then F(x + d h) <= x + d h - d w + |F(x) - x|, so that a d slightly above
   the rounding errors passes the test in 1. Both w = x (relative errors) and w = 1 are tried.
4. More value iteration from these bounds, until they are as close as wanted.

The idea of verifying guesses is that of optimistic value iteration (Hartmanns and Kaminski,
CAV 2020).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from dead_ends.rounding import Csr, Float

__all__ = ["Enclosure", "MonotoneOperator", "enclose"]

DIRECT_SIZE = 2000
"""Up to so many unknowns a sparse LU always fits; beyond, fill-in is bounded."""
WARM_UP = 20
POLICY_ITERATIONS = 60


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

    def steepest(self, x: Float, h: Float) -> Csr:
        """Of the choices that are nearly as good at x, those that make M h greatest."""


@dataclass(frozen=True, eq=False)
class Enclosure:
    """lower <= x* <= upper, an estimate between them, and the sweeps that were made."""

    lower: Float
    estimate: Float
    upper: Float
    iterations: int


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
        tolerance: the width that is wanted.
        max_iterations: sweeps of value iteration, at most.

    Returns:
        The best bounds found; the caller decides what it means that they are too wide.
    """
    warm_up = min(WARM_UP, max_iterations)
    for _ in range(warm_up):
        lower = np.maximum(lower, operator.lower(lower))
        upper = np.minimum(upper, operator.upper(upper))
    guess = _guess(operator, lower)
    if guess is not None:
        guess = np.clip(guess, lower, upper)
        low, high = _verify(operator, guess)
        lower, upper = np.maximum(lower, low), np.minimum(upper, high)
    iterations = warm_up
    while iterations < max_iterations and _width(lower, upper) > tolerance:
        next_lower = np.maximum(lower, operator.lower(lower))
        next_upper = np.minimum(upper, operator.upper(upper))
        iterations += 1
        if (next_lower == lower).all() and (next_upper == upper).all():
            break
        lower, upper = next_lower, next_upper
    middle = lower + (upper - lower) / 2 if guess is None else np.clip(guess, lower, upper)
    return Enclosure(lower, middle, upper, iterations)


def _width(lower: Float, upper: Float) -> float:
    return float(np.max(upper - lower, initial=0.0))


def _guess(operator: MonotoneOperator, x: Float) -> Float | None:
    """The fixed point by policy iteration; None if the linear solves fail."""
    matrix, constant = operator.linear(x)
    for _ in range(POLICY_ITERATIONS):
        solved = _solve(matrix, constant, x)
        if solved is None:
            return None
        change = np.abs(solved - x)
        x = solved
        if (change <= 1e-15 * np.abs(x)).all():
            break
        matrix, constant = operator.linear(x)
    return x


def _verify(operator: MonotoneOperator, x: Float) -> tuple[Float, Float]:
    """Bounds x - d h and x + d h that pass the test, or 0 and infinity."""
    lower, upper = np.zeros_like(x), np.full_like(x, np.inf)
    for weights in (x, np.ones_like(x)):
        h = _spread(operator, x, weights)
        if h is None:
            continue
        widths = [2.0**exponent * h for exponent in range(-51, -19, 3)]
        low = _first((np.maximum(x - w, 0.0) for w in widths), lambda l: l <= operator.lower(l))
        high = _first((x + w for w in widths), lambda u: u >= operator.upper(u))
        if low is not None:
            lower = np.maximum(lower, low)
        if high is not None:
            upper = np.minimum(upper, high)
        if low is not None and high is not None:
            break
    return lower, upper


def _first(
    candidates: Iterator[Float], holds: Callable[[Float], NDArray[np.bool_]]
) -> Float | None:
    return next((candidate for candidate in candidates if holds(candidate).all()), None)


def _spread(operator: MonotoneOperator, x: Float, weights: Float) -> Float | None:
    """h = weights + max over the nearly optimal choices at x of M h, by policy iteration."""
    matrix, _ = operator.linear(x)
    h = _solve(matrix, weights, weights)
    for _ in range(POLICY_ITERATIONS):
        if h is None or not (h >= 0).all():
            return None
        larger = _solve(operator.steepest(x, h), weights, h)
        if larger is None or (larger <= 1.01 * h).all():
            break
        h = larger
    return h


def _solve(matrix: Csr, constant: Float, start: Float) -> Float | None:
    """x = matrix x + constant, as well as floats can; None if that fails."""
    system = sparse.csc_array(sparse.eye_array(len(constant)) - matrix)
    try:
        if len(constant) <= DIRECT_SIZE:
            x = linalg.splu(system).solve(constant)
        else:
            factors = linalg.spilu(system, drop_tol=1e-4, fill_factor=10)
            preconditioner = linalg.LinearOperator(system.shape, factors.solve)
            x, _ = linalg.bicgstab(
                system, constant, x0=start, rtol=1e-15, atol=0.0, maxiter=300, M=preconditioner
            )
    except RuntimeError:  # exactly singular
        return None
    return x if np.isfinite(x).all() else None
