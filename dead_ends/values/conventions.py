"""The paper's conventions for a safety critic, as two named choices.

The paper uses three critics: Q = E V(s') (its definition of Q_c), the target
c + (1 - c) gamma V(s') of its loss, and Q = gamma V(s') (the proof of Theorem 2), with
V(fail) = 0 by the definition of V_c and V(fail) = 1 by Lemma 1. In a deterministic model
with survival time T, a state off fail that is lost has

    cost on entering:  V = gamma^(T - 1)          discounted time:  V = gamma^T.

The thresholds that separate safe from unsafe actions differ between the combinations; see
:func:`dead_ends.threshold_interval`. Everywhere the default is the target of the loss
on the cost on entering, the quantity on which the critic is trained: Q = gamma^T(s').
"""

from enum import StrEnum

__all__ = ["CriticConvention", "ValueConvention"]


class ValueConvention(StrEnum):
    """What V_c(s) means."""

    COST_FAIL_0 = "cost-fail-0"
    """E of the discounted cost of entering fail; V(fail) = 0 (the paper's definition)."""

    COST_FAIL_1 = "cost-fail-1"
    """The same off fail; V(fail) = 1 (Lemma 1, first bullet)."""

    TIME = "time"
    """E gamma^(time to fail); V(fail) = 1."""


class CriticConvention(StrEnum):
    """How Q_c(s, a) follows from V_c."""

    NEXT_VALUE = "next-value"
    """Q = E V(s') (the paper's definition of Q_c)."""

    LOSS_TARGET = "loss-target"
    """Q = E [c + (1 - c) gamma V(s')] (the target of the paper's loss)."""

    DISCOUNTED_NEXT_VALUE = "discounted-next-value"
    """Q = gamma E V(s') (the proof of Theorem 2)."""
