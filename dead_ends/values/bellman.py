"""Safety critics: the values V_c and Q_c of the best policy, and of a given one.

The paper's critic (Section "Preliminary") in the base convention, with c the cost of
entering fail:

    Q(s, a) = E [c + (1 - c) gamma V(s')],     V*(s) = min_a Q*(s, a),
                                               V^pi(s) = sum_a pi(a|s) Q^pi(s, a).

Equivalently Q(s, a) = sum_s' P(s'|s, a) w(s') with w(fail) = 1 and w(s') = gamma V(s'); the
other conventions replace gamma V(s') and w(fail) by other powers of gamma (see
:mod:`dead_ends.values.discount`). At gamma = 1 the least solution is meant, the probability of ever
failing.

What is exact:

* Deterministic model, best policy or a policy that takes one action a state: V and Q are
  powers of gamma whose exponents are integers found by backward analysis; in floats equal
  survival times give equal floats.
* With Fractions everything is exact.
* Else V and Q are floats within bounds that enclose the true value, also of the model whose
  numbers are the shortest decimals of the floats given. Values that the graph decides are
  exact: 0 where no failure is possible, at gamma = 1 also 1 where it is certain.

Rows that sum to 1 only within 1e-9 are taken as they are; then the bounds enclose the fixed
point of the equations as written, capped at 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from dead_ends.labels.labelling import Label
from dead_ends.labels.qualitative import qualitative_labels
from dead_ends.labels.retrograde import survival_times
from dead_ends.model.policy_table import (
    as_distribution,
    check_policy,
    exact_distribution,
    single_actions,
)
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.critic import Known, Settings, from_equations, from_operator, from_times
from dead_ends.values.discount import Discount
from dead_ends.values.fixed_point.operators import Optimum, unknown_rows
from dead_ends.values.fixed_point.rounding import Csr, RoundedKernel, pattern
from dead_ends.values.values import Values

__all__ = ["evaluate_policy", "value_iteration"]


def value_iteration(
    model: SafeMDP,
    gamma_safe: Discount = 0.99,
    *,
    value: ValueConvention | str = ValueConvention.COST_FAIL_0,
    critic: CriticConvention | str = CriticConvention.LOSS_TARGET,
    exact: bool | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 10_000,
) -> Values:
    """The best safety critic: V*(s) and Q*(s, a), the least over all policies.

    Args:
        model: deterministic: powers of gamma from survival times, whatever H. Stochastic:
            value iteration from below and from above, sped up by verified guesses.
        gamma_safe: the discount of the cost, in (0, 1]; at 1 the value is P_min(F fail).
        value, critic: the paper's convention of the result.
        exact: calculate in Fractions; None means if ``gamma_safe`` is a Fraction. Floats
            are then read as their shortest decimals.
        tolerance: how far apart the bounds of V may be (not used if exact or deterministic).
        max_iterations: sweeps of value iteration, at most.

    Returns:
        V (S,) and Q (S, A) with bounds; Q is +inf for actions that are not available and on
        fail rows.

    Raises:
        ValueError: for a discount outside (0, 1]; in exact calculations for a row that does
            not sum to exactly 1; if the tolerance is not reached.
    """
    require_type(model, SafeMDP, "value_iteration")
    settings = Settings.read(gamma_safe, value, critic, exact, tolerance, max_iterations)
    if model.is_deterministic:
        return from_times(model, survival_times(model), settings)
    known = known_states(model, settings)
    if settings.exact:
        return from_equations(model, known, best_action, settings)
    kernel, available = model.transitions(), model.available
    return from_operator(model, known, least(kernel, available, known, settings), settings)


def evaluate_policy(
    model: SafeMDP,
    policy: ArrayLike,
    gamma_safe: Discount = 0.99,
    *,
    value: ValueConvention | str = ValueConvention.COST_FAIL_0,
    critic: CriticConvention | str = CriticConvention.LOSS_TARGET,
    exact: bool | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 10_000,
) -> Values:
    """The safety critic of a policy: V^pi(s) and Q^pi(s, a).

    Args:
        model: the model.
        policy: int (S,), or (S, A) of floats or Fractions, whose row s is pi(. | s).
        gamma_safe, value, critic, exact, tolerance, max_iterations: as in
            :func:`value_iteration`. At gamma_safe = 1 the value is the probability of failing
            under the policy.

    Returns:
        As :func:`value_iteration`; Q covers all available actions, also those that the
        policy does not take.

    Raises:
        ValueError: as :func:`value_iteration`, and for a policy that is none of this model
            (see :func:`dead_ends.model.policy_table.check_policy`).
    """
    require_type(model, SafeMDP, "evaluate_policy")
    settings = Settings.read(gamma_safe, value, critic, exact, tolerance, max_iterations)
    checked = check_policy(model, policy)
    actions = single_actions(model, checked)
    if model.is_deterministic and actions is not None:
        return from_times(model, _times_under(model, actions), settings)
    if settings.exact:
        return _evaluate_exact(model, exact_distribution(model, checked), settings)
    distribution = as_distribution(checked, model.num_actions).astype(np.float64)
    chain = policy_kernel(model, distribution)
    known = known_states(graph_model(model, chain), settings)
    always = np.ones((model.num_states, 1), dtype=np.bool_)
    operator = least(chain, always, known, settings, merged=model.num_actions + 2)
    return from_operator(model, known, operator, settings)


def _times_under(model: SafeMDP, actions: NDArray[np.int64]) -> NDArray[np.int32]:
    """The time to fail under a deterministic policy: T of the model with that one action."""
    taken = np.where(model.fail | model.terminal, 0, actions)
    successors = model.successors()[np.arange(model.num_states), taken]
    one_action = SafeMDP.deterministic(successors[:, None], model.fail, terminal=model.terminal)
    return survival_times(one_action)


def _evaluate_exact(
    model: SafeMDP, distribution: NDArray[np.object_], settings: Settings
) -> Values:
    chain = policy_kernel(model, np.asarray(distribution > 0, dtype=np.float64))
    known = known_states(graph_model(model, chain), settings)

    def choose(state: int, q: Mapping[int, Any]) -> dict[int, Fraction]:
        return {action: p for action in q if (p := distribution[state, action])}

    return from_equations(model, known, choose, settings)


def best_action(_state: int, q: Mapping[int, Any]) -> dict[int, Fraction]:
    """All weight on the first of the best actions."""
    return {min(q, key=q.__getitem__): Fraction(1)}


def policy_kernel(model: SafeMDP, distribution: NDArray[Any]) -> Csr:
    """CSR (S, S): the chain sum_a pi(a|s) P(. | s, a); terminal states stay, fail rows empty."""
    weights = np.where(model.terminal[:, None], 0.0, distribution)
    weights[model.terminal, 0] = 1.0
    weights[~model.available] = 0.0
    states, actions = np.nonzero(weights)
    shape = (model.num_states, model.num_states * model.num_actions)
    mixing = sparse.csr_array(
        (weights[states, actions], (states, states * model.num_actions + actions)), shape=shape
    )
    return sparse.csr_array(mixing @ model.transitions())


def known_states(model: SafeMDP, settings: Settings) -> Known:
    """The states whose least value the graph decides to be 0 or 1."""
    labels = qualitative_labels(model)
    one = model.fail
    if settings.gamma == 1:
        one = one | (labels == Label.DEAD)
    return Known(zero=np.equal(labels, Label.SAFE), one=one)


def graph_model(model: SafeMDP, kernel: Csr) -> SafeMDP:
    """A model with the graph of another kernel (S * A', S) on the same states.

    The kernel's probabilities may be rounded sums; they are not taken over.
    """
    counts = np.diff(kernel.indptr)
    uniform = pattern(kernel)
    uniform.data = np.repeat(1.0 / np.maximum(counts, 1), counts)
    available = (counts > 0).reshape(model.num_states, -1)
    return SafeMDP.stochastic(uniform, model.fail, available, terminal=model.terminal)


def least(
    kernel: Csr,
    available: NDArray[np.bool_],
    known: Known,
    settings: Settings,
    merged: int = 0,
) -> Optimum:
    """The operator min_a q(., a) of a kernel (S * A, S), on the states whose value is unknown.

    Args:
        kernel, available: the kernel and its actions (S, A).
        known: the states whose value the graph decides.
        settings: the discount.
        merged: operations that were spent on an entry of the kernel.
    """
    unknown = known.unknown
    rows = sparse.csr_array(kernel[unknown_rows(unknown, available.shape[1])])
    return Optimum(
        kernel=RoundedKernel.build(rows, known.zero, known.one, merged),
        available=available[unknown],
        unknown=unknown,
        weights=known.weights,
        gamma=float(settings.gamma),
    )
