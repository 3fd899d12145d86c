"""The thresholds epsilon_safe that separate safe actions from unsafe ones.

The safety filter lets an action through if Q(s, a) < epsilon_safe. A threshold is right if, in
every safe state, "allowed" means the same as "leads to a safe state". With the exact critic Q*
these thresholds form an interval (0, upper], which may be empty.

Deterministic models. upper is the least Q* of the actions that leave S_safe, a power of gamma
whose exponent depends on the convention; H_b is the greatest survival time among the unsafe
states that can be entered from S_safe (0: only fail can be entered):

                            Q = V(s')            Q = c + (1-c) gamma V(s')   Q = gamma V(s')
    cost, V(fail) = 1       g^max(0, H_b - 1)    g^H_b                       g^max(1, H_b)
    cost, V(fail) = 0       g^(H_b - 1) *        g^H_b                       g^H_b *
    discounted time         g^H_b                g^(H_b + 1); 1 if H_b = 0   g^(H_b + 1)

    * empty if fail can be entered from a safe state: that action has Q = 0.

Theorem 2 of the paper asks for epsilon <= gamma^H, which is sufficient; gamma^H_b is the
largest threshold that works (in the base convention, the middle of the first two rows).

Stochastic models. Theorem 2 does not hold for S_safe. It does for Z = {P_min = 0}, with

    eps_Z = min {Q*(s, a) : s in Z, some successor of (s, a) outside Z}

in place of gamma^H: for 0 < epsilon <= eps_Z an action of a state in Z is allowed if and only
if all its successors lie in Z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.values.bellman import value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.discount import (
    SMALLEST_NORMAL,
    Discount,
    Powers,
    compare_power,
    power_at_most,
    read_discount,
    scientific,
)
from dead_ends.values.precision import UndecidedError

__all__ = ["ThresholdInterval", "threshold_interval"]


@dataclass(frozen=True)
class ThresholdInterval:
    """The thresholds (0, upper] with which the filter on Q* is exact.

    Attributes:
        upper: the greatest of them; inf if no action leaves the safe set; 0 if empty. A
            Fraction in exact calculations. Else a float: in a deterministic model
            ``gamma_safe ** exponent``, or, where that is subnormal, the greatest float that is
            not above it; in a stochastic one a lower bound of eps_Z. None if it is positive
            but smaller than every float: no float separates safe from unsafe actions then, and
            ``exact=True`` tells it.
        exponent: upper is gamma_safe**exponent in deterministic models, else None.
        gamma_safe: the discount.
        lower: 0, not included.
    """

    upper: Discount | None
    exponent: int | None
    gamma_safe: Discount
    lower: int = 0

    @property
    def empty(self) -> bool:
        """Whether no threshold separates safe actions from unsafe ones."""
        return self.upper == 0

    def contains(self, epsilon_safe: Discount) -> bool:
        """Whether the filter Q* < epsilon_safe is exact.

        Nothing is rounded: beside a Fraction a float epsilon is read as its shortest decimal,
        as by :func:`dead_ends.allowed_actions`; beside a float, floats compare as they are.

        Raises:
            ValueError: if epsilon_safe is NaN.
        """
        if epsilon_safe != epsilon_safe:
            raise ValueError("epsilon_safe is NaN")
        if self.upper is None:
            return isinstance(epsilon_safe, Fraction) and self._is_reached_by(epsilon_safe)
        if isinstance(self.upper, Fraction) and math.isfinite(epsilon_safe):
            epsilon_safe = Fraction(str(epsilon_safe))
        return self.lower < epsilon_safe <= self.upper

    def _is_reached_by(self, epsilon_safe: Fraction) -> bool:
        """0 < epsilon_safe <= gamma_safe**exponent, where that is smaller than every float."""
        assert self.exponent is not None
        gamma = Fraction(repr(self.gamma_safe))
        return epsilon_safe > 0 and compare_power(epsilon_safe, gamma, self.exponent) <= 0

    @property
    def recommended(self) -> float | None:
        """A threshold away from both ends, as a float; None if no float is in the interval.

        In a deterministic model it lies between two powers of gamma,
        gamma**(exponent + 1/2), so that no rounding of Q can matter; else half of ``upper``,
        at most 1/2 (where the interval has no upper end, or gamma = 1, or floats are too coarse
        for powers to lie between). If only one float is in the interval, it is that.
        """
        if self.upper is None or self.empty:
            return None
        top = min(float(self.upper), 1.0)
        candidates = [top / 2, top, math.nextafter(top, 0.0)]
        if self.exponent is not None and self.gamma_safe != 1:
            candidates.insert(0, float(self.gamma_safe) ** (self.exponent + 0.5))
        inside = [epsilon for epsilon in candidates if self.contains(epsilon)]
        away = [epsilon for epsilon in inside if epsilon < self.upper]
        return next(iter(away + inside), None)

    def __str__(self) -> str:
        """The interval for a sentence: what epsilon_safe may be."""
        if self.empty:
            return "none separates safe from unsafe actions"
        if self.upper == math.inf:
            return "any, for no action leaves the safe states"
        power = "" if self.exponent is None else f"gamma_safe**{self.exponent}"
        written = None if self.upper is None else _written(self.upper)
        joined = " = ".join(filter(None, (power, written)))
        size = "" if written else f"about {self._size()}"
        smaller = "" if self.recommended else "which is smaller than every float"
        return f"0 < epsilon_safe <= {', '.join(filter(None, (joined, size, smaller)))}"

    def _size(self) -> str:
        if self.upper is not None:
            return scientific(self.upper)
        assert self.exponent is not None
        return scientific(self.gamma_safe, self.exponent)


def _written(number: Discount) -> str | None:
    """All digits of a number; None of a long fraction, or of a float that has few."""
    if isinstance(number, Fraction):
        return str(number) if number.denominator < 10**12 else None
    return repr(number) if number >= SMALLEST_NORMAL else None


def threshold_interval(
    model: SafeMDP,
    gamma_safe: Discount = 0.99,
    *,
    value: ValueConvention | str = ValueConvention.COST_FAIL_0,
    critic: CriticConvention | str = CriticConvention.LOSS_TARGET,
    exact: bool | None = None,
    tolerance: float = 1e-9,
) -> ThresholdInterval:
    """The thresholds with which the filter on Q* tells safe actions from unsafe ones.

    Args:
        model: deterministic: the table in the module's docstring, from integers. Stochastic:
            (0, eps_Z] for the states with P_min = 0; nothing is said about states at risk.
        gamma_safe, value, critic: the discount and the convention of Q*.
        exact: in Fractions; None means if ``gamma_safe`` is a Fraction.
        tolerance: for the values of a stochastic model.

    Returns:
        The interval; empty in the paper's literal convention if fail can be entered from a
        safe state.

    Raises:
        ValueError: for a discount outside (0, 1]; if the values of a stochastic model are too
            small for floats, so that no positive lower bound of eps_Z is known.
    """
    require_type(model, SafeMDP, "threshold_interval")
    gamma, exact = read_discount(gamma_safe, exact)
    powers = Powers.of(ValueConvention(value), CriticConvention(critic))
    if model.is_deterministic:
        return _from_horizon(model, gamma, powers)
    leaving = _leaving(model)
    if not leaving.any():
        return ThresholdInterval(math.inf, None, gamma)
    values = value_iteration(
        model, gamma, value=value, critic=critic, exact=exact, tolerance=tolerance
    )
    upper = values.Q_lower[leaving].min()
    if not upper > 0 and values.Q_upper[leaving].min() > 0:
        state, action = np.argwhere(leaving & ~np.asarray(values.Q_lower > 0, dtype=np.bool_))[0]
        raise UndecidedError(
            f"{model.state_name(state)}, {model.action_name(action)}: Q is positive, but floats "
            f"only tell that it is at most {values.Q_upper[state, action]:.3g}",
            {"exact": "use exact=True"},
        )
    return ThresholdInterval(upper if exact else float(upper), None, gamma)


def _from_horizon(model: SafeMDP, gamma: Discount, powers: Powers) -> ThresholdInterval:
    labelling = classify(model)
    horizon = labelling.boundary_horizon
    if horizon is None:
        return ThresholdInterval(math.inf, None, gamma)
    exponent = powers.fail if horizon == 0 else horizon - 1 + powers.successor
    if powers.fail is None and _enters_fail(model, labelling.safe):
        exponent = None
    if exponent is None:
        return ThresholdInterval(0, None, gamma)
    if isinstance(gamma, Fraction):
        return ThresholdInterval(gamma**exponent, exponent, gamma)
    return ThresholdInterval(power_at_most(gamma, exponent), exponent, gamma)


def _enters_fail(model: SafeMDP, states: NDArray[np.bool_]) -> bool:
    """Whether an action leads from one of these states directly into fail."""
    successors = model.successors()[states]
    return bool((model.fail[successors] & (successors >= 0)).any())


def _leaving(model: SafeMDP) -> NDArray[np.bool_]:
    """bool (S, A): the actions of states with P_min = 0 that may lead to another state."""
    labelling = classify(model)
    return labelling.safe[:, None] & model.available & ~safe_actions(model, labelling)
