"""Which statements of the paper hold on a given model, and the numbers behind them.

Deterministic models are judged on integers and canonical powers, so the answer is exact for
any size. Stochastic models are solved in Fractions if they are small or gamma_safe is a
Fraction, else in floats within bounds; what the bounds leave open is reported as undecided.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.labels.classification import classify
from dead_ends.labels.labelling import INFINITE, Labelling
from dead_ends.model.policy_table import as_distribution, check_policy
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.paper import predicates
from dead_ends.paper.predicates import Mask
from dead_ends.safety.policies import allowed_actions, greedy_actions, recovery_policy
from dead_ends.safety.thresholds import ThresholdInterval, threshold_interval
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.discount import power, scientific
from dead_ends.values.precision import UndecidedError
from dead_ends.values.values import Values

__all__ = ["Statement", "Verification", "verify_statements"]

EXACT_PAIRS = 2_000
"""Stochastic models with at most so many state-action pairs are solved in Fractions."""


@dataclass(frozen=True)
class Statement:
    """One statement on one model.

    Attributes:
        place: where the paper says it.
        claim: the statement.
        holds: None if it is undecided (the detail says why).
        detail: the numbers, and the first place where it fails.
    """

    place: str
    claim: str
    holds: bool | None
    detail: str = ""


@dataclass(frozen=True, eq=False)
class Verification:
    """All statements that apply to a model.

    Attributes:
        statements: in the paper's order.
        labelling: labels, survival times, H and H_b.
        interval: the thresholds with which the gate on Q* is exact.
        epsilon_safe: the threshold that was used.
        gamma_safe: the discount of the cost.
    """

    statements: tuple[Statement, ...]
    labelling: Labelling
    interval: ThresholdInterval
    epsilon_safe: float | Fraction
    gamma_safe: float | Fraction


@dataclass(frozen=True, eq=False)
class _Subject:
    """A model, solved: what every statement looks at.

    ``region`` are the states from which the agent is to be kept safe: S_safe if the model is
    deterministic, Z = {P_min = 0} if not.
    """

    model: SafeMDP
    labelling: Labelling
    best: Values
    own: Values
    task: Mask
    region: Mask
    epsilon: float | Fraction

    def where(self, violated: Mask) -> str:
        """The first place of a mask (S,) or (S, A), and how many there are."""
        places = np.argwhere(violated)
        if not len(places):
            return ""
        state, *action = (int(index) for index in places[0])
        name = self.model.state_name(state)
        if action:
            name += f", {self.model.action_name(action[0])}"
        return name if len(places) == 1 else f"{name} and {len(places) - 1:,} more"

    def judged(self, place: str, claim: str, violated: Mask, detail: str = "") -> Statement:
        """A statement from the places where it fails."""
        failing = self.where(violated)
        parts = [detail, f"fails at {failing}" if failing else ""]
        return Statement(place, claim, not failing, "; ".join(part for part in parts if part))


def verify_statements(
    model: SafeMDP,
    gamma_safe: float | Fraction = 0.99,
    epsilon_safe: float | Fraction | None = None,
    policy: ArrayLike | None = None,
) -> Verification:
    """Check every statement of the paper that applies to a model.

    Args:
        model: the model.
        gamma_safe: the discount of the cost.
        epsilon_safe: the threshold; None takes the recommended one (1/2 if none is right, and
            the greatest exact one if no float is).
        policy: the task policy of RRL, int (S,) or probabilities (S, A); None takes the first
            available action in every state.

    Returns:
        The statements, with what was computed on the way.

    Raises:
        ValueError: for a discount outside (0, 1], a policy that is none of this model, an
            epsilon_safe that is not positive, or if no float is a threshold and the discount is
            no Fraction.
    """
    require_type(model, SafeMDP, "verify_statements")
    if epsilon_safe is not None and not epsilon_safe > 0:
        raise ValueError(f"epsilon_safe must be positive, not {epsilon_safe}")
    exact = None if model.is_deterministic or model.available.size > EXACT_PAIRS else True
    labelling = classify(model)
    interval = threshold_interval(model, gamma_safe, exact=exact)
    task = model.available.argmax(axis=1) if policy is None else check_policy(model, policy)
    subject = _Subject(
        model=model,
        labelling=labelling,
        best=value_iteration(model, gamma_safe, exact=exact),
        own=evaluate_policy(model, task, gamma_safe, exact=exact),
        task=np.asarray(as_distribution(task, model.num_actions) > 0) & model.available,
        region=labelling.safe,
        epsilon=_threshold(interval) if epsilon_safe is None else epsilon_safe,
    )
    chapters = [_definitions, _values, _policy_sets, _correction]
    statements = [statement for chapter in chapters for statement in chapter(subject)]
    return Verification(
        tuple(statements), labelling, interval, subject.epsilon, subject.best.gamma_safe
    )


def _threshold(interval: ThresholdInterval) -> float | Fraction:
    """The recommended threshold; the greatest one where it is a Fraction that no float is below."""
    if interval.empty:
        return 0.5
    if interval.upper is None:
        raise UndecidedError(
            f"the thresholds are {interval}", {"exact": "give gamma_safe as a Fraction"}
        )
    return interval.recommended or interval.upper


def _definitions(subject: _Subject) -> list[Statement]:
    """Definition 2 and Assumption 1."""
    model, labelling = subject.model, subject.labelling
    partition = predicates.definition_2(model, labelling.dead, labelling.paper_safe)
    time = labelling.survival_time
    unbounded = labelling.dead & (time == INFINITE)
    longer = predicates.assumption_1(model, labelling.dead & ~unbounded, time).any(axis=1)
    detail = "" if labelling.horizon is None else f"H = {labelling.horizon}"
    return [
        subject.judged(
            "Definition 2, Eq. eq_ssafe",
            "every safe state has a transition to S_safe, no dead state has one",
            partition,
        ),
        subject.judged(
            "Assumption 1",
            "failure comes at most H steps after entering S_dead",
            unbounded | longer,
            detail,
        ),
    ]


def _values(subject: _Subject) -> list[Statement]:
    """Lemma 1, and the remark about gamma_safe = 1."""
    model, labelling = subject.model, subject.labelling
    best, own = subject.best, subject.own
    certain = np.asarray(own.V_upper < best.V_lower, dtype=np.bool_)
    positive = np.asarray(best.V_lower > 0, dtype=np.bool_)
    entered = predicates.leaves(model, ~model.fail)
    statements = [
        subject.judged(
            "Lemma 1, first bullet",
            "V_c = 1 on S_fail, by the definition of V_c (no cost follows the end: V_c = 0)",
            predicates.lemma_1_fail(best.V, model.fail),
            "harmless for Q = c + (1 - c) gamma V(s')",
        ),
        subject.judged(
            "Lemma 1, third bullet",
            "V_c^pi >= V_c* = 0 on S_safe",
            labelling.paper_safe & (certain | positive),
        ),
        subject.judged(
            "Remark after Definition 1",
            "at gamma_safe = 1, Q_c = E V_c(s') is the probability of failing",
            entered,
            "with the target of the loss it is",
        ),
    ]
    if labelling.horizon:
        bound = power(best.gamma_safe, labelling.horizon - 1)
        below = np.asarray(best.V_upper < bound, dtype=np.bool_)
        statements.insert(
            1,
            subject.judged(
                "Lemma 1, second bullet",
                "V_c^pi >= V_c* >= gamma_safe^(H-1) on S_dead",
                labelling.dead & (certain | below),
                f"gamma_safe^(H-1) is about {scientific(best.gamma_safe, labelling.horizon - 1)}",
            ),
        )
    if not model.is_deterministic and labelling.paper_safe.any() and labelling.dead.any():
        statements.append(_separation(subject))
    return statements


def _separation(subject: _Subject) -> Statement:
    """Whether a threshold on V* tells S_safe from S_dead."""
    V, labelling = subject.best.V, subject.labelling
    highest, lowest = V[labelling.paper_safe].max(), V[labelling.dead].min()
    return Statement(
        "Lemma 1 and Theorem 2",
        "a threshold on V_c* separates S_safe from S_dead",
        bool(highest < lowest),
        f"V_c* is at most {float(highest):.6g} on S_safe, at least {float(lowest):.6g} on S_dead",
    )


def _policy_sets(subject: _Subject) -> list[Statement]:
    """The Preliminary's set of policies, and Theorem 1."""
    labelling = subject.labelling
    safe = labelling.paper_safe
    statements = [
        subject.judged(
            "Preliminary",
            "some policy has V_c < epsilon_safe on all of S, for some epsilon_safe <= 1",
            labelling.dead & np.asarray(subject.best.V_lower >= 1, dtype=np.bool_),
        )
    ]
    place, claim = "Theorem 1", "Q^pi_task allows no action of S_safe that Q* blocks"
    try:
        own, best = _gate(subject, subject.own), _gate(subject, subject.best)
    except ValueError as error:
        return [*statements, Statement(place, claim, None, str(error))]
    gained = np.count_nonzero(safe[:, None] & best & ~own)
    detail = f"Q* allows {gained:,} more"
    for name, mask in (("Q^pi_task", own), ("Q*", best)):
        blocked = safe & ~mask.any(axis=1)
        if blocked.any():
            detail += f"; the set of {name} is empty: no action is allowed in "
            detail += subject.where(blocked)
    return [
        *statements,
        subject.judged(place, claim, predicates.allowed_inclusion(own, best, safe), detail),
    ]


def _gate(subject: _Subject, values: Values) -> Mask:
    return allowed_actions(values, subject.epsilon)


def _correction(subject: _Subject) -> list[Statement]:
    """Theorem 2, exactness, and the claim about RRL."""
    region = "S_safe" if subject.model.is_deterministic else "{P_min = 0}"
    checks = [
        (
            "Theorem 2",
            f"from {region}, behavior correction with Q* never leaves it, whatever is proposed",
            partial(_closed_loop, subject, subject.best, subject.model.available),
        ),
        (
            "Abstract, Figure 1",
            f"in {region}, the gate on Q* allows exactly what stays there",
            partial(_boundary, subject),
        ),
        (
            "After Theorem 2",
            f"from {region}, RRL (gate and recovery from Q^pi_task) never leaves it",
            partial(_closed_loop, subject, subject.own, subject.task),
        ),
    ]
    statements = []
    for place, claim, check in checks:
        try:
            statements.append(subject.judged(place, claim, check()))
        except ValueError as error:
            statements.append(Statement(place, claim, None, str(error)))
    if not subject.model.is_deterministic:
        statements.append(_hope(subject))
    return statements


def _closed_loop(subject: _Subject, values: Values, proposed: Mask) -> Mask:
    return predicates.corrected_loop(
        subject.model, subject.region, proposed, _gate(subject, values), greedy_actions(values)
    )


def _boundary(subject: _Subject) -> Mask:
    return predicates.boundary_exact(subject.model, subject.region, _gate(subject, subject.best))


def _hope(subject: _Subject) -> Statement:
    """Whether the recovery policy makes failure certain where it need not be."""
    recovery: NDArray[np.int64] = recovery_policy(subject.best)
    risk = evaluate_policy(subject.model, recovery, 1.0, exact=subject.best.exact)
    return subject.judged(
        "Recovery objective",
        "the recovery policy greedy on Q* makes failure certain only on S_dead",
        subject.labelling.paper_safe & np.asarray(risk.V_lower == 1, dtype=np.bool_),
    )
