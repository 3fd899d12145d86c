"""What is judged: the library's functions as one value, and wrong variants of it.

A check never calls the library by itself. It is handed an :class:`Implementation`, so that
the same check can be handed a wrong one, which it has to reject.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.classification import classify
from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.correction import behavior_correction, corrected_model
from dead_ends.safety.critics import unguarded
from dead_ends.safety.policies import Reading, allowed_actions, greedy_actions, in_policy_set
from dead_ends.safety.thresholds import ThresholdInterval, threshold_interval
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.expectile import expectile_iteration

Discount = float | Fraction
ZERO: Any = Fraction(0)
ONE: Any = Fraction(1)
Table = NDArray[Any]
Tables = tuple[Table, Table]
"""V (S,) and Q (S, A)."""


@dataclass(frozen=True)
class Implementation:
    """The functions that the statements are about.

    Attributes:
        labels: model -> labels, survival times and horizons.
        best: (model, gamma, value=, critic=) -> V*, Q*.
        of_policy: (model, policy, gamma, value=, critic=) -> V^pi, Q^pi.
        expectile: (model, data policy, tau, gamma) -> V, Q.
        recovery_critic: (Q of the recovery policy's training, Q of the gate) -> the table that
            the recovery policy minimises.
        threshold: (gamma, exponent) -> epsilon_safe, the paper's gamma^H.
        allowed: (Q, epsilon) -> bool (S, A).
        greedy: Q -> bool (S, A), the minimisers.
        member: (policy, Q, epsilon, S_safe, reading) -> whether the policy is in Pi_c.
        interval: (model, gamma, value=, critic=) -> the thresholds that are exact.
        correct: behavior correction of a policy.
        corrected: the closed loop as a model.
        swept: (model, count) -> P_min(fail) by so many sweeps of value iteration from below.
    """

    labels: Callable[[SafeMDP], Labelling]
    best: Callable[..., Tables]
    of_policy: Callable[..., Tables]
    expectile: Callable[[SafeMDP, Table, Fraction, Discount], Tables]
    recovery_critic: Callable[[Table, Table], Table]
    threshold: Callable[[Discount, int], Discount]
    allowed: Callable[[Table, Discount], NDArray[np.bool_]]
    greedy: Callable[[Table], NDArray[np.bool_]]
    member: Callable[[Table, Table, Discount, NDArray[np.bool_], Reading], bool]
    interval: Callable[..., ThresholdInterval]
    correct: Callable[[Table, Table, Discount, Table], Table]
    corrected: Callable[[SafeMDP, Table, Discount, Table], SafeMDP]
    swept: Callable[[SafeMDP, int], Table]


def _best(model: SafeMDP, gamma: Discount, **convention: Any) -> Tables:
    V, Q = value_iteration(model, gamma, **convention)
    return V, Q


def _of_policy(model: SafeMDP, policy: Table, gamma: Discount, **convention: Any) -> Tables:
    V, Q = evaluate_policy(model, policy, gamma, **convention)
    return V, Q


def _expectile(model: SafeMDP, data: Table, tau: Fraction, gamma: Discount) -> Tables:
    V, Q = expectile_iteration(model, data, tau, gamma)
    return V, Q


def _member(
    policy: Table, Q: Table, epsilon: Discount, safe: NDArray[np.bool_], reading: Reading
) -> bool:
    return in_policy_set(policy, unguarded(Q), epsilon, safe=safe, reading=reading)


def _swept(model: SafeMDP, count: int) -> Table:
    """min_a E X(s'), ``count`` times from X = 0 off fail; not what the library does."""
    kernel, data = model.transitions(), model.exact_probabilities()
    rows = np.repeat(np.arange(kernel.shape[0]), np.diff(kernel.indptr))
    X = np.where(model.fail, ONE, ZERO)
    for _ in range(count):
        expected = np.full(kernel.shape[0], ZERO, dtype=object)
        np.add.at(expected, rows, np.array(data, dtype=object) * X[kernel.indices])
        available = np.where(model.available, expected.reshape(model.available.shape), 2)
        X = np.where(model.fail, ONE, available.min(axis=1))
    return np.asarray(X)


LIBRARY = Implementation(
    labels=classify,
    best=_best,
    of_policy=_of_policy,
    expectile=_expectile,
    recovery_critic=lambda trained, gate: trained,  # noqa: ARG005  # named as in the attribute
    threshold=lambda gamma, exponent: gamma**exponent,
    allowed=lambda Q, epsilon: allowed_actions(unguarded(Q), epsilon),
    greedy=greedy_actions,
    member=_member,
    interval=threshold_interval,
    correct=lambda policy, Q, *rest: behavior_correction(policy, unguarded(Q), *rest),
    corrected=lambda model, Q, *rest: corrected_model(model, unguarded(Q), *rest),
    swept=_swept,
)


# --- Wrong variants -----------------------------------------------------------------------


def _later(labelling: Labelling, steps: int) -> Labelling:
    """All finite survival times, and the horizons, off by ``steps``."""
    time = labelling.survival_time
    wrong = np.where(labelling.dead, time + steps, time).astype(np.int32)
    horizon, boundary = labelling.horizon, labelling.boundary_horizon
    return replace(
        labelling,
        survival_time=wrong,
        horizon=None if horizon is None else max(horizon + steps, 0),
        boundary_horizon=None if boundary is None else max(boundary + steps, 0),
    )


def _sweeps(model: SafeMDP, gamma: Discount, count: int, start: int) -> Tables:
    """Synchronous value iteration on a deterministic model, stopped after ``count`` sweeps."""
    successors, fail = model.successors(), model.fail
    number: Any = Fraction if isinstance(gamma, Fraction) else float
    V = np.where(fail, number(0), number(start)).astype(object if number is Fraction else float)
    for _ in range(count):
        V = np.where(fail, number(0), _targets(model, successors, V, gamma).min(axis=1))
    return V, _targets(model, successors, V, gamma)


def _targets(model: SafeMDP, successors: Table, V: Table, gamma: Discount) -> Table:
    Q = np.where(model.fail[successors], 1, gamma * V[successors])
    return np.where(model.available, Q, np.inf)


def _repeated_product(model: SafeMDP, gamma: Discount, **_: Any) -> Tables:
    """gamma^T as a float, by T multiplications."""
    return _sweeps(model, float(gamma), model.num_states, 0)


def _worst(model: SafeMDP, gamma: Discount, **_: Any) -> Tables:
    """max in place of min in the Bellman equation."""
    successors, fail = model.successors(), model.fail
    V = np.where(fail, 0.0, 0.0) * gamma
    for _sweep in range(model.num_states):
        Q = _targets(model, successors, V, gamma)
        V = np.where(fail, 0 * gamma, np.where(model.available, Q, -1).max(axis=1))
    return V, _targets(model, successors, V, gamma)


def _convention(
    value: ValueConvention | None = None, critic: CriticConvention | None = None
) -> Implementation:
    """The library with one or both conventions fixed, whatever it is asked for."""
    fixed = {name: v for name, v in (("value", value), ("critic", critic)) if v is not None}

    def best(model: SafeMDP, gamma: Discount, **convention: Any) -> Tables:
        return _best(model, gamma, **(convention | fixed))

    def of_policy(model: SafeMDP, policy: Table, gamma: Discount, **convention: Any) -> Tables:
        return _of_policy(model, policy, gamma, **(convention | fixed))

    return replace(LIBRARY, best=best, of_policy=of_policy)


def _of_first_actions(model: SafeMDP, gamma: Discount, **convention: Any) -> Tables:
    """The critic of one policy, "the first available action", in place of Q*."""
    return _of_policy(model, model.available.argmax(axis=1), gamma, **convention)


def _greatest(Q: Table) -> NDArray[np.bool_]:
    finite = np.where(np.asarray(np.inf > Q, dtype=np.bool_), Q, -1)
    return np.asarray((finite == finite.max(axis=1, keepdims=True)) & (np.inf > Q), dtype=np.bool_)


def _some_path_fails(model: SafeMDP) -> Labelling:
    """Dead if some path fails, in place of every path: a wrong quantifier."""
    labelling = classify(model)
    reached = model.fail.copy()
    for _ in range(model.num_states):
        reached |= (reached[model.successors()] & model.available).any(axis=1)
    labels = np.where(reached & ~model.fail, Label.DEAD, labelling.labels)
    return replace(labelling, labels=labels.astype(np.uint8))


EPSILON_TOO_LARGE = replace(LIBRARY, threshold=lambda gamma, exponent: gamma ** (exponent - 1))
EPSILON_TOO_SMALL = replace(LIBRARY, threshold=lambda gamma, exponent: gamma ** (exponent + 1))
TINY_EPSILON = replace(LIBRARY, threshold=lambda gamma, exponent: gamma ** (exponent + 20))
NOTHING_ALLOWED = replace(LIBRARY, threshold=lambda gamma, exponent: 0 * gamma)  # noqa: ARG005
HORIZON_TOO_SHORT = replace(LIBRARY, labels=lambda model: _later(classify(model), -1))
HORIZON_TOO_LONG = replace(LIBRARY, labels=lambda model: _later(classify(model), 1))


def _scaled_interval(power: int) -> Implementation:
    """The upper end of the thresholds off by a power of gamma."""

    def interval(model: SafeMDP, gamma: Discount, **convention: Any) -> ThresholdInterval:
        found = threshold_interval(model, gamma, **convention)
        assert found.upper is not None  # only a float can be too small
        return replace(found, upper=found.upper * gamma**power)

    return replace(LIBRARY, interval=interval)


INTERVAL_TOO_LARGE, INTERVAL_TOO_SMALL = _scaled_interval(-1), _scaled_interval(1)
DEAD_IF_ONE_PATH_FAILS = replace(LIBRARY, labels=_some_path_fails)
NOT_STRICT = replace(LIBRARY, allowed=lambda Q, epsilon: np.asarray(epsilon >= Q, dtype=np.bool_))
MAX_RECOVERY = replace(LIBRARY, greedy=_greatest)
WORST_CRITIC = replace(LIBRARY, best=_worst)
STOPPED_EARLY = replace(LIBRARY, best=lambda model, gamma, **_: _sweeps(model, gamma, 1, 0))
STOPPED_EARLY_FROM_ABOVE = replace(
    LIBRARY, best=lambda model, gamma, **_: _sweeps(model, gamma, 1, 1)
)
REPEATED_PRODUCTS = replace(LIBRARY, best=_repeated_product)
RECOVERY_FROM_GATE = replace(LIBRARY, recovery_critic=lambda trained, gate: gate)  # noqa: ARG005
EXPECTATION = replace(
    LIBRARY,
    member=lambda policy, Q, epsilon, safe, _: _member(
        policy, Q, epsilon, safe, Reading.EXPECTATION
    ),
)
PER_ACTION = replace(
    LIBRARY,
    member=lambda policy, Q, epsilon, safe, _: _member(
        policy, Q, epsilon, safe, Reading.PER_ACTION
    ),
)


def _evaluation_is_best(
    model: SafeMDP, policy: Table, gamma: Discount, **convention: Any
) -> Tables:
    """Q* in place of Q^pi."""
    del policy
    return _best(model, gamma, **convention)


def _of_last_actions(model: SafeMDP, gamma: Discount, **convention: Any) -> Tables:
    """The critic of the policy that always takes the last available action."""
    last = model.num_actions - 1 - model.available[:, ::-1].argmax(axis=1)
    policy = np.where(model.available.any(axis=1), last, 0)
    return _of_policy(model, policy, gamma, **convention)


SWAPPED_CRITICS = replace(LIBRARY, best=_of_last_actions, of_policy=_evaluation_is_best)
EVALUATION_IS_BEST = replace(LIBRARY, of_policy=_evaluation_is_best)
GAMMA_HALF = replace(
    LIBRARY,
    best=lambda model, _, **convention: _best(model, 0.5, **convention),
    of_policy=lambda model, policy, _, **convention: _of_policy(model, policy, 0.5, **convention),
)


def _sure_labels(model: SafeMDP) -> Labelling:
    """Dead only if all paths fail (D_sure in place of D)."""
    labelling = classify(model)
    unsure = labelling.dead & (labelling.survival_time == INFINITE)
    labels = np.where(unsure, Label.AT_RISK, labelling.labels).astype(np.uint8)
    return replace(labelling, labels=labels)


def _zero_values(model: SafeMDP, gamma: Discount, **_: Any) -> Tables:
    """V = 0 off fail, where value iteration from below starts; Q from one step of it."""
    V = np.where(model.fail, ONE, ZERO)
    return V, np.where(model.available, ZERO, np.inf) * gamma


def _underestimated(model: SafeMDP, gamma: Discount, **convention: Any) -> Tables:
    """Two sweeps from below where the undiscounted value is asked for."""
    V, Q = _best(model, gamma, **convention)
    return (_swept(model, 2), Q) if gamma == 1 else (V, Q)


def _not_corrected(policy: Table, Q: Table, epsilon: Discount, recovery: Table) -> Table:
    """The task policy itself."""
    del Q, epsilon, recovery
    return policy


def _same_model(model: SafeMDP, Q: Table, epsilon: Discount, recovery: Table) -> SafeMDP:
    """The model itself."""
    del Q, epsilon, recovery
    return model


NOT_CORRECTED = replace(LIBRARY, correct=_not_corrected)
CORRECTED_MODEL_UNCHANGED = replace(LIBRARY, corrected=_same_model)
LABELS_SURE = replace(LIBRARY, labels=_sure_labels)
ZERO_VALUES = replace(LIBRARY, best=_zero_values)
UNDERESTIMATED = replace(LIBRARY, best=_underestimated)
CONVERGED = replace(
    LIBRARY, swept=lambda model, _: _best(model, Fraction(1), value=ValueConvention.COST_FAIL_1)[0]
)
NOTHING_EVER_ALLOWED = replace(
    LIBRARY,
    allowed=lambda Q, _: np.zeros(Q.shape, dtype=np.bool_),
)
GAMMA_ONE = replace(
    LIBRARY,
    best=lambda model, _, **convention: _best(
        model, Fraction(1), **({"value": ValueConvention.COST_FAIL_1} | convention)
    ),
)
DISCOUNTED_TWICE = replace(
    LIBRARY,
    best=lambda model, gamma, **convention: _best(model, gamma * gamma, **convention),
)
EXPECTILE_UPSIDE_DOWN = replace(
    LIBRARY,
    expectile=lambda model, data, tau, gamma: _expectile(model, data, 1 - tau, gamma),
)
EXPECTILE_FROM_BEST = replace(
    LIBRARY,
    expectile=lambda model, data, tau, gamma: _best(model, gamma),  # noqa: ARG005
)
BEST_IS_OF_LAST_ACTIONS = replace(LIBRARY, best=_of_last_actions)
BEST_IS_OF_FIRST_ACTIONS = replace(LIBRARY, best=_of_first_actions)
LITERAL = _convention(ValueConvention.COST_FAIL_0, CriticConvention.NEXT_VALUE)
LITERAL_CRITIC = _convention(critic=CriticConvention.NEXT_VALUE)
LOSS_TARGET = _convention(critic=CriticConvention.LOSS_TARGET)
FAIL_IS_ONE = _convention(value=ValueConvention.COST_FAIL_1)
COST_ON_ENTERING = _convention(value=ValueConvention.COST_FAIL_0)
DISCOUNTED_TIME = _convention(value=ValueConvention.TIME)
