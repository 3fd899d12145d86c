"""The paper's statements, each a pure function that returns where the statement fails.

Every function takes arrays (masks of states, critics, allowed actions) and returns a bool mask
of states (S,) or of state-action pairs (S, A): True where the statement is violated, so that
``not mask.any()`` means that it holds, and the mask names the counterexample. Nothing is
solved here, and comparisons are as exact as the arrays: Fractions, integers, or the canonical
powers of a deterministic model.

Notation: ``fail``, ``dead``, ``safe`` are the masks of S_fail, S_dead, S_safe; ``allowed`` is
{Q < epsilon_safe}; ``greedy`` are all minimisers of the recovery policy's critic.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.discount import compare_power

Mask = NDArray[np.bool_]
Table = NDArray[Any]
"""Floats, or Fractions as objects."""


def leaves(model: SafeMDP, region: Mask) -> Mask:
    """bool (S, A): available actions of the region that may lead out of it."""
    inside = region[:, None] & model.available
    if model.is_deterministic:
        return np.asarray(inside & ~region[model.successors()])
    # Only stored probabilities are positive, and sums of positive numbers do not vanish.
    outside = np.asarray(model.transitions() @ (~region).astype(np.float64))
    return np.asarray(inside & (outside > 0).reshape(inside.shape))


def definition_2(model: SafeMDP, dead: Mask, safe: Mask) -> Mask:
    """(S,) Definition 2 and its consequence, Equation eq_ssafe.

    No action of a dead state leads to a safe one; some action of every safe state has, with
    P(s, a, s') > 0, a safe successor.
    """
    leads_to_safe = model.available & ~_surely_in(model, ~safe)
    return np.asarray((dead & leads_to_safe.any(axis=1)) | (safe & ~leads_to_safe.any(axis=1)))


def _surely_in(model: SafeMDP, region: Mask) -> Mask:
    """bool (S, A): all successors of an action lie in the region."""
    if model.is_deterministic:
        return np.asarray(model.available & region[model.successors()])
    outside = np.asarray(model.transitions() @ (~region).astype(np.float64))
    return np.asarray(model.available & (outside == 0).reshape(model.available.shape))


def assumption_1(model: SafeMDP, dead: Mask, survival_time: NDArray[np.integer[Any]]) -> Mask:
    """(S, A) Assumption 1: every trajectory from a dead state ends within T(s) steps.

    A certificate: each transition of a dead state lowers T, which is 0 only on fail states,
    so no trajectory is longer than T(s) <= H.
    """
    time = survival_time.astype(np.int64)
    if model.is_deterministic:
        latest = time[model.successors()]
    else:
        kernel = model.transitions()
        rows = np.repeat(np.arange(kernel.shape[0]), np.diff(kernel.indptr))
        flat = np.zeros(kernel.shape[0], dtype=np.int64)
        np.maximum.at(flat, rows, time[kernel.indices])
        latest = flat.reshape(model.available.shape)
    lowers = (latest < time[:, None]) & (time[:, None] > 0)
    return np.asarray(dead[:, None] & model.available & ~lowers)


def lemma_1_fail(V: Table, fail: Mask) -> Mask:
    """(S,) Lemma 1, first bullet: V(s) = 1 on fail states."""
    return np.asarray(fail & (V != 1), dtype=np.bool_)


def lemma_1_dead(V_policy: Table, V_best: Table, dead: Mask, bound: Any) -> Mask:
    """(S,) Lemma 1, second bullet: V^pi(s) >= V*(s) >= gamma^(H - 1) (``bound``) if dead."""
    return np.asarray(dead & ~((V_policy >= V_best) & (V_best >= bound)), dtype=np.bool_)


def lemma_1_safe(V_policy: Table, V_best: Table, safe: Mask) -> Mask:
    """(S,) Lemma 1, third bullet: V^pi(s) >= V*(s) = 0 on safe states."""
    return np.asarray(safe & ~((V_policy >= V_best) & (V_best == 0)), dtype=np.bool_)


def positive_exactly(V_best: Table, lost: Mask) -> Mask:
    """(S,) V* > 0 exactly on the lost states, the boundary of the paper's first figure."""
    return np.asarray((V_best > 0) != lost, dtype=np.bool_)


def bellman_equation(V_best: Table, Q_best: Table, fail: Mask) -> Mask:
    """(S,) The optimal Bellman equation for safety, V*(s) = min_a Q*(s, a), off fail."""
    return np.asarray(~fail & (V_best != Q_best.min(axis=1)), dtype=np.bool_)


def allowed_inclusion(smaller: Mask, larger: Mask, safe: Mask) -> Mask:
    """(S, A) Theorem 1: what one critic allows in a safe state, the other allows too.

    Read per action, a policy set is the product of the allowed actions over S_safe; this
    inclusion is equivalent to that of the sets unless the first is empty.
    """
    return np.asarray(safe[:, None] & smaller & ~larger)


def unsafe_allowed(model: SafeMDP, safe: Mask, allowed: Mask) -> Mask:
    """(S, A) Theorem 2, task branch: no allowed action of a safe state leads out of S_safe."""
    return leaves(model, safe) & allowed


def unsafe_minimisers(model: SafeMDP, safe: Mask, greedy: Mask) -> Mask:
    """(S, A) Theorem 2, recovery branch: no minimiser in a safe state leads out of S_safe."""
    return leaves(model, safe) & greedy


def boundary_exact(model: SafeMDP, safe: Mask, allowed: Mask) -> Mask:
    """(S, A) Optimal boundary: in safe states, allowed exactly if it stays in S_safe."""
    stays = safe[:, None] & model.available & ~leaves(model, safe)
    return np.asarray(stays != (safe[:, None] & model.available & allowed))


def executed_actions(proposed: Mask, allowed: Mask, greedy: Mask) -> Mask:
    """bool (S, A): what behavior correction may execute, Equation behavior_correction.

    A proposed action if it is allowed; any minimiser where a proposed action is blocked.
    """
    blocked = (proposed & ~allowed).any(axis=1, keepdims=True)
    return np.asarray((proposed & allowed) | (blocked & greedy))


def corrected_loop(model: SafeMDP, safe: Mask, proposed: Mask, allowed: Mask, greedy: Mask) -> Mask:
    """(S, A) Theorem 2: from safe states the corrected agent never leaves S_safe.

    By induction it is enough that no executed action of a safe state does.
    """
    return leaves(model, safe) & executed_actions(proposed, allowed, greedy)


def policy_stays(model: SafeMDP, safe: Mask, support: Mask) -> Mask:
    """(S,) A policy (its support, (S, A)) that never leaves S_safe from any safe state."""
    return np.asarray((leaves(model, safe) & support).any(axis=1))


def time_bound(V_time: Table, expected_time: Table, gamma: Fraction, dead: Mask) -> Mask:
    """(S,) Stochastic, on dead states: V(s) = min E gamma^T >= gamma^(E_max[T]) (Jensen)."""
    bad = np.zeros(dead.shape, dtype=np.bool_)
    for state in np.flatnonzero(dead):
        bad[state] = below_power(V_time[state], gamma, Fraction(expected_time[state]))
    return bad


def one_step_bound(
    entering: Table, Q_time: Table, gamma: Fraction, expected_horizon: Fraction, at: Mask
) -> Mask:
    """(S, A) Stochastic: P(enter S_dead or S_fail | s, a) <= Q*(s, a) / gamma^H_E.

    ``entering`` is that probability, Q* = E V(s') with V = min E gamma^T, and H_E the greatest
    E_max[T] over the dead states. Looked at where ``at`` is True.
    """
    bad = np.zeros(at.shape, dtype=np.bool_)
    for place in zip(*np.nonzero(at), strict=True):
        if entering[place]:
            share = Fraction(Q_time[place]) / entering[place]
            bad[place] = below_power(share, gamma, expected_horizon)
    return bad


def below_power(value: Fraction, gamma: Fraction, exponent: Fraction) -> bool:
    """value < gamma^exponent, decided exactly."""
    return compare_power(value, gamma, exponent) < 0


def survival_bound(alive: Table, X: Table, epsilon: Fraction, steps: int) -> Mask:
    """(S,) Stochastic: P(no failure in N steps) >= (1 - X(s)) (1 - epsilon)^N."""
    return np.asarray(alive < (1 - X) * (1 - epsilon) ** steps, dtype=np.bool_)
