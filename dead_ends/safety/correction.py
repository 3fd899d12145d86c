"""Behavior correction (behavior_correction in the paper) and the closed loop it makes.

    a = a_task    if Q(s, a_task) < epsilon_safe,
        a_rec     otherwise.

The corrected model is the task as the agent sees it behind the correction: an agent that
proposes a in s moves as the executed action does,

    next'(s, a) = next(s, a)  if a is allowed in s, else next(s, rec(s)),

and earns r(s, executed action). Everything in this package applies to it again.

With Q = Q*, rec greedy on Q* and 0 < epsilon_safe <= gamma_safe**H_b, no agent leaves S_safe
in a deterministic corrected model (Theorem 2; H_b is the boundary horizon). As a table, for a
runtime, that filter is :func:`safety_filter`. With the critic
of a task policy, Q^pi_task, and recovery greedy on it (RRL), it may: see tests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.io.environment_model import EnvironmentModel, key_text
from dead_ends.labels.classification import safe_actions
from dead_ends.model.checks import Names, read_only
from dead_ends.model.policy_table import as_distribution, check_actions
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.safety.critics import Unguarded, critic_table, require_critic
from dead_ends.safety.filter_table import FilterTable
from dead_ends.safety.policies import allowed_actions, checked_policy, recovery_policy
from dead_ends.values.bellman import value_iteration
from dead_ends.values.values import Values

__all__ = ["behavior_correction", "corrected_actions", "corrected_model", "safety_filter"]


def corrected_actions(
    allowed: NDArray[np.bool_], recovery: NDArray[Any], states: ArrayLike, proposed: ArrayLike
) -> NDArray[Any]:
    """The proposed actions where they are allowed, else the recovery policy's.

    Args:
        allowed: bool (S, A), the actions that pass.
        recovery: int (S,), what is executed instead of the others.
        states, proposed: ints that broadcast against each other.
    """
    states, proposed = np.asarray(states), np.asarray(proposed)
    return np.where(allowed[states, proposed], proposed, recovery[states])


def behavior_correction(
    policy: ArrayLike,
    Q: Values | Unguarded,
    epsilon_safe: float | Fraction,
    recovery: ArrayLike,
) -> NDArray[Any]:
    """The policy that is executed when a task policy's proposals are corrected.

    Args:
        policy: the task policy, int (S,) or float or Fraction (S, A).
        Q: the safety critic (S, A): Values, or :func:`dead_ends.unguarded` of a bare table.
        epsilon_safe: actions with Q(s, a) < epsilon_safe pass.
        recovery: the recovery policy, in either form; independent of the task policy's draw.

    Returns:
        int (S,) if both policies are; else (S, A), where the probability of the blocked
        actions has moved to the recovery policy's actions: Fractions unless a policy is of
        floats. Fail states have no actions: their
        rows follow the recovery policy like any blocked row.

    Raises:
        ValueError: as :func:`dead_ends.allowed_actions`; if shapes do not fit; if the
            recovery policy is needed and takes an action that is not available (Q = +inf).
    """
    require_critic(Q, "behavior_correction")
    allowed = allowed_actions(Q, epsilon_safe)
    table = critic_table(Q)
    task = checked_policy(policy, table)
    rec = checked_policy(recovery, table, "recovery")
    if task.ndim == 1 and rec.ndim == 1:
        states = np.arange(len(table))
        _check_recovery(~allowed[states, task], rec, table)
        return corrected_actions(allowed, rec, states, task)
    shares, rec_shares = (_shares(each, allowed.shape[1]) for each in (task, rec))
    passing = np.where(allowed, shares, 0)
    blocked = np.where(allowed, 0, shares).sum(axis=1, keepdims=True)
    _check_recovery(blocked[:, 0] > 0, rec_shares, table)
    executed = np.asarray(passing + blocked * rec_shares)
    rounded = "f" in (shares.dtype.kind, rec_shares.dtype.kind)
    return executed.astype(np.float64) if rounded else executed


def corrected_model(
    model: SafeMDP,
    Q: Values | Unguarded,
    epsilon_safe: float | Fraction,
    recovery: ArrayLike | None = None,
) -> SafeMDP:
    """The closed loop of behavior correction, as a model with the same actions.

    Args:
        model: the model.
        Q: the safety critic (S, A): Values, or :func:`dead_ends.unguarded` of a bare table.
        epsilon_safe: actions with Q(s, a) < epsilon_safe pass.
        recovery: int (S,), the action executed instead of a blocked one; None takes
            ``recovery_policy(Q)``.

    Returns:
        A model in which action a means "propose a". Actions that are not available in
        ``model`` cannot be proposed and stay unavailable. A deterministic model stays one,
        exact probabilities stay exact; rewards are those of the executed actions. Names,
        initial states, goals and geometry are kept.

    Raises:
        ValueError: as :func:`dead_ends.allowed_actions`; if shapes do not fit; if the
            recovery policy is needed in a state where its action is not available.
    """
    require_type(model, SafeMDP, "corrected_model")
    require_critic(Q, "corrected_model")
    allowed = allowed_actions(Q, epsilon_safe)
    if allowed.shape != (model.num_states, model.num_actions):
        raise ValueError(
            f"Q must have shape ({model.num_states}, {model.num_actions}), not {allowed.shape}"
        )
    names = Names(model.state_names, model.action_names, *allowed.shape)
    rec = check_actions("recovery", recovery_policy(Q) if recovery is None else recovery, names)
    states = np.arange(model.num_states)[:, None]
    passes = ~_corrected(model, allowed, rec)
    taken = corrected_actions(passes, rec, states, np.arange(model.num_actions))

    def executed(table: NDArray[Any]) -> NDArray[Any]:
        """table[s, executed action] for every proposed action."""
        return read_only(table[states, taken])

    rewards = None if model.rewards is None else executed(model.rewards)
    if model.next_state is not None:
        return replace(model, next_state=executed(model.next_state), rewards=rewards)
    from dead_ends.model.transition_matrix import select_rows

    assert model.kernel is not None
    rows = np.arange(allowed.size).reshape(allowed.shape)
    kernel, exact = select_rows(model.kernel, model.exact, executed(rows).ravel())
    return replace(model, kernel=kernel, exact=exact, rewards=rewards)


def safety_filter(
    model: SafeMDP,
    Q: Values | Unguarded | None = None,
    epsilon_safe: float | Fraction | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> FilterTable:
    """The filter of a model: the actions that pass, and what is executed instead of the others.

    Args:
        model: the model.
        Q: the safety critic (S, A): Values, or :func:`dead_ends.unguarded` of a bare table;
            None takes ``value_iteration(model)``.
        epsilon_safe: actions with Q(s, a) < epsilon_safe pass; None: exactly the actions that
            keep a safe state safe, decided from the graph.
        metadata: JSON values that say how the table is made.

    Returns:
        The table, with the model's names and, for the model of an environment, keys and seed.
        Its recovery policy takes an action that keeps the state safe where there is one, and is
        greedy on Q elsewhere.

    Raises:
        ValueError: as :func:`dead_ends.allowed_actions` and :func:`dead_ends.value_iteration`.
    """
    require_type(model, SafeMDP, "safety_filter")
    critic = value_iteration(model) if Q is None else Q
    require_critic(critic, "safety_filter")
    stays = safe_actions(model)
    allowed = stays if epsilon_safe is None else allowed_actions(critic, epsilon_safe)
    recovery = np.where(stays.any(axis=1), stays.argmax(axis=1), recovery_policy(critic))
    description = ({"estimate": True} if model.estimate else {}) | dict(metadata or {})
    keys = None
    if isinstance(model, EnvironmentModel):
        keys = tuple(key_text(key) for key in model.keys)
        origin = {"seed": model.seed, "table": model.table}
        description |= {name: value for name, value in origin.items() if value is not None}
    names = (model.state_names, model.action_names)
    return FilterTable(allowed, recovery, description, *names, keys)


def _corrected(
    model: SafeMDP, allowed: NDArray[np.bool_], rec: NDArray[np.integer[Any]]
) -> NDArray[np.bool_]:
    """bool (S, A): the proposals that are replaced by the recovery action, once it is available.

    None in terminal states, where the episode is over, nor where there is nothing to propose.
    """
    available = model.available
    corrected = available & ~allowed & ~model.terminal[:, None]
    needed = np.flatnonzero(corrected.any(axis=1))
    missing = needed[~available[needed, rec[needed]]]
    if len(missing):
        state = int(missing[0])
        raise ValueError(
            f"{model.state_name(state)}: the recovery policy takes "
            f"{model.action_name(int(rec[state]))}, which is not available there"
        )
    return corrected


def _shares(policy: NDArray[Any], num_actions: int) -> NDArray[Any]:
    """pi(a | s); of an integer policy as integers, so that Fractions beside it stay exact."""
    shares = as_distribution(policy, num_actions)
    return shares.astype(np.int64) if policy.ndim == 1 else shares


def _check_recovery(needed: NDArray[np.bool_], recovery: NDArray[Any], table: NDArray[Any]) -> None:
    """Where a recovery policy is needed and there is an action at all, it takes available ones."""
    unavailable = np.asarray(table == np.inf, dtype=np.bool_)
    taken = as_distribution(recovery, table.shape[1]) > 0
    needed = np.asarray(needed & ~unavailable.all(axis=1))
    bad = np.argwhere(needed[:, None] & taken & unavailable)
    if len(bad):
        state, action = bad[0]
        raise ValueError(
            f"recovery: state {state}, action {action} is not available there (Q = +inf)"
        )
