"""The paper's methods on a finite model, and how much each takes away.

Each method is a safety critic and a recovery policy greedy on it (obj_rec_p):

    RRL          Q^pi_task, the critic of a task policy          (obj_safe_critic, pi = pi_task)
    RRL (MSDP)   the target c + (1 - c) gamma min_a' Q(s', a')   (multi-step dynamic programming)
    DEA-RRL      Q^pi_rec, where pi_rec is greedy on it          (evaluate and improve in turn)
    DEA-RRL as it is trained: V is an expectile of Q over the data's actions   (v_loss, q_loss)

RRL (MSDP) and DEA-RRL arrive at the same critic Q* by value iteration and by policy iteration;
the expectile form lies above it, Q_tau >= Q*, and reaches it as the expectile goes to 0 where
the data holds every action.

Conservatism is what a gate Q(s, a) < epsilon_safe blocks although it is safe. Its counterpart,
the unsafe actions that the gate lets through, is counted too.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.checks import plain_array, read_only
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.safety.critics import Unguarded, require_critic
from dead_ends.safety.policies import allowed_actions, recovery_policy
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.expectile import expectile_iteration
from dead_ends.values.values import Values

__all__ = [
    "Conservatism",
    "Method",
    "conservatism",
    "dea_rrl",
    "dea_rrl_expectile",
    "rrl",
    "rrl_msdp",
]


@dataclass(frozen=True, eq=False)
class Method:
    """A safety critic with the recovery policy that goes with it.

    Attributes:
        name: as in the paper.
        critic: the values whose Q gates the task policy.
        recovery: int (S,), greedy on ``critic.Q``.
    """

    name: str
    critic: Values
    recovery: NDArray[np.int64]


@dataclass(frozen=True)
class Conservatism:
    """What a gate blocks and lets through, counted where the agent acts.

    Counted are the safe states that are not terminal (in stochastic models: those with
    P_min(F fail) = 0) and their available actions. An action is safe if all its successors
    are.

    Attributes:
        safe_states: how many such states there are.
        blocked_safe_states: those in which every safe action is blocked.
        safe_actions: how many safe actions they have together.
        blocked_safe_actions: those that are blocked.
        unsafe_actions: how many unsafe actions they have together.
        missed_unsafe_actions: those that the gate lets through.
    """

    safe_states: int
    blocked_safe_states: int
    safe_actions: int
    blocked_safe_actions: int
    unsafe_actions: int
    missed_unsafe_actions: int

    @property
    def blocked_safe_states_share(self) -> float:
        """The share of the safe states without an allowed safe action; 0 if there are none."""
        return _share(self.blocked_safe_states, self.safe_states)

    @property
    def blocked_safe_actions_share(self) -> float:
        """The share of the safe actions that are blocked; 0 if there are none."""
        return _share(self.blocked_safe_actions, self.safe_actions)

    @property
    def missed_unsafe_actions_share(self) -> float:
        """The share of the unsafe actions that are let through; 0 if there are none."""
        return _share(self.missed_unsafe_actions, self.unsafe_actions)


def rrl(model: SafeMDP, task_policy: ArrayLike, gamma_safe: float | Fraction = 0.99) -> Method:
    """Recovery RL: the critic of the task policy, and recovery by one greedy step on it.

    Args:
        model: the model.
        task_policy: int (S,), or (S, A) of floats or Fractions.
        gamma_safe: the discount of the cost; a Fraction makes the critic exact.

    Raises:
        ValueError: as :func:`dead_ends.evaluate_policy`.
    """
    require_type(model, SafeMDP, "rrl")
    return _method("RRL", evaluate_policy(model, task_policy, gamma_safe))


def rrl_msdp(model: SafeMDP, gamma_safe: float | Fraction = 0.99) -> Method:
    """RRL (MSDP): the critic bootstraps on the least Q of the next state.

    Raises:
        ValueError: as :func:`dead_ends.value_iteration`.
    """
    require_type(model, SafeMDP, "rrl_msdp")
    return _method("RRL (MSDP)", value_iteration(model, gamma_safe))


def dea_rrl(
    model: SafeMDP,
    gamma_safe: float | Fraction = 0.99,
    start: ArrayLike | None = None,
) -> Method:
    """DEA-RRL: evaluate the recovery policy, make it greedy on its critic, and so on.

    Policy iteration. From every start it ends at Q*: exactly with Fractions, and on
    deterministic models as long as gamma_safe**T does not underflow (T up to 70,000 at 0.99);
    else the policy stays when no action is better for certain, given the critic's bounds.

    Args:
        model: the model.
        gamma_safe: the discount of the cost, below 1: undiscounted the iteration can stall
            at a policy that need not fail but does. A Fraction makes the critic exact.
        start: int (S,), the recovery policy to start from; None takes the first available
            action everywhere.

    Raises:
        ValueError: as :func:`dead_ends.evaluate_policy`; if gamma_safe is 1.
    """
    require_type(model, SafeMDP, "dea_rrl")
    if gamma_safe == 1:
        raise ValueError(
            "dea_rrl: at gamma_safe = 1 evaluating and improving in turn can stall; "
            "value_iteration solves that case"
        )
    policy = model.available.argmax(axis=1) if start is None else plain_array("start", start)
    while True:
        critic = evaluate_policy(model, policy, gamma_safe)
        improved = _improve(critic, policy)
        if np.array_equal(improved, policy):
            return _method("DEA-RRL", critic)
        policy = improved


def dea_rrl_expectile(
    model: SafeMDP,
    data_policy: ArrayLike,
    expectile: float | Fraction,
    gamma_safe: float | Fraction = 0.99,
) -> Method:
    """DEA-RRL as the paper trains it: V is an expectile of Q over the data's actions.

    Args:
        model: the model.
        data_policy: int (S,) or (S, A), the policy that collected the data.
        expectile: the tau of the paper's v_loss, in [0, 1); towards 0 the safer side.
        gamma_safe: the discount of the cost; a Fraction makes the critic exact.

    Raises:
        ValueError: as :func:`dead_ends.values.expectile.expectile_iteration`.
    """
    require_type(model, SafeMDP, "dea_rrl_expectile")
    critic = expectile_iteration(model, data_policy, expectile, gamma_safe)
    return _method(f"DEA-RRL (expectile {expectile})", critic)


def conservatism(
    model: SafeMDP, Q: Values | Unguarded, epsilon_safe: float | Fraction
) -> Conservatism:
    """How much of what is safe a gate Q(s, a) < epsilon_safe blocks.

    Args:
        model: the model.
        Q: the safety critic (S, A): Values, or :func:`dead_ends.unguarded` of a bare table.
        epsilon_safe: the threshold.

    Raises:
        ValueError: as :func:`dead_ends.allowed_actions`; if the shapes do not fit.
    """
    require_type(model, SafeMDP, "conservatism")
    require_critic(Q, "conservatism")
    allowed = allowed_actions(Q, epsilon_safe)
    if allowed.shape != (model.num_states, model.num_actions):
        raise ValueError(
            f"Q must have shape ({model.num_states}, {model.num_actions}), not {allowed.shape}"
        )
    labelling = classify(model)
    acting = labelling.safe & ~model.terminal
    safe = safe_actions(model, labelling)[acting]
    unsafe = model.available[acting] & ~safe
    passed = allowed[acting]
    return Conservatism(
        safe_states=len(safe),
        blocked_safe_states=int(np.count_nonzero(~(safe & passed).any(axis=1))),
        safe_actions=int(np.count_nonzero(safe)),
        blocked_safe_actions=int(np.count_nonzero(safe & ~passed)),
        unsafe_actions=int(np.count_nonzero(unsafe)),
        missed_unsafe_actions=int(np.count_nonzero(unsafe & passed)),
    )


def _method(name: str, critic: Values) -> Method:
    return Method(name, critic, read_only(recovery_policy(critic)))


def _improve(critic: Values, policy: NDArray[Any]) -> NDArray[Any]:
    """The greedy policy; an action is kept unless another is better for certain."""
    certain = critic.model.is_deterministic  # powers of gamma, ordered as their exponents
    lower, upper = (critic.Q, critic.Q) if certain else (critic.Q_lower, critic.Q_upper)
    decides = ~(critic.model.fail | critic.model.terminal)
    kept = lower[np.arange(len(policy)), np.where(decides, policy, 0)]
    better = decides & np.asarray(upper.min(axis=1) < kept, dtype=np.bool_)
    return np.where(better, upper.argmin(axis=1), policy)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
