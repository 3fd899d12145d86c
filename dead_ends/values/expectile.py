"""What DEA-RRL trains: the critic whose V is an expectile of Q over the data's actions.

The paper fits V to Q by expectile regression on the data, and Q to its target:

    v_loss:  V(s) minimises E_{a ~ data(.|s)} |tau - 1(Q(s, a) < V)| (Q(s, a) - V)^2
    q_loss:  Q(s, a) = E [c + (1 - c) gamma V(s')]

(Equations v_loss and q_loss; the weight is tau where Q > V and 1 - tau where Q < V.) In a
finite model the fixed point is found exactly: the minimiser solves

    sum_a m(a) (Q(s, a) - V) = 0,      m(a) = data(a|s) * (tau or 1 - tau),

so V is a weighted mean of the Q(s, a). With the actions ordered by Q and weight 1 - tau on the
k least, V is the least of these means over k if tau <= 1/2, and the greatest otherwise. tau = 0
gives the least Q on the data's support, that is Q* there; tau = 1/2 gives the data policy's own
critic; in between, Q* <= Q_tau <= Q^data.

The operator is monotone. All its weights on the data's support are positive for 0 < tau < 1, so
that it has one fixed point with V = 0 where the data policy cannot fail, also at gamma = 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from dead_ends.labels.retrograde import survival_times
from dead_ends.model.policy_table import (
    as_distribution,
    check_policy,
    exact_distribution,
    single_actions,
)
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.values.bellman import (
    best_action,
    evaluate_policy,
    graph_model,
    known_states,
    least,
    policy_kernel,
)
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.critic import Known, Settings, from_equations, from_operator, from_times
from dead_ends.values.discount import Discount
from dead_ends.values.fixed_point.operators import unknown_rows
from dead_ends.values.fixed_point.rounding import Csr, Float, RoundedKernel, grow, product, shrink
from dead_ends.values.values import Values

__all__ = ["expectile_iteration"]


def expectile_iteration(
    model: SafeMDP,
    data_policy: ArrayLike,
    expectile: float | Fraction,
    gamma_safe: Discount = 0.99,
    *,
    exact: bool | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 10_000,
) -> Values:
    """The fixed point of v_loss and q_loss, in the base convention.

    Args:
        model: the model.
        data_policy: the distribution of the data's actions, int (S,) or (S, A).
        expectile: tau in [0, 1); the paper uses 0.3.
        gamma_safe, exact, tolerance, max_iterations: as in
            :func:`dead_ends.value_iteration`.

    Returns:
        V and Q; Q is computed for all available actions, also those that the data lacks.

    Raises:
        ValueError: as :func:`dead_ends.evaluate_policy`, and for an expectile outside [0, 1).
    """
    require_type(model, SafeMDP, "expectile_iteration")
    if not 0 <= expectile < 1:
        raise ValueError(f"expectile must lie in [0, 1), not {expectile}")
    settings = Settings.read(
        gamma_safe,
        ValueConvention.COST_FAIL_0,
        CriticConvention.LOSS_TARGET,
        exact,
        tolerance,
        max_iterations,
    )
    checked = check_policy(model, data_policy)
    if expectile == 0.5 or single_actions(model, checked) is not None:
        return evaluate_policy(
            model,
            checked,
            settings.gamma,
            exact=settings.exact,
            tolerance=tolerance,
            max_iterations=max_iterations,
        )
    distribution = as_distribution(checked, model.num_actions)
    if expectile == 0:
        return _least_on_support(model, np.asarray(distribution > 0, dtype=np.bool_), settings)
    chain = policy_kernel(model, np.asarray(distribution > 0, dtype=np.float64))
    known = known_states(graph_model(model, chain), settings)
    if settings.exact:
        tau = Fraction(str(expectile))
        return _exactly(model, known, exact_distribution(model, checked), tau, settings)
    data = distribution.astype(np.float64)
    return _enclosed(model, known, data, float(expectile), settings)


def _least_on_support(model: SafeMDP, support: NDArray[np.bool_], settings: Settings) -> Values:
    """tau = 0: V(s) = min of Q(s, a) over the actions that the data may hold."""
    support = np.where(model.terminal[:, None], model.available, support & model.available)
    if model.is_deterministic:
        successors = np.where(support, model.successors(), -1)
        restricted = SafeMDP.deterministic(successors, model.fail, terminal=model.terminal)
        return from_times(model, survival_times(restricted), settings)
    kept = sparse.diags_array(support.ravel().astype(np.float64))
    kernel = sparse.csr_array(kept @ model.transitions())
    kernel.eliminate_zeros()
    known = known_states(graph_model(model, kernel), settings)
    if not settings.exact:
        return from_operator(model, known, least(kernel, support, known, settings), settings)

    def choose(state: int, q: Mapping[int, Any]) -> dict[int, Fraction]:
        return best_action(state, {a: q[a] for a in q if support[state, a]})

    return from_equations(model, known, choose, settings)


def _exactly(
    model: SafeMDP,
    known: Known,
    data: NDArray[np.object_],
    expectile: Fraction,
    settings: Settings,
) -> Values:
    def choose(state: int, q: Mapping[int, Any]) -> dict[int, Fraction]:
        taken = sorted((a for a in q if data[state, a]), key=q.__getitem__)
        patterns = (
            [
                data[state, a] * (1 - expectile if place < k else expectile)
                for place, a in enumerate(taken)
            ]
            for k in range(1, len(taken) + 1)
        )
        normal = [[m / sum(weights) for m in weights] for weights in patterns]
        means = [sum(m * q[a] for m, a in zip(ms, taken, strict=True)) for ms in normal]
        best = min(means) if 2 * expectile <= 1 else max(means)
        return dict(zip(taken, normal[means.index(best)], strict=True))

    return from_equations(model, known, choose, settings)


def _enclosed(
    model: SafeMDP, known: Known, data: Float, expectile: float, settings: Settings
) -> Values:
    unknown = known.unknown
    rows = sparse.csr_array(model.transitions()[unknown_rows(unknown, model.num_actions)])
    operator = Expectile(
        kernel=RoundedKernel.build(rows, known.zero, known.one),
        data=np.where(model.available, data, 0.0)[unknown],
        expectile=expectile,
        unknown=unknown,
        weights=known.weights,
        gamma=float(settings.gamma),
    )
    return from_operator(model, known, operator, settings)


@dataclass(frozen=True, eq=False)
class Expectile:
    """x -> expectile of q(., a), a monotone operator (:mod:`dead_ends.values.fixed_point`).

    Attributes:
        kernel: the rows (n * A, S) of the n unknown states.
        data: float (n, A), data(a | s).
        expectile: tau, in (0, 1).
        unknown: int (n,), the unknown states.
        weights: float (S,), w of the known states (0 on the unknown ones).
        gamma: the discount.
    """

    kernel: RoundedKernel
    data: Float
    expectile: float
    unknown: NDArray[np.int64]
    weights: Float
    gamma: float

    def value(self, x: Float) -> Float:
        """F(x), to nearest."""
        return self._best(self._means(self.kernel.sums(self._successors(x))))

    def lower(self, x: Float) -> Float:
        """F(x), rounded downward."""
        means = self._means(self.kernel.lower(self._successors(x)))
        return shrink(self._best(means), self._operations)

    def upper(self, x: Float) -> Float:
        """F(x), rounded upward."""
        means = self._means(self.kernel.upper(self._successors(x)))
        return grow(self._best(means), self._operations)

    def linear(self, x: Float) -> tuple[Csr, Float]:
        """The weighted means that are chosen at x, on the unknown states, and the rest."""
        q = self.kernel.sums(self._successors(x))
        means = self._means(q)
        mixing = self._mixing(q, means.argmin(axis=1) if self._least else means.argmax(axis=1))
        return self._on_unknown(mixing), product(mixing, self.kernel.sums(self.weights))

    @property
    def _least(self) -> bool:
        return self.expectile <= 0.5

    @property
    def _operations(self) -> float:
        """Two sums of A terms, a quotient, and what 1 - tau loses where tau is near 1."""
        spoilt = self.expectile / (1 - self.expectile)
        return 2 * float(self.data.shape[1] + 8 + spoilt)

    @property
    def _factors(self) -> tuple[float, float]:
        """The weights below and above V, up to a common factor; the larger one is 1."""
        ratio: float = self.expectile / (1 - self.expectile)
        return (1.0, ratio) if self._least else (1 / ratio, 1.0)

    def _successors(self, x: Float) -> Float:
        weights = self.weights.copy()
        weights[self.unknown] = self.gamma * x
        return weights

    def _order(self, q: Float) -> NDArray[np.int64]:
        """int (n, A): the actions by q, those without data last."""
        table = np.where(self.data > 0, q.reshape(self.data.shape), np.inf)
        return np.argsort(table, axis=1, kind="stable")

    def _means(self, q: Float) -> Float:
        """float (n, A): the mean with the lower factor on the k + 1 least actions."""
        order = self._order(q)
        data = np.take_along_axis(self.data, order, axis=1)
        terms = data * np.take_along_axis(q.reshape(self.data.shape), order, axis=1)
        below, above = self._factors
        return _split_sums(terms, below, above) / _split_sums(data, below, above)

    def _best(self, means: Float) -> Float:
        best: Float = means.min(axis=1) if self._least else means.max(axis=1)
        return best

    def _mixing(self, q: Float, last: NDArray[np.int64]) -> Csr:
        """CSR (n, n * A): the weights of the actions, the lower factor up to place ``last``."""
        order = self._order(q)
        places = np.empty_like(order)
        np.put_along_axis(places, order, np.arange(order.shape[1])[None, :], axis=1)
        below, above = self._factors
        m = self.data * np.where(places <= last[:, None], below, above)
        m /= m.sum(axis=1, keepdims=True)
        count, actions = m.shape
        indptr = np.arange(count + 1) * actions
        return sparse.csr_array(
            (m.ravel(), np.arange(count * actions), indptr), shape=(count, count * actions)
        )

    def _on_unknown(self, mixing: Csr) -> Csr:
        return sparse.csr_array(self.gamma * (mixing @ self.kernel.matrix)[:, self.unknown])


def _split_sums(terms: Float, below: float, above: float) -> Float:
    """(n, A): below * (sum up to each place) + above * (sum after it), without differences."""
    up_to = np.cumsum(terms, axis=1)
    after = np.cumsum(terms[:, ::-1], axis=1)[:, ::-1]
    after = np.concatenate((after[:, 1:], np.zeros((len(terms), 1))), axis=1)
    return below * up_to + above * after
