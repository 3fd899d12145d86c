"""Small recordings whose observations count their rows, and the brake's own."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from deep.data.collect import collect, random_policy
from deep.data.transitions import Transitions
from deep.tasks import Brake

BRAKE = Brake()


def brake_data(seed: int = 0, transitions: int = 2000) -> Transitions:
    return collect(BRAKE, random_policy(BRAKE), np.random.default_rng(seed), transitions)


def episode(costs: list[int], timeout: bool = False) -> dict[str, np.ndarray]:
    """Raw columns of one episode whose observations count its rows."""
    n = len(costs)
    last = np.arange(n) == n - 1
    return {
        "observations": np.arange(n)[:, None] * 1.0,
        "actions": np.zeros((n, 1)),
        "next_observations": np.arange(1, n + 1)[:, None] * 1.0,
        "rewards": np.ones(n),
        "costs": np.array(costs, dtype=float),
        "terminals": last & (not timeout),
        "timeouts": last & timeout,
    }


def joined(*episodes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([e[name] for e in episodes]) for name in episodes[0]}


def same(a: Transitions, b: Transitions) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Transitions))
