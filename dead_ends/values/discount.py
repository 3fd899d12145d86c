"""The discount gamma_safe, its powers, and the conventions as powers of it.

With V_A the discounted cost on entering fail (V_A = gamma**(T - 1) off fail in a
deterministic model with survival time T), every convention of the paper reads

    V(s) = gamma**v V_A(s)   off fail,         Q(s, a) = sum_s' P(s' | s, a) w(s'),
    w(s') = gamma**k V_A(s') off fail,         w(fail) = gamma**j or 0,

with small integers v, k, j that :class:`Powers` names. In the base convention (loss target,
cost on entering) v = 0, k = 1, j = 0.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.labelling import INFINITE
from dead_ends.values.conventions import CriticConvention, ValueConvention

__all__ = [
    "Discount",
    "Powers",
    "compare_power",
    "power",
    "power_at_most",
    "power_table",
    "read_discount",
    "scientific",
]

Discount = float | Fraction
SMALLEST_NORMAL = sys.float_info.min
SMALLEST = math.ulp(0.0)
"""The least positive float: gamma**T is never rounded to 0, which would call it safe."""


def read_discount(gamma_safe: Discount, exact: bool | None) -> tuple[Discount, bool]:
    """The checked discount, and whether to calculate exactly.

    Args:
        gamma_safe: in (0, 1]. In an exact calculation a float is read as its shortest
            decimal.
        exact: None means exactly if ``gamma_safe`` is a Fraction.

    Raises:
        ValueError: if ``gamma_safe`` does not lie in (0, 1].
    """
    if not 0 < gamma_safe <= 1:
        raise ValueError(f"gamma_safe must lie in (0, 1], not {gamma_safe}")
    if exact is None:
        exact = isinstance(gamma_safe, Fraction)
    if not exact:
        return float(gamma_safe), False
    if isinstance(gamma_safe, Fraction):
        return gamma_safe, True
    return Fraction(repr(float(gamma_safe))), True


@dataclass(frozen=True)
class Powers:
    """The exponents v, k, j of one convention (see the module's docstring).

    Attributes:
        value: v.
        successor: k.
        fail: j; None where w(fail) = 0.
        fail_value: V(fail), 0 or 1.
    """

    value: int
    successor: int
    fail: int | None
    fail_value: int

    @classmethod
    def of(cls, value: ValueConvention, critic: CriticConvention) -> Powers:
        """The exponents of a convention."""
        v = int(value is ValueConvention.TIME)
        k = v + int(critic is not CriticConvention.NEXT_VALUE)
        fail_value = int(value is not ValueConvention.COST_FAIL_0)
        if critic is CriticConvention.LOSS_TARGET:
            return cls(v, k, 0, fail_value)
        j = int(critic is CriticConvention.DISCOUNTED_NEXT_VALUE)
        return cls(v, k, j if fail_value else None, fail_value)


def power(gamma: Discount, n: int) -> Discount:
    """gamma**n as Python calculates it, so that equal n give equal results; never 0."""
    return gamma**n if isinstance(gamma, Fraction) else max(gamma**n, SMALLEST)


def compare_power(value: Fraction, gamma: Fraction, exponent: Fraction | int) -> int:
    """The sign of value - gamma**exponent, decided exactly, however small the power is.

    By logarithms to a hundred digits; where they agree to 80, by comparing value**b with
    gamma**a for the exponent a/b.
    """
    if value <= 0:
        return -1
    exponent = Fraction(exponent)
    with _digits(100):
        left = _decimal(value).ln()
        right = _decimal(exponent) * _decimal(gamma).ln()
        if abs(left - right) > Decimal(10) ** -80 * (1 + abs(right)):
            return -1 if left < right else 1
    first, second = value**exponent.denominator, gamma**exponent.numerator
    return (first > second) - (first < second)


def power_at_most(gamma: float, n: int) -> float | None:
    """A float for the greatest threshold gamma**n; None if no positive float is as small.

    gamma**n as Python calculates it, so that it equals the values of critics. Where floats are
    subnormal, and their few digits no longer tell, the greatest one that is not above it, with
    gamma as its shortest decimal.
    """
    if gamma**n >= SMALLEST_NORMAL:
        return gamma**n
    exact = Fraction(repr(gamma))
    with _digits(30):
        nearest = float(_decimal(exact) ** n)
    candidates = (nearest, math.nextafter(nearest, 0.0))
    return next((x for x in candidates if x and compare_power(Fraction(x), exact, n) <= 0), None)


def scientific(number: Discount, exponent: int = 1, digits: int = 6) -> str:
    """number**exponent with a few digits, also where that is far too small for a float."""
    exact = Fraction(repr(number)) if isinstance(number, float) else number
    with _digits(30):
        return f"{_decimal(exact) ** exponent:.{digits}g}"


@contextmanager
def _digits(precision: int) -> Iterator[None]:
    """Decimals with so many digits, and exponents as great as there can be."""
    with localcontext(Context(prec=precision, Emin=MIN_EMIN, Emax=MAX_EMAX)):
        yield


def _decimal(number: Fraction) -> Decimal:
    return Decimal(number.numerator) / Decimal(number.denominator)


def power_table(
    gamma: Discount, exponents: NDArray[np.int64]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """:func:`power` with a lower and an upper bound, for every exponent; ``INFINITE`` gives 0.

    The bounds enclose g**n for every real g that rounds to gamma; gamma = 1 means 1. For a
    Fraction all three are exact.
    """
    finite = exponents[exponents != INFINITE]
    never = int(finite.max(initial=-1)) + 1  # the place of gamma**INFINITE in the table
    place = np.minimum(exponents, never)
    used = np.zeros(never + 1, dtype=np.bool_)
    used[place] = True
    kind = object if isinstance(gamma, Fraction) else np.float64
    tables = tuple(np.zeros(never + 1, dtype=kind) for _ in range(3))
    for n in np.flatnonzero(used):
        powers = _enclosed_power(gamma, INFINITE if n == never else int(n))
        for table, value in zip(tables, powers, strict=True):
            table[n] = value
    estimate, lower, upper = (table[place] for table in tables)
    return estimate, lower, upper


def _enclosed_power(gamma: Discount, n: int) -> tuple[Discount, Discount, Discount]:
    if n == INFINITE:
        zero = Fraction(0) if isinstance(gamma, Fraction) else 0.0
        return zero, zero, zero
    estimate = power(gamma, n)
    if isinstance(gamma, Fraction) or n == 0 or gamma == 1:
        return estimate, estimate, estimate
    # (1 +- u)**n for gamma itself, at most 2u for pow, 2u for these two lines; u = 2**-53.
    error = (n + 4) * 2.0**-53
    lower = max(math.nextafter(estimate * (1 - error), 0.0) - SMALLEST, 0.0)
    upper = min(math.nextafter(estimate * (1 + 2 * error), 2.0) + SMALLEST, 1.0)
    return estimate, lower, upper
