"""From Bellman's equations, set up, to a critic in one of the paper's conventions.

:mod:`dead_ends.values.bellman` and :mod:`dead_ends.values.expectile` set the equations up; here
they are solved by :mod:`dead_ends.values.fixed_point`, and the solution is expressed in a
convention. Three ways to the same result, :class:`dead_ends.values.values.Values`: from survival
times (powers of gamma), from Fractions, and from enclosures in floating point. What the
conventions are in terms of V_A, the discounted cost on entering fail, is stated in
:mod:`dead_ends.values.discount`.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.labelling import INFINITE
from dead_ends.model.checks import read_only
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.discount import Discount, Powers, power_table, read_discount
from dead_ends.values.fixed_point.enclosure import MonotoneOperator, check_width, enclose
from dead_ends.values.fixed_point.exact import Choose, ExactProblem, exact_rows
from dead_ends.values.fixed_point.rounding import Float, RoundedKernel, grow, shrink
from dead_ends.values.values import Values

__all__ = ["Known", "Settings", "from_equations", "from_operator", "from_times"]

Mask = NDArray[np.bool_]
Bounds = tuple[Float, Float, Float]
"""Lower bounds, estimates, upper bounds."""


@dataclass(frozen=True)
class Settings:
    """What is asked for: the discount, the convention, exactly or how closely.

    Attributes:
        gamma: gamma_safe; a Fraction if and only if ``exact``.
        exact: calculate in Fractions.
        value, critic: the convention of the result.
        tolerance: how far apart the bounds of a value may be.
        max_iterations: sweeps of value iteration, at most.
    """

    gamma: Discount
    exact: bool
    value: ValueConvention
    critic: CriticConvention
    tolerance: float
    max_iterations: int

    @classmethod
    def read(
        cls,
        gamma_safe: Discount,
        value: ValueConvention | str,
        critic: CriticConvention | str,
        exact: bool | None,
        tolerance: float,
        max_iterations: int,
    ) -> Settings:
        """The checked settings.

        Raises:
            ValueError: for a discount outside (0, 1], an unknown convention, a tolerance that
                is not positive, or no iterations.
        """
        gamma, exact = read_discount(gamma_safe, exact)
        if not tolerance > 0:
            raise ValueError(f"tolerance must be positive, not {tolerance}")
        if max_iterations < 1:
            raise ValueError(f"max_iterations must be at least 1, not {max_iterations}")
        return cls(
            gamma,
            exact,
            ValueConvention(value),
            CriticConvention(critic),
            tolerance,
            max_iterations,
        )

    @property
    def powers(self) -> Powers:
        """The exponents of the convention."""
        return Powers.of(self.value, self.critic)


@dataclass(frozen=True, eq=False)
class Known:
    """The states whose value the graph decides.

    Attributes:
        zero: bool (S,), failure is not possible: V = 0.
        one: bool (S,), fail, and at gamma = 1 the states that fail with probability 1:
            w = 1, V = 1 off fail.
    """

    zero: Mask
    one: Mask

    @property
    def unknown(self) -> NDArray[np.int64]:
        """The other states."""
        return np.flatnonzero(~(self.zero | self.one))

    @property
    def weights(self) -> Float:
        """w of these states, float (S,); 0 on the others."""
        return self.one.astype(np.float64)


def from_times(model: SafeMDP, times: NDArray[np.int32], settings: Settings) -> Values:
    """The critic of a deterministic model from the times to fail (``INFINITE``: never).

    V and w are powers of gamma with integer exponents, so nothing is solved.
    """
    powers = settings.powers
    never = times == INFINITE
    before = np.where(never, 0, times.astype(np.int64) - 1)  # the exponent of V_A off fail
    fail_value = 0 if powers.fail_value else INFINITE
    fail_weight = INFINITE if powers.fail is None else powers.fail
    V = _exponents(before + powers.value, never, model.fail, fail_value)
    w = _exponents(before + powers.successor, never, model.fail, fail_weight)
    successors = model.successors()
    unavailable = successors < 0
    tables = [weights[successors] for weights in power_table(settings.gamma, w)]
    for table in tables:
        table[unavailable] = np.inf
    values, lower, upper = power_table(settings.gamma, V)
    return _values(model, settings, 0, (lower, values, upper), (tables[1], tables[0], tables[2]))


def _exponents(
    exponents: NDArray[np.int64], never: Mask, fail: Mask, at_fail: int
) -> NDArray[np.int64]:
    return np.where(fail, at_fail, np.where(never, INFINITE, exponents))


def from_equations(model: SafeMDP, known: Known, choose: Choose, settings: Settings) -> Values:
    """The critic in Fractions, by policy iteration.

    Args:
        model: the model; its probabilities are read as exact numbers.
        known: the states whose value the graph decides.
        choose: the weights of the actions at given q (see
            :mod:`dead_ends.values.fixed_point.exact`).
        settings: the discount and the convention.
    """
    gamma = Fraction(settings.gamma)
    powers = settings.powers
    rows = exact_rows(model)
    weights = {int(state): Fraction(0) for state in np.flatnonzero(known.zero)}
    weights |= {int(state): Fraction(1) for state in np.flatnonzero(known.one)}
    solved, iterations = ExactProblem(rows, weights, gamma, choose).solve()
    entering = weights | solved
    fail_weight = Fraction(0) if powers.fail is None else gamma**powers.fail
    V = _exact_column(model, entering, gamma**powers.value, Fraction(powers.fail_value))
    w = _exact_column(model, entering, gamma**powers.successor, fail_weight)
    Q = np.full((model.num_states, model.num_actions), np.inf, dtype=object)
    for state, actions in enumerate(rows):
        for action, row in actions.items():
            Q[state, action] = sum((p * w[t] for t, p in row), Fraction(0))
    return _values(model, settings, iterations, (V, V, V), (Q, Q, Q))


def _exact_column(
    model: SafeMDP, entering: dict[int, Fraction], factor: Fraction, at_fail: Fraction
) -> NDArray[np.object_]:
    """factor * V_A off fail; at fail the given number."""
    column = np.empty(model.num_states, dtype=object)
    for state, violated in enumerate(model.fail):
        column[state] = at_fail if violated else factor * entering[state]
    return column


def from_operator(
    model: SafeMDP,
    known: Known,
    operator: MonotoneOperator,
    settings: Settings,
) -> Values:
    """The critic in floats, with bounds.

    Args:
        model: the model.
        known: the states whose value the graph decides.
        operator: its fixed point is V_A on the unknown states.
        settings: the discount, the convention and the tolerance.

    Raises:
        ValueError: if the bounds are not within the tolerance after ``max_iterations`` sweeps.
    """
    unknown = known.unknown
    count = len(unknown)
    bounds = enclose(
        operator,
        np.zeros(count),
        np.ones(count),
        settings.tolerance,
        settings.max_iterations,
    )
    check_width(
        bounds,
        settings.tolerance,
        lambda place: model.state_name(unknown[place]),
        float(settings.gamma),
    )
    entering = tuple(
        _scattered(known.weights, unknown, x) for x in (bounds.lower, bounds.estimate, bounds.upper)
    )
    powers = settings.powers
    V = _discounted(entering, settings, powers.value, model.fail, float(powers.fail_value))
    at_fail = 0.0 if powers.fail is None else float(settings.gamma) ** powers.fail
    w = _discounted(entering, settings, powers.successor, model.fail, at_fail)
    return _values(model, settings, bounds.iterations, V, _critic(model, w))


def _scattered(known: Float, unknown: NDArray[np.int64], x: Float) -> Float:
    result = known.copy()
    result[unknown] = x
    return result


def _discounted(
    entering: tuple[Float, ...], settings: Settings, power: int, fail: Mask, at_fail: float
) -> Bounds:
    """gamma**power times V_A off fail; at fail the given number."""
    lower, estimate, upper = entering
    if power and settings.gamma != 1:
        factor = float(settings.gamma) ** power
        lower = shrink(lower * factor, np.where(lower > 0, 4.0, 0.0))
        estimate = estimate * factor
        upper = grow(upper * factor, np.where(upper > 0, 4.0, 0.0))
    return (
        np.where(fail, at_fail, lower),
        np.where(fail, at_fail, estimate),
        np.where(fail, at_fail, upper),
    )


def _critic(model: SafeMDP, w: Bounds) -> Bounds:
    """Q(s, a) = sum_s' P(s'|s, a) w(s'), at most 1 also where rows sum to slightly more."""
    lower, estimate, upper = w
    kernel = RoundedKernel.build(model.transitions(), upper == 0, lower == 1)
    shape = (model.num_states, model.num_actions)
    low = np.minimum(kernel.lower(lower), 1.0).reshape(shape)
    high = np.minimum(kernel.upper(upper), 1.0).reshape(shape)
    middle = np.clip(kernel.sums(estimate).reshape(shape), low, high)
    for table in (low, middle, high):
        table[~model.available] = np.inf
    return low, middle, high


def _values(
    model: SafeMDP,
    settings: Settings,
    iterations: int,
    V: tuple[NDArray[Any], ...],
    Q: tuple[NDArray[Any], ...],
) -> Values:
    for array in (*V, *Q):
        read_only(array)
    return Values(
        V=V[1],
        Q=Q[1],
        V_lower=V[0],
        V_upper=V[2],
        Q_lower=Q[0],
        Q_upper=Q[2],
        exact=settings.exact,
        iterations=iterations,
        model=model,
        gamma_safe=settings.gamma,
        value=settings.value,
        critic=settings.critic,
    )
