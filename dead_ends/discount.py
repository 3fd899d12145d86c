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
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.conventions import CriticConvention, ValueConvention
from dead_ends.results import INFINITE

__all__ = ["Discount", "Powers", "power", "power_table", "read_discount"]

Discount = float | Fraction
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
