"""Recovery policies, allowed actions and the policy sets Pi_c (safe_policies_set in the paper).

Given a safety critic Q (S, A) and a threshold epsilon_safe,

    greedy actions     argmin_a Q(s, a), all of them: ties matter to the recovery policy
    allowed actions    {a : Q(s, a) < epsilon_safe}, strictly, as in behavior_correction
    policy set         Pi_c = {pi : Q(s, a) < epsilon_safe for all s in S_safe, pi(a|s) > 0}

The paper writes the last one with Q(s, pi(s)), which can also be read as an expectation,
sum_a pi(a|s) Q(s, a) < epsilon_safe. Under that reading the set contains policies that fail
(two states, uniform over "stay" and "fail", gamma = epsilon = 1/2 under their own critic), so
the reading per action is the default.

What is exact: comparisons with Fractions, and with the values of a deterministic model. For
other values in floating point the bounds decide; where they do not, an error says so.
"""

from __future__ import annotations

import math
from enum import StrEnum
from fractions import Fraction
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.model.checks import Names, plain_array
from dead_ends.model.policy_table import as_distribution, check_table
from dead_ends.safety.critics import Unguarded, critic_table, require_critic
from dead_ends.values.precision import UndecidedError
from dead_ends.values.values import Values

__all__ = [
    "Reading",
    "allowed_actions",
    "checked_policy",
    "greedy_actions",
    "in_policy_set",
    "recovery_policy",
]


class Reading(StrEnum):
    """How Q(s, pi(s)) in the paper's policy set is read for a stochastic policy."""

    PER_ACTION = "per-action"
    """Q(s, a) < epsilon_safe for every action a that the policy may take."""

    EXPECTATION = "expectation"
    """sum_a pi(a|s) Q(s, a) < epsilon_safe; such policies may fail."""


def greedy_actions(Q: ArrayLike | Values | Unguarded) -> NDArray[np.bool_]:
    """All minimisers of each row: the actions a greedy recovery policy may take.

    Args:
        Q: a critic (S, A); +inf for actions that are not available.

    Returns:
        bool (S, A): True at every exact minimiser; False at +inf, so rows without an
        available action (fail states) have none. Ties are exact for Fractions and for the
        values of a deterministic model, and are those of the rounded numbers otherwise.

    Raises:
        ValueError: if Q is no table of numbers, or has a NaN (the message names its place).
    """
    table = critic_table(Q)
    best = table.min(axis=1, keepdims=True)
    return np.asarray((table == best) & (table < math.inf), dtype=np.bool_)


def recovery_policy(
    Q: ArrayLike | Values | Unguarded, rng: np.random.Generator | None = None
) -> NDArray[np.int64]:
    """One greedy recovery policy, pi_rec(s) in argmin_a Q(s, a) (obj_rec_p in the paper).

    Args:
        Q: a critic (S, A).
        rng: picks uniformly among the minimisers; without it the lowest index is taken.

    Returns:
        int (S,); 0 in rows without an available action.

    Raises:
        ValueError: as :func:`greedy_actions`.
    """
    greedy = greedy_actions(Q)
    if rng is None:
        return np.asarray(greedy.argmax(axis=1))
    # A row without an action has equal keys, so that its argmax is 0.
    return np.asarray(np.where(greedy, rng.random(greedy.shape), -1.0).argmax(axis=1))


def allowed_actions(Q: Values | Unguarded, epsilon_safe: float | Fraction) -> NDArray[np.bool_]:
    """The actions that the safety filter lets through: Q(s, a) < epsilon_safe, strictly.

    Nothing is rounded: a Fraction epsilon is compared exactly with floats, and beside a critic
    of Fractions a float epsilon is read as its shortest decimal (0.1 is 1/10), as all floats
    are in exact solutions.

    Args:
        Q: a critic (S, A): :class:`Values`, of which the bounds decide unless they are exact.
            Where they enclose epsilon but Q equals it (epsilon = gamma_safe**k on a
            deterministic model) the action is blocked. Of a bare table
            :func:`dead_ends.unguarded` the numbers decide as they are.
        epsilon_safe: the threshold; at 0 or below nothing is allowed.

    Returns:
        bool (S, A), False where Q is +inf: unavailable actions and fail states.

    Raises:
        TypeError: if Q is a bare table.
        ValueError: if epsilon_safe is NaN; if the bounds of a value leave open on which side
            of epsilon_safe it lies. The message names the state and action.
    """
    require_critic(Q, "allowed_actions")
    table = critic_table(Q)
    epsilon = _read_threshold(epsilon_safe, table)
    if isinstance(Q, Values) and not Q.exact:
        _check_decided(Q, table, epsilon)
    return _below(table, epsilon)


def in_policy_set(
    policy: ArrayLike,
    Q: Values | Unguarded,
    epsilon_safe: float | Fraction,
    *,
    safe: NDArray[np.bool_] | None = None,
    reading: Reading | str = Reading.PER_ACTION,
) -> bool:
    """Whether a policy lies in Pi_c of a critic (safe_policies_set in the paper).

    Args:
        policy: int (S,), or float or Fraction (S, A).
        Q: the critic, such as Q^pi_task (RRL) or Q* (DEA-RRL).
        epsilon_safe: the threshold.
        safe: bool (S,), the paper's S_safe: all states that are neither fail nor dead
            (``classify(model).paper_safe``). May be left out if Q is a :class:`Values`.
        reading: how a stochastic policy is judged, see :class:`Reading`. Expectations are
            taken exactly, with the policy's rows scaled to sum to 1.

    Returns:
        True if the condition holds in every state of S_safe. That the set is not empty is
        another question: it is empty if some state of S_safe has no allowed action.

    Raises:
        ValueError: as :func:`allowed_actions`; if shapes do not fit; if ``safe`` is missing.
    """
    require_critic(Q, "in_policy_set")
    table = critic_table(Q)
    rows = np.flatnonzero(_safe_states(safe, Q, len(table)))
    distribution = as_distribution(checked_policy(policy, table), table.shape[1])
    support = distribution[rows] > 0
    if Reading(reading) is Reading.PER_ACTION:
        return not (support & ~allowed_actions(Q, epsilon_safe)[rows]).any()
    epsilon = _read_threshold(epsilon_safe, table)
    lower, upper = (Q.Q_lower, Q.Q_upper) if isinstance(Q, Values) else (table, table)
    # Between its least and greatest term an expectation needs no arithmetic.
    inside = np.all(~support | _below(upper[rows], epsilon), axis=1)
    outside = ~np.any(support & _below(lower[rows], epsilon), axis=1)
    if (outside & ~inside).any():
        return False
    return all(
        _expectation_below(distribution[state], lower[state], upper[state], epsilon, state)
        for state in rows[~inside]
    )


def checked_policy(policy: ArrayLike, table: NDArray[Any], what: str = "policy") -> NDArray[Any]:
    """A policy checked against a critic's table, without a model: int (S,) or (S, A).

    Rows in which the critic has no available action (fail states) are not checked; an action
    that is not available may be proposed: it is never allowed.

    Raises:
        ValueError: naming the state and action.
    """
    acts = np.asarray((table < math.inf).any(axis=1), dtype=np.bool_)
    every = np.ones(table.shape, dtype=np.bool_)
    return check_table(what, policy, acts, every, Names(None, None, *table.shape))


def _read_threshold(epsilon_safe: float | Fraction, table: NDArray[Any]) -> float | Fraction:
    """The threshold as a float, or as a Fraction where Q holds Fractions."""
    if not isinstance(epsilon_safe, Real) or isinstance(epsilon_safe, bool):
        raise ValueError(f"epsilon_safe must be a number, not {epsilon_safe!r}")
    if isinstance(epsilon_safe, Fraction):
        return epsilon_safe
    value = float(epsilon_safe)
    if math.isnan(value):
        raise ValueError("epsilon_safe is NaN")
    return Fraction(repr(value)) if table.dtype == object and math.isfinite(value) else value


def _below(table: NDArray[Any], epsilon: float | Fraction) -> NDArray[np.bool_]:
    """``table < epsilon`` without rounding epsilon, nor comparing float by float in Python."""
    if table.dtype != object and isinstance(epsilon, Fraction):
        nearest = float(epsilon)
        # The least float that is not below epsilon separates the floats as epsilon does.
        epsilon = nearest if nearest >= epsilon else math.nextafter(nearest, math.inf)
    return np.asarray(table < epsilon, dtype=np.bool_)


def _check_decided(values: Values, table: NDArray[Any], epsilon: float | Fraction) -> None:
    """No bounds enclose epsilon, except where Q is epsilon itself, a canonical power."""
    undecided = _below(values.Q_lower, epsilon) & ~_below(values.Q_upper, epsilon)
    if values.model.is_deterministic:
        undecided &= np.asarray(table != epsilon)
    if undecided.any():
        state, action = (int(index) for index in np.argwhere(undecided)[0])
        raise _undecided(
            f"{values.model.state_name(state)}, {values.model.action_name(action)}: Q",
            values.Q_lower[state, action],
            values.Q_upper[state, action],
            epsilon,
        )


def _undecided(what: str, lower: Any, upper: Any, epsilon: float | Fraction) -> UndecidedError:
    return UndecidedError(
        f"{what} lies between {lower} and {upper}, so it is not certain whether it is below "
        f"epsilon_safe = {epsilon}",
        {
            "exact": "use exact values",
            "epsilon_safe": "an epsilon_safe that is farther away",
        },
    )


def _safe_states(
    safe: NDArray[np.bool_] | None, Q: Values | Unguarded, num_states: int
) -> NDArray[np.bool_]:
    if safe is None:
        if not isinstance(Q, Values):
            raise ValueError(
                "in_policy_set needs `safe`, the mask of S_safe, unless Q is a Values "
                "(which knows its model)"
            )
        from dead_ends.labels.classification import classify

        return classify(Q.model).paper_safe
    mask = plain_array("safe", safe)
    if mask.dtype != np.bool_ or mask.shape != (num_states,):
        raise ValueError(
            f"safe must be a boolean mask of shape ({num_states},), "
            f"not {mask.dtype} of shape {mask.shape}"
        )
    return mask


def _expectation_below(
    weights: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    epsilon: float | Fraction,
    state: int,
) -> bool:
    """Whether sum_a pi(a|s) Q(s, a) < epsilon, in exact arithmetic."""
    least, greatest = _expectation(weights, lower), _expectation(weights, upper)
    if least < epsilon <= greatest:
        raise _undecided(
            f"state {state}: the expectation of Q", float(least), float(greatest), epsilon
        )
    return greatest < epsilon


def _expectation(weights: NDArray[Any], row: NDArray[Any]) -> float | Fraction:
    # str gives the shortest decimal of a float, and a Fraction as it is.
    terms = [(Fraction(str(w)), q) for w, q in zip(weights, row, strict=True) if w > 0]
    if any(q == math.inf for _, q in terms):
        return math.inf
    total = sum((w for w, _ in terms), Fraction(0))
    return sum((w * Fraction(q) for w, q in terms), Fraction(0)) / total
