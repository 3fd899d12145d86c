"""The discount and the threshold that follow from a horizon H, the only number used.

A dead-end has Q_c* >= gamma_safe^H, a safe action Q_c* = 0. The exact critic separates
them at any epsilon in (0, gamma_safe^H]. A learned one is wrong by some delta everywhere:
its gate is right if delta < epsilon <= gamma_safe^H - delta, and a Bellman residual r
gives delta <= r / (1 - gamma_safe).
"""

from __future__ import annotations

__all__ = ["discount_from_horizon", "low_threshold", "paper_threshold"]

LOW_SHARE = 0.25


def _check(horizon: int) -> None:
    if horizon < 0:
        raise ValueError(f"horizon must not be negative, not {horizon}")


def discount_from_horizon(horizon: int) -> float:
    """H / (H + 1), where (1 - g) g^H, the residual that can be afforded, is greatest.

    At least 1/2, so that H = 0 leaves a discount.
    """
    _check(horizon)
    return max(horizon, 1) / (max(horizon, 1) + 1)


def paper_threshold(gamma_safe: float, horizon: int) -> float:
    """gamma_safe^(H + 1/2): the paper's gamma_safe^H, moved between two powers.

    At gamma_safe^H itself rounding decides; the two are the same for an exact critic.
    """
    _check(horizon)
    return float(gamma_safe ** (horizon + 0.5))


def low_threshold(gamma_safe: float, horizon: int) -> float:
    """gamma_safe^H / 4: nearer to the safe side's 0 than to the dead side's gamma_safe^H.

    A smooth critic takes every value in between across the boundary; calling a safe state
    dead costs some freedom, calling a dead state safe costs a crash.
    """
    _check(horizon)
    return float(LOW_SHARE * gamma_safe**horizon)
