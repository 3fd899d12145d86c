"""Hand-made safety filters, for tests that need no training."""

from __future__ import annotations

import numpy as np

from deep.data.normalisation import Normalisation
from deep.filter.safety_filter import SafetyFilter
from deep.tasks.bounds import Bounds


def linear_filter(
    observation_weights: list[float],
    action_weight: float,
    bias: float,
    recovery_bias: float,
    *,
    threshold: float = 0.5,
    normalisation: Normalisation | None = None,
    actions: Bounds | None = None,
    observations: Bounds | None = None,
    reach: float = 1.0,
) -> SafetyFilter:
    """Q = sigmoid(w . s + u a + b); the recovery action is reach tanh(recovery_bias).

    Actions lie where the normalisation has them, observations in [-1000, 1000].
    """
    weights = np.array([*observation_weights, action_weight], dtype=np.float32)
    o = len(observation_weights)
    units = normalisation or Normalisation.identity(o, 1)
    centre, scale = np.array(units.action_centre), np.array(units.action_scale)
    return SafetyFilter(
        critic=((weights[None, :, None], np.full((1, 1, 1), bias, dtype=np.float32)),),
        recovery=(
            (np.zeros((o, 2), dtype=np.float32), np.array([recovery_bias, 0], dtype=np.float32)),
        ),
        threshold=threshold,
        normalisation=units,
        actions=actions or Bounds.of(centre - scale, centre + scale),
        observations=observations or Bounds((-1000.0,) * o, (1000.0,) * o),
        reach=reach,
        gamma_safe=0.9,
        method="by hand",
        seed=0,
    )


def random_filter(seed: int = 0, members: int = 3, hidden: int = 16) -> SafetyFilter:
    """A filter for 3 observations and 2 actions with random weights and units.

    Actions lie in [3, 7] and [-1, 1], observations within 5 of 0.
    """
    rng = np.random.default_rng(seed)

    def layer(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32) * 0.7

    return SafetyFilter(
        critic=(
            (layer(members, 5, hidden), layer(members, 1, hidden)),
            (layer(members, hidden, hidden), layer(members, 1, hidden)),
            (layer(members, hidden, 1), layer(members, 1, 1)),
        ),
        recovery=((layer(3, hidden), layer(hidden)), (layer(hidden, 4), layer(4))),
        threshold=0.4,
        normalisation=Normalisation((1.0, -2.0, 0.0), (3.0, 0.5, 1.0), (5.0, 0.0), (2.0, 1.0)),
        actions=Bounds((3.0, -1.0), (7.0, 1.0)),
        observations=Bounds((-5.0,) * 3, (5.0,) * 3),
        reach=1.1,
        gamma_safe=0.9,
        method="random",
        seed=seed,
    )
