"""What can be guaranteed in stochastic models, in place of the paper's Assumption 1 and Theorem 2.

Let D be the dead states (P_min(F fail) = 1), T the time to fail, V_B = min E gamma**T.

Expected survival. E_max[T], the greatest expected time to fail over all policies, is finite on
D and solves

    h(s) = 1 + max_a sum_s' P(s'|s, a) h(s'),        h(fail) = 0.

It replaces the horizon H of Assumption 1, which need not exist. By Jensen's inequality
V_B(s) >= gamma**E_max[T](s) on D. With H_E = max over D of E_max[T], an action's critic in the
base convention, Q*(s, a) = E V_B(s'), bounds what the action does in one step:

    P(enter D or fail | s, a) <= Q*(s, a) / gamma**H_E.

Whole episodes. From states at risk Theorem 2 fails for every threshold: small risks add up. (For
the states with P_min = 0 some threshold works, see :mod:`dead_ends.safety.thresholds`.) Let X be an
undiscounted critic (gamma_safe = 1): X(fail) = 1 and E[X(s') | s, recovery] <= X(s), as holds
for X = P_min with a recovery policy that is greedy on it, and for X = X^pi with recovery pi. Let
the filter let an action through if E[X(s') | s, a] < epsilon, for any task policy, which may
depend on the history. Then, for N >= 1 steps from s0,

    P(no failure in N steps) >= (1 - epsilon)**(N - 1) * min(1 - X(s0), 1 - epsilon).

It is false for discounted-greedy recovery, and for an X that is too small, such as value
iteration from below that was stopped early; upper bounds of X that solve X >= F(X) may be used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.labels.classification import classify
from dead_ends.labels.labelling import INFINITE
from dead_ends.model.checks import read_only
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.discount import SMALLEST_NORMAL
from dead_ends.values.fixed_point.enclosure import check_width, enclose
from dead_ends.values.fixed_point.exact import ExactProblem, exact_rows
from dead_ends.values.fixed_point.operators import Optimum, unknown_rows
from dead_ends.values.fixed_point.rounding import RoundedKernel
from dead_ends.values.values import Values

__all__ = [
    "EpisodeGuarantee",
    "ExpectedSurvival",
    "episode_guarantee",
    "expected_survival",
    "one_step_risk",
]

BASE = (
    (ValueConvention.COST_FAIL_0, CriticConvention.LOSS_TARGET),
    (ValueConvention.COST_FAIL_1, CriticConvention.LOSS_TARGET),
    (ValueConvention.TIME, CriticConvention.NEXT_VALUE),
)
"""The conventions in which Q(s, a) = E gamma**T(s')."""
DIGITS = 30
EXACT_STEPS = 1000


@dataclass(frozen=True, eq=False)
class ExpectedSurvival:
    """E_max[T], the greatest expected time to fail, of every state.

    Attributes:
        time: (S,), float64 or Fractions: 0 on fail states, inf where failure is not certain.
        lower, upper: bounds that enclose it; equal to ``time`` if ``exact``.
        exact: whether the times are exact (Fractions, or the integers of a deterministic
            model).
        dead: bool (S,), D.
    """

    time: NDArray[Any]
    lower: NDArray[Any]
    upper: NDArray[Any]
    exact: bool
    dead: NDArray[np.bool_]

    @property
    def horizon(self) -> float | Fraction:
        """H_E, an upper bound of max E_max[T] over D (exactly, if ``exact``); 0 without D."""
        result: float | Fraction = max(self.upper[self.dead], default=0)
        return result

    def discounted(self, gamma_safe: float | Fraction) -> NDArray[np.float64]:
        """float (S,): gamma**E_max[T], a lower bound of V_B = min E gamma**T, rounded downward.

        1 on fail states, 0 where failure is not certain or the power is too small for floats.
        """
        time = self.upper.astype(np.float64)
        finite = np.where(np.isinf(time), 0.0, time)
        exponent = finite * math.log(gamma_safe)
        # Relative errors: of gamma itself, of log and the product, and of exp.
        error = (2 * finite + 4 * np.abs(exponent) + 8) * 2.0**-52
        power = np.maximum(np.exp(exponent) * (1 - error), 0.0)
        power[power < SMALLEST_NORMAL] = 0.0  # subnormal floats may be rounded up by half
        return np.where(finite > 0, power, np.where(np.isinf(time), 0.0, 1.0))


def expected_survival(
    model: SafeMDP, *, exact: bool = False, tolerance: float = 1e-6, max_iterations: int = 10_000
) -> ExpectedSurvival:
    """The greatest expected time to fail, with bounds, or exactly.

    Args:
        model: deterministic: survival times T. Stochastic: E_max[T] on the dead states.
        exact: in Fractions; floats are then read as their shortest decimals.
        tolerance: how far apart the bounds may be, relative to the time.
        max_iterations: sweeps of value iteration, at most.

    Raises:
        ValueError: if the tolerance is not reached; if ``exact`` and a row does not sum to
            exactly 1.
    """
    require_type(model, SafeMDP, "expected_survival")
    labelling = classify(model)
    if model.is_deterministic:
        times = labelling.survival_time
        time = np.where(times == INFINITE, math.inf, times.astype(np.float64))
        return _survival(labelling.dead, time, time, time, exact=True)
    states = np.flatnonzero(labelling.dead)
    unbounded = np.where(model.fail, 0.0, math.inf)
    if exact:
        time = unbounded.astype(object)
        for state, value in _exact_times(model, labelling.dead).items():
            time[state] = value
        return _survival(labelling.dead, time, time, time, exact=True)
    count = len(states)
    bounds = enclose(
        _longest(model, states),
        np.zeros(count),
        np.full(count, math.inf),
        tolerance,
        max_iterations,
    )
    check_width(bounds, tolerance, lambda place: model.state_name(states[place]))
    time, lower, upper = (unbounded.copy() for _ in range(3))
    time[states], lower[states], upper[states] = bounds.estimate, bounds.lower, bounds.upper
    return _survival(labelling.dead, time, lower, upper, exact=False)


def _longest(model: SafeMDP, states: NDArray[np.int64]) -> Optimum:
    """h -> 1 + max_a sum_s' P(s'|s, a) h(s') on the dead states, which are never left alive."""
    rows = sparse.csr_array(model.transitions()[unknown_rows(states, model.num_actions)])
    return Optimum(
        kernel=RoundedKernel.build(rows, zero=model.fail, one=np.zeros_like(model.fail)),
        available=model.available[states],
        unknown=states,
        weights=np.zeros(model.num_states),
        gamma=1.0,
        reward=1.0,
        maximise=True,
    )


def _exact_times(model: SafeMDP, dead: NDArray[np.bool_]) -> dict[int, Fraction]:
    def slowest(_state: int, q: Mapping[int, Any]) -> dict[int, Fraction]:
        return {max(q, key=q.__getitem__): Fraction(1)}

    known = {int(state): Fraction(0) for state in np.flatnonzero(~dead)}
    problem = ExactProblem(exact_rows(model), known, Fraction(1), slowest, reward=Fraction(1))
    return problem.solve()[0]


def _survival(
    dead: NDArray[np.bool_],
    time: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    exact: bool,
) -> ExpectedSurvival:
    time, lower, upper = read_only(time), read_only(lower), read_only(upper)
    return ExpectedSurvival(time=time, lower=lower, upper=upper, exact=exact, dead=dead)


def one_step_risk(values: Values, survival: ExpectedSurvival) -> NDArray[np.float64]:
    """float (S, A): an upper bound of P(enter D or fail | s, a), from the critic alone.

    Q*(s, a) / gamma**H_E, rounded upward, at most 1; +inf where Q is.

    Args:
        values: Q*, in a convention with Q = E gamma**T(s').
        survival: of the same model.

    Raises:
        ValueError: for another convention; if the model is an estimate.
    """
    require_type(values, Values, "one_step_risk")
    require_type(survival, ExpectedSurvival, "one_step_risk")
    _check_convention(values)
    values.model.refuse_estimate("a bound of the risk")
    scale = survival.discounted(values.gamma_safe)[survival.dead].min(initial=1.0)
    positive = np.asarray(values.Q_upper > 0, dtype=np.bool_)
    Q = values.Q_upper.astype(np.float64) * (1 + 2.0**-51)
    Q = np.where(positive, np.nextafter(Q, math.inf), 0.0)
    # Where gamma**H_E is too small for floats, only a Q that is 0 bounds anything.
    risk = np.where(positive, 1.0, 0.0) if scale == 0 else Q / scale * (1 + 2.0**-51)
    return np.where(np.isinf(Q), Q, np.minimum(risk, 1.0))


@dataclass(frozen=True)
class EpisodeGuarantee:
    """P(no failure in N steps) >= start * (1 - epsilon_safe)**(N - 1), for N >= 1.

    Attributes:
        epsilon_safe: the threshold of the filter, in [0, 1].
        start: min(1 - X(s0), 1 - epsilon_safe), averaged over the first state s0.
    """

    epsilon_safe: Fraction
    start: Fraction

    def probability(self, steps: int) -> float:
        """A lower bound of the probability of no failure in that many steps.

        Raises:
            ValueError: if ``steps`` is negative.
        """
        if steps < 0:
            raise ValueError(f"steps must not be negative, not {steps}")
        if steps == 0:
            return 1.0
        if steps <= EXACT_STEPS:
            bound = self._bound(steps)
            nearest = float(bound)
            return nearest if nearest <= bound else math.nextafter(nearest, 0.0)
        with localcontext(self._context):
            keep = _decimal(1 - self.epsilon_safe) ** (steps - 1)
            return math.nextafter(float(keep * _decimal(self.start)), 0.0)

    def steps(self, confidence: float | Fraction) -> float:
        """How many steps may be run so that none fails with this probability at least.

        Returns:
            The greatest N for which the bound says so, an integer (rounded downward by a
            part in 10**30 if it is above 1000); inf if there is no limit (the threshold is 0,
            or the confidence).

        Raises:
            ValueError: if the confidence does not lie in [0, 1].
        """
        if not 0 <= confidence <= 1:
            raise ValueError(f"confidence must lie in [0, 1], not {confidence}")
        wanted = Fraction(str(confidence))
        if wanted == 0 or (self.epsilon_safe == 0 and self.start >= wanted):
            return math.inf
        if self.start < wanted:
            return 0
        if self.start == wanted or self.epsilon_safe == 1:
            return 1
        with localcontext(self._context):
            margin = _decimal(self.start / wanted).ln() / -_decimal(1 - self.epsilon_safe).ln()
            below = 1 + int(margin * (1 - Decimal(10) ** -DIGITS))
        if below > EXACT_STEPS:
            return below
        return next(n for n in (below + 1, below) if self._bound(n) >= wanted)

    def _bound(self, steps: int) -> Fraction:
        return self.start * (1 - self.epsilon_safe) ** (steps - 1)

    @property
    def _context(self) -> Context:
        """Twice DIGITS digits for the logarithm of 1 - epsilon, however small epsilon is."""
        digits = 2 * DIGITS + len(str(self.epsilon_safe.denominator))
        return Context(prec=digits, Emin=-(10**9), Emax=10**9)


def episode_guarantee(
    values: Values, epsilon_safe: float | Fraction, state: int | None = None
) -> EpisodeGuarantee:
    """What the filter Q < epsilon_safe guarantees for an episode, with an undiscounted critic.

    The corrected agent executes the task policy's action a if Q(s, a) < epsilon_safe, else the
    recovery policy's: greedy on X if ``values`` is the best critic, the policy itself if
    ``values`` is a policy's. The guarantee uses the values' upper bounds, and the filter may
    (``values.Q_upper < epsilon_safe``).

    Args:
        values: X = V, the best critic or a policy's, with gamma_safe = 1.
        epsilon_safe: in [0, 1]. A float is read as its shortest decimal.
        state: the first state; without it, the model's initial distribution.

    Raises:
        ValueError: if the critic is discounted or in another convention, if epsilon_safe lies
            outside [0, 1], if there is no first state, if the model is an estimate.
    """
    require_type(values, Values, "episode_guarantee")
    _check_convention(values)
    values.model.refuse_estimate("a guarantee")
    if values.gamma_safe != 1:
        raise ValueError(f"the guarantee needs gamma_safe = 1, not {values.gamma_safe}")
    if not 0 <= epsilon_safe <= 1:
        raise ValueError(f"epsilon_safe must lie in [0, 1], not {epsilon_safe}")
    epsilon = Fraction(str(epsilon_safe))
    start = Fraction(0)
    for first, p in _first_states(values.model, state):
        risk = 1 if values.model.fail[first] else Fraction(values.V_upper[first])
        start += p * min(1 - risk, 1 - epsilon)
    return EpisodeGuarantee(epsilon, start)


def _first_states(model: SafeMDP, state: int | None) -> list[tuple[int, Fraction]]:
    if state is not None:
        if not 0 <= state < model.num_states:
            raise ValueError(f"there is no state {state} (0 to {model.num_states - 1})")
        return [(state, Fraction(1))]
    if model.initial is None:
        raise ValueError("the model has no initial states; name the first state")
    weights = [(int(s), Fraction(model.initial[s])) for s in np.flatnonzero(model.initial)]
    total = sum((p for _, p in weights), Fraction(0))
    return [(s, p / total) for s, p in weights]


def _check_convention(values: Values) -> None:
    if (values.value, values.critic) not in BASE:
        raise ValueError(
            f"the bound needs Q = E gamma**T(s'), such as the default convention, not value "
            f"{values.value.value!r} with critic {values.critic.value!r}"
        )


def _decimal(value: Fraction) -> Decimal:
    return Decimal(value.numerator) / Decimal(value.denominator)
