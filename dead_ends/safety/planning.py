"""The best return of the task, under the constraints that the paper compares.

    J(pi) = E sum_t gamma^t r(s_t, a_t)                                  (object_function)
    max J(pi)  subject to  pi in Pi_c,                                   (obj_smdps)

where r(s, a) is earned by acting in a state that is neither fail nor terminal: entering one
ends the episode. Pi_c restricts the actions in the states of the paper's S_safe (neither fail
nor dead); it is empty if one of those has no allowed action. gamma is the reward's discount,
gamma_safe the critic's.

Values come from sweeps of value iteration, broken after 1, 2, 4, 8 ... of them by an exact
evaluation of the greedy policy (policy iteration), which saves the sweeps that a discount
near 1 would need. However V was found, with T the Bellman operator,

    |V - V*| <= max |T V - V| / (1 - gamma),

and this, with the rounding of T itself, is the error bound that is returned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.labels.classification import classify
from dead_ends.model.checks import plain_array, read_only
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.safety.correction import corrected_model
from dead_ends.safety.policies import allowed_actions
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.values import Values

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["PlanResult", "PriceOfConservatism", "plan", "price_of_conservatism"]

EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class PlanResult:
    """The best return within a set of policies.

    Attributes:
        J: the best expected return from ``model.initial``; -inf if the set is empty.
        values: float (S,), the best return from each state; -inf if the set is empty.
        policy: int (S,), a best policy (0 where the episode has ended); -1 everywhere if the
            set is empty.
        feasible: whether the set contains a policy.
        blocked_states: the number of states of S_safe without an allowed action; the set is
            empty if there is one.
        error_bound: ``values``, and J, are this close to the true optimum; 0 if infeasible.
    """

    J: float
    values: NDArray[np.float64]
    policy: NDArray[np.int64]
    feasible: bool
    blocked_states: int
    error_bound: float


@dataclass(frozen=True, eq=False)
class PriceOfConservatism:
    """The best return under each constraint of the paper, the price being the difference.

    unconstrained >= recovery_set >= task_set (Theorem 1). For 0 < epsilon_safe <=
    gamma_safe**H_b in a deterministic model that starts in safe states, the corrected loop
    attains the best of its set unless that is empty: it leaves the agent all allowed actions,
    and recovers by one of them.

    Attributes:
        unconstrained: no constraint; violations cost nothing but the rest of the episode.
        recovery_set: within Pi_c of Q*, the critic of the best recovery policy (DEA-RRL).
        task_set: within Pi_c of Q^pi_task, the critic of the fixed task policy (RRL).
        dea_rrl: in the loop corrected with Q* and a recovery policy greedy on it.
        rrl: in the loop corrected with Q^pi_task and a recovery policy greedy on it; such a
            loop may fail.
    """

    unconstrained: PlanResult
    recovery_set: PlanResult
    task_set: PlanResult
    dea_rrl: PlanResult
    rrl: PlanResult


def plan(
    model: SafeMDP, allowed: NDArray[np.bool_] | None = None, gamma: float | Fraction = 0.99
) -> PlanResult:
    """The best return over the policies that take only allowed actions in S_safe.

    Args:
        model: a model with rewards and initial states.
        allowed: bool (S, A), such as ``allowed_actions(Q, epsilon_safe)``; None allows all.
            It binds in the states that are neither fail, dead nor terminal.
        gamma: the discount of the reward, strictly between 0 and 1.

    Raises:
        ValueError: if the model has no rewards or no initial states, if ``allowed`` has the
            wrong shape or type, or if gamma is not between 0 and 1.
    """
    require_type(model, SafeMDP, "plan")
    discount = _checked_discount(gamma)
    if model.rewards is None or model.initial is None:
        missing = "rewards" if model.rewards is None else "initial states"
        raise ValueError(f"planning needs a model with {missing}")
    acting = ~(model.fail | model.terminal)
    choices = model.available & acting[:, None]
    if allowed is not None:
        bound = acting & classify(model).paper_safe
        choices &= _checked_mask(allowed, model) | ~bound[:, None]
    blocked = int(np.count_nonzero(acting & ~choices.any(axis=1)))
    if blocked:
        return _infeasible(model.num_states, blocked)
    bellman = _Bellman(model.transitions(), model.rewards, choices, acting, discount)
    values, policy = _solve(bellman)
    bound_on_error = bellman.error_bound(values)
    J = math.fsum(model.initial * values)
    return PlanResult(J, read_only(values), read_only(policy), True, 0, bound_on_error)


def price_of_conservatism(
    model: SafeMDP,
    task_policy: ArrayLike,
    gamma_safe: float | Fraction,
    epsilon_safe: float | Fraction,
    gamma: float | Fraction = 0.99,
) -> PriceOfConservatism:
    """What each safety critic leaves of the best return: the paper's objectives, compared.

    Args:
        model: a model with rewards and initial states.
        task_policy: int (S,) or (S, A), the fixed policy whose critic RRL uses.
        gamma_safe, epsilon_safe: the critic's discount and the threshold. A Fraction
            gamma_safe makes the critics exact.
        gamma: the discount of the reward, strictly between 0 and 1.

    Raises:
        ValueError: as :func:`plan`, :func:`dead_ends.evaluate_policy` and
            :func:`dead_ends.allowed_actions`.
    """
    require_type(model, SafeMDP, "price_of_conservatism")
    unconstrained = plan(model, None, gamma)
    best = value_iteration(model, gamma_safe)
    task = evaluate_policy(model, task_policy, gamma_safe)
    return PriceOfConservatism(
        unconstrained=unconstrained,
        recovery_set=plan(model, allowed_actions(best, epsilon_safe), gamma),
        task_set=plan(model, allowed_actions(task, epsilon_safe), gamma),
        dea_rrl=_corrected_return(model, best, epsilon_safe, gamma),
        rrl=_corrected_return(model, task, epsilon_safe, gamma),
    )


def _corrected_return(
    model: SafeMDP, critic: Values, epsilon_safe: float | Fraction, gamma: float | Fraction
) -> PlanResult:
    return plan(corrected_model(model, critic, epsilon_safe), None, gamma)


@dataclass(frozen=True, eq=False)
class _Bellman:
    """The Bellman operator T of the restricted task; V is 0 where the episode has ended."""

    kernel: csr_array[np.float64]
    rewards: NDArray[np.float64]
    choices: NDArray[np.bool_]
    acting: NDArray[np.bool_]
    gamma: float

    def action_values(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """r(s, a) + gamma E V(s'); -inf for actions that must not be taken."""
        after = (self.kernel @ values).reshape(self.rewards.shape)
        return np.where(self.choices, self.rewards + self.gamma * after, -np.inf)

    def sweep(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """T V."""
        return np.where(self.acting, self.action_values(values).max(axis=1), 0.0)

    def improve(self, values: NDArray[np.float64], policy: NDArray[np.int64]) -> NDArray[np.int64]:
        """The greedy policy; an action is kept unless another is better beyond rounding."""
        action_values = self.action_values(values)
        kept = np.take_along_axis(action_values, policy[:, None], axis=1)[:, 0]
        better = self.acting & (action_values.max(axis=1) > kept + self.rounding(values))
        return np.where(better, action_values.argmax(axis=1), policy)

    def evaluate(self, policy: NDArray[np.int64]) -> NDArray[np.float64]:
        """V of a policy: one sparse linear solve over the states in which one acts."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        states = np.flatnonzero(self.acting)
        chosen = policy[states]
        steps = self.kernel[states * self.rewards.shape[1] + chosen][:, states]
        system = sparse.eye_array(len(states), format="csc") - self.gamma * steps.tocsc()
        values = np.zeros(len(self.acting))
        if len(states):
            values[states] = splu(system.tocsc()).solve(self.rewards[states, chosen])
        return values

    @property
    def terms(self) -> int:
        """Roundings in one entry of a sweep: the longest row's, and those around it."""
        return int(np.diff(self.kernel.indptr).max()) + 4

    def rounding(self, values: NDArray[np.float64]) -> float:
        """A bound on the rounding error of one sweep from ``values``."""
        largest = float(np.abs(self.rewards).max()) + float(np.abs(values).max())
        return self.terms * EPSILON * largest

    def error_bound(self, values: NDArray[np.float64]) -> float:
        """A bound on max |V - V*|; rows that sum to slightly more than 1 are accounted for."""
        residual = float(np.abs(self.sweep(values) - values).max())
        largest_row = float(self.kernel.sum(axis=1).max(initial=1.0))
        contraction = self.gamma * largest_row * (1 + self.terms * EPSILON)
        if contraction >= 1:
            return math.inf
        return (residual + self.rounding(values)) / (1 - contraction)


def _solve(bellman: _Bellman) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Sweeps, and an evaluation of the greedy policy after 0, 1, 3, 7 ... of them."""
    policy = bellman.action_values(np.zeros(len(bellman.acting))).argmax(axis=1)
    values = np.full(len(bellman.acting), -np.inf)
    sweeps = 1
    while True:
        before, values = values, bellman.evaluate(policy)
        stays = np.array_equal(bellman.improve(values, policy), policy)
        # Off the optimum an evaluation gains somewhere; what rounding alone gains is none.
        if stays or not (values > before + bellman.rounding(values)).any():
            return values, policy
        swept = values
        for _ in range(sweeps):
            swept = bellman.sweep(swept)
        policy = bellman.improve(swept, policy)
        sweeps *= 2


def _infeasible(num_states: int, blocked_states: int) -> PlanResult:
    values = np.full(num_states, -np.inf)
    policy = np.full(num_states, -1, dtype=np.int64)
    return PlanResult(-math.inf, read_only(values), read_only(policy), False, blocked_states, 0.0)


def _checked_discount(gamma: float | Fraction) -> float:
    if not 0 < gamma < 1:
        raise ValueError(
            f"gamma, the discount of the reward, must lie strictly between 0 and 1, not {gamma}: "
            "undiscounted returns need not be finite"
        )
    return float(gamma)


def _checked_mask(allowed: NDArray[np.bool_], model: SafeMDP) -> NDArray[np.bool_]:
    mask = plain_array("allowed", allowed)
    shape = (model.num_states, model.num_actions)
    if mask.dtype != np.bool_ or mask.shape != shape:
        raise ValueError(
            f"allowed must be a boolean mask of shape {shape}, "
            f"not {mask.dtype} of shape {mask.shape}"
        )
    return mask
