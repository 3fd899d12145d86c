"""Random models by the thousand, where Hypothesis would be slow: small, exact, unpleasant."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dead_ends.model.safe_mdp import SafeMDP

DENOMINATORS = (2, 3, 7, 10, 1000, 10**6, 10**12)


def random_distribution(rng: np.random.Generator, num_states: int) -> dict[int, Fraction]:
    """One to three successors; the probabilities may be as small as 1e-12."""
    count = int(rng.integers(1, min(3, num_states) + 1))
    successors = rng.choice(num_states, count, replace=False)
    denominator = DENOMINATORS[int(rng.integers(len(DENOMINATORS)))]
    cuts = sorted(int(rng.integers(0, denominator + 1)) for _ in range(count - 1))
    if rng.random() < 0.3:
        cuts = [min(1, denominator)] * (count - 1)  # one tiny part
    parts = np.diff([0, *cuts, denominator])
    row = {int(s): Fraction(int(k), denominator) for s, k in zip(successors, parts, strict=True)}
    return {s: p for s, p in row.items() if p}


def random_stochastic(
    rng: np.random.Generator, max_states: int = 7, max_actions: int = 3
) -> SafeMDP:
    """An exact model whose last state fails; sometimes with a goal and missing actions."""
    n = int(rng.integers(2, max_states + 1))
    m = int(rng.integers(1, max_actions + 1))
    P = np.full((n, m, n), Fraction(0), dtype=object)
    for state, action in np.ndindex(n, m):
        for successor, p in random_distribution(rng, n).items():
            P[state, action, successor] = p
    available = rng.random((n, m)) < 0.8
    available[:, 0] = True
    states = np.arange(n)
    terminal = (states == 0) & (rng.random() < 0.3) & (n > 2)
    return SafeMDP.stochastic(P, states == n - 1, available, terminal=terminal)


def rounded(model: SafeMDP) -> SafeMDP:
    """The same model given in floats."""
    return SafeMDP.stochastic(
        model.transitions(), model.fail, model.available, terminal=model.terminal
    )


def random_deterministic(rng: np.random.Generator, max_states: int = 8) -> SafeMDP:
    """Mostly downhill towards the last state, which fails, so that there are long ways."""
    n, m = int(rng.integers(2, max_states + 1)), int(rng.integers(1, 4))
    steps = np.minimum(np.arange(n)[:, None] + rng.integers(0, 3, (n, m)), n - 1)
    table = np.where(rng.random((n, m)) < 0.8, steps, rng.integers(0, n, (n, m)))
    table[:, 1:][rng.random((n, m - 1)) < 0.1] = -1
    return SafeMDP.deterministic(table, np.arange(n) == n - 1)


def random_policy(rng: np.random.Generator, model: SafeMDP) -> NDArray[np.object_]:
    """An exact distribution over the available actions, some with probability 0."""
    weights = np.where(model.available, rng.integers(0, 4, model.available.shape), 0)
    empty = weights.sum(axis=1) == 0
    weights[empty, model.available[empty].argmax(axis=1)] = 1
    rows = np.full(weights.shape, Fraction(0), dtype=object)
    for index, weight in np.ndenumerate(weights):
        rows[index] = Fraction(int(weight), int(weights[index[0]].sum()))
    return rows
