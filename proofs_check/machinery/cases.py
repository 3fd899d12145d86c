"""What a statement is checked on: models side by side, and what is known of them beforehand.

A :class:`Case` holds one model or many that are not connected, all with the same number of
states, with the discount, the task policy, and the truth about the states: T and P_min from
the oracles or from the enumeration, never from the code under check.

In a deterministic case all values under deterministic policies are 0 or powers of gamma, and
every comparison in the statements compares exponents. One gamma therefore stands for all of
(0, 1), and a threshold gamma^h for all in (gamma^(h+1), gamma^h]; gamma = 1/2 is used for
whole enumerations, because its powers are exact in floats.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import combinations_with_replacement, islice, product
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP
from proofs_check.machinery import enumerate_models, oracles, strategies

FOREVER = int(np.iinfo(np.int32).max)
"""T of a state with a path that never fails."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Case:
    """Disconnected models of ``states`` states each; model i has the states from i * states on.

    Attributes:
        model: all of them as one.
        states: the number of states of each.
        gamma: gamma_safe, a Fraction, or the float 0.5 for whole enumerations.
        task: the task policy, int (S,) or Fractions (S, A).
        survival: int64 (S,): T over all paths, FOREVER where one never fails.
        failing: (S,) P_min(ever fail): integers 0 and 1, or Fractions.
        weight: int64 (count,): how many labelled models each model stands for.
    """

    model: SafeMDP
    states: int
    gamma: float | Fraction
    task: NDArray[Any]
    survival: NDArray[np.int64]
    failing: NDArray[Any]
    weight: NDArray[np.int64]

    @property
    def count(self) -> int:
        """The number of models."""
        return len(self.weight)

    @property
    def fail(self) -> Mask:
        """S_fail."""
        return self.model.fail

    @cached_property
    def dead(self) -> Mask:
        """S_dead: P_min = 1, not fail."""
        return np.asarray((self.failing == 1) & ~self.fail, dtype=np.bool_)

    @cached_property
    def safe(self) -> Mask:
        """The paper's S_safe: neither fail nor dead."""
        return np.asarray(self.failing < 1, dtype=np.bool_)

    @cached_property
    def sure(self) -> Mask:
        """The states all of whose paths fail, not fail; S_dead if deterministic."""
        return np.asarray((self.survival < FOREVER) & ~self.fail)

    @cached_property
    def support(self) -> Mask:
        """bool (S, A): the actions that the task policy may take; none in fail states."""
        return support(self.model, self.task)

    @cached_property
    def horizon(self) -> NDArray[np.int64]:
        """H (count,): the greatest T over the states all of whose paths fail, or 0."""
        return np.asarray(self.of_models(np.where(self.sure, self.survival, 0)).max(axis=1))

    @cached_property
    def boundary(self) -> NDArray[np.int64]:
        """H_b (count,) of deterministic models; -1 where no safe state has an unsafe successor."""
        entered = self.survival[self.model.successors()]
        unsafe = self.safe[:, None] & self.model.available & (entered < FOREVER)
        return np.asarray(self.of_models(np.where(unsafe, entered, -1).max(axis=1)).max(axis=1))

    def of_models(self, per_state: NDArray[Any]) -> NDArray[Any]:
        """(S, ...) reshaped to (count, states, ...)."""
        return per_state.reshape(self.count, self.states, *per_state.shape[1:])

    def any_of(self, mask: Mask) -> Mask:
        """bool (count,): the models in which the mask (S,) or (S, A) is True somewhere."""
        return np.asarray(self.of_models(mask).reshape(self.count, -1).any(axis=1))

    def spread(self, per_model: NDArray[Any]) -> NDArray[Any]:
        """(count,) repeated for each state, (S,)."""
        return np.repeat(per_model, self.states)

    def take(self, index: int) -> Case:
        """One of the models, as a case of its own."""
        rows = slice(index * self.states, (index + 1) * self.states)
        return replace(
            self,
            model=take_model(self.model, rows),
            task=self.task[rows],
            survival=self.survival[rows],
            failing=self.failing[rows],
            weight=np.ones(1, dtype=np.int64),
        )


def support(model: SafeMDP, policy: NDArray[Any]) -> Mask:
    """bool (S, A): the actions a policy may take; none in fail states."""
    if policy.ndim == 2:
        taken = np.asarray(policy > 0, dtype=np.bool_)
    else:
        taken = np.arange(model.num_actions) == policy[:, None]
    return np.asarray(taken & model.available)


def take_model(model: SafeMDP, rows: slice) -> SafeMDP:
    """The model on the states of a slice, which no transition leaves."""
    fail, terminal = model.fail[rows], model.terminal[rows]
    if model.is_deterministic:
        table = np.maximum(model.successors()[rows] - rows.start, -1)
        return SafeMDP.deterministic(table, fail, terminal=terminal)
    P = exact_table(model)[rows, :, rows]
    return SafeMDP.stochastic(P, fail, model.available[rows], terminal=terminal)


def longest_times(model: SafeMDP) -> NDArray[np.int64]:
    """T of a deterministic model by |S| sweeps of T(s) = 1 + max T(next(s, a)) from 0."""
    successors, n = model.successors(), model.num_states
    time = np.zeros(n, dtype=np.int64)
    for _ in range(n):
        after = np.where(model.available, time[successors], -1).max(axis=1)
        time = np.where(model.fail, 0, 1 + after)
    return np.where(time >= n, FOREVER, time)


def deterministic_case(
    model: SafeMDP, gamma: float | Fraction, task: NDArray[Any], survival: NDArray[np.int64]
) -> Case:
    """A single deterministic model."""
    return Case(
        model=model,
        states=model.num_states,
        gamma=gamma,
        task=task,
        survival=survival,
        failing=(survival < FOREVER).astype(np.int64),
        weight=np.ones(1, dtype=np.int64),
    )


def table_case(batch: enumerate_models.Tables, weight: NDArray[np.int64] | None = None) -> Case:
    """A batch of enumerated models with the task policy "always action 0"."""
    time = enumerate_models.survival(batch).astype(np.int64).ravel()
    survival = np.where(time == enumerate_models.FOREVER, FOREVER, time)
    return Case(
        model=enumerate_models.side_by_side(batch),
        states=batch.shape[1] + 1,
        gamma=0.5,
        task=np.zeros(len(time), dtype=np.int64),
        survival=survival,
        failing=(survival < FOREVER).astype(np.int64),
        weight=np.ones(len(batch), dtype=np.int64) if weight is None else weight,
    )


def stochastic_case(model: SafeMDP, gamma: Fraction, task: NDArray[Any]) -> Case:
    """A single stochastic model, the truth by brute force."""
    times = [FOREVER if t is None else t for t in oracles.survival_times(model)]
    return Case(
        model=model,
        states=model.num_states,
        gamma=gamma,
        task=task,
        survival=np.array(times, dtype=np.int64),
        failing=np.array(oracles.least_failure_probability(model), dtype=object),
        weight=np.ones(1, dtype=np.int64),
    )


EXHAUSTIVE_SIZES = ((1, 2), (2, 2), (3, 2), (4, 2), (5, 2), (1, 3), (2, 3), (3, 3), (4, 3))
"""(n, m): every labelled model of these sizes, with one fail state."""


@lru_cache(maxsize=1)
def exhaustive_cases() -> tuple[Case, ...]:
    """All deterministic models of the sizes above, smallest first."""
    return tuple(
        table_case(batch)
        for n, m in sorted(EXHAUSTIVE_SIZES)
        for batch in enumerate_models.batches(n, m)
    )


@lru_cache(maxsize=1)
def small_cases() -> tuple[Case, ...]:
    """One model of each class up to renaming, n <= 4 with m <= 3 and n = 5 with m = 2."""
    return tuple(class_case(n, m) for n, m in sorted(EXHAUSTIVE_SIZES))


def class_case(n: int, m: int) -> Case:
    """One model of each class of a size, with the sizes of the classes."""
    codes, sizes = enumerate_models.representatives(n, m)
    return table_case(enumerate_models.tables(n, m, codes), sizes)


@lru_cache(maxsize=1)
def large_cases(size: int = 65_536) -> tuple[Case, ...]:
    """n = 6, m = 2: one model of each class, ``size`` at a time."""
    codes, sizes = enumerate_models.representatives(6, 2)
    return tuple(
        table_case(enumerate_models.tables(6, 2, codes[part]), sizes[part])
        for part in (slice(start, start + size) for start in range(0, len(codes), size))
    )


HALF = Fraction(1, 2)
SIDE_BY_SIDE = 40
"""Stochastic models in a case: their table in Fractions is dense."""

STOCHASTIC_SIZES = (
    (2, 1, 4, 0),
    (2, 2, 4, 0),
    (3, 1, 4, 0),
    (3, 2, 4, 1),
    (3, 2, 2, 0),
    (4, 1, 4, 1),
)
"""(n, m, q, g): the last state fails, the g before it are goals, probabilities are k / q."""


def stochastic_count(n: int, m: int, q: int, goals: int) -> int:
    """Models of a size up to the order of a state's actions: multisets of distributions."""
    kinds = len(enumerate_models.distributions(n, q))
    multisets = kinds if m == 1 else kinds * (kinds + 1) // 2
    return int(multisets ** (n - 1 - goals))


def stochastic_models(n: int, m: int, q: int, goals: int) -> Iterator[SafeMDP]:
    """Every model of a size up to the order of a state's actions (m <= 2)."""
    parts = enumerate_models.distributions(n, q)
    rows = list(combinations_with_replacement(parts, m))
    position = np.arange(n)
    terminal = (position >= n - 1 - goals) & (position < n - 1)
    for table in product(rows, repeat=n - 1 - goals):
        P = np.full((n, m, n), Fraction(0), dtype=object)
        for state, choice in enumerate(table):
            for action, row in enumerate(choice):
                P[state, action] = [Fraction(part, q) for part in row]
        yield SafeMDP.stochastic(P, position == n - 1, terminal=terminal)


def together(cases: Sequence[Case]) -> Case:
    """Stochastic models of one size side by side."""
    first = cases[0]
    n, m = first.states, first.model.num_actions
    P = np.full((n * len(cases), m, n * len(cases)), Fraction(0), dtype=object)
    for i, case in enumerate(cases):
        rows = slice(i * n, (i + 1) * n)
        P[rows, :, rows] = exact_table(case.model)
    fail = np.concatenate([case.fail for case in cases])
    terminal = np.concatenate([case.model.terminal for case in cases])
    return replace(
        first,
        model=SafeMDP.stochastic(P, fail, terminal=terminal),
        task=np.concatenate([case.task for case in cases]),
        survival=np.concatenate([case.survival for case in cases]),
        failing=np.concatenate([case.failing for case in cases]),
        weight=np.concatenate([case.weight for case in cases]),
    )


def exact_table(model: SafeMDP) -> NDArray[np.object_]:
    """P (S, A, S) in Fractions; zero for actions that are not available and in fail states."""
    P = np.full((model.num_states, model.num_actions, model.num_states), Fraction(0), dtype=object)
    for state, rows in enumerate(oracles.kernel_of(model)):
        for action, row in enumerate(rows):
            for successor, p in row.items():
                P[state, action, successor] = p
    return P


@lru_cache(maxsize=1)
def stochastic_cases() -> tuple[Case, ...]:
    """All small stochastic models of the sizes above, gamma = 1/2; task: always action 0."""
    cases = []
    for n, m, q, goals in STOCHASTIC_SIZES:
        models = stochastic_models(n, m, q, goals)
        while part := list(islice(models, SIDE_BY_SIDE)):
            task = np.zeros(n, dtype=np.int64)
            cases.append(together([stochastic_case(each, HALF, task) for each in part]))
    return tuple(cases)


@st.composite
def drawn_deterministic(draw: st.DrawFn, mixed_policies: bool = True) -> Case:
    """A drawn deterministic model, task policy and discount."""
    model = draw(strategies.deterministic_models())
    policies = strategies.policies if mixed_policies else strategies.deterministic_policies
    task = draw(policies(model))
    return deterministic_case(model, draw(strategies.discounts()), task, longest_times(model))


@st.composite
def drawn_stochastic(draw: st.DrawFn) -> Case:
    """A drawn stochastic model, task policy and discount."""
    model = draw(strategies.stochastic_models())
    return stochastic_case(model, draw(strategies.discounts()), draw(strategies.policies(model)))
