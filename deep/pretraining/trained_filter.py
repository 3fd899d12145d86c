"""From a trained learner to the safety filter of one of its seeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from deep.data.normalisation import Normalisation, Ranges
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining.learner import Learner

__all__ = ["trained_filter"]


def trained_filter(
    learner: Learner,
    seed: int,
    threshold: float,
    gamma_safe: float,
    normalisation: Normalisation,
    ranges: Ranges,
) -> SafetyFilter:
    """The critic and the recovery policy that ``seed`` has learned, behind a threshold.

    ``normalisation`` and ``ranges`` are those of the data that it learned from.

    Raises:
        ValueError: if the seed is not one of the learner's.
    """
    if seed not in learner.seeds:
        raise ValueError(f"seed {seed} was not trained; there are {list(learner.seeds)}")
    k = learner.seeds.index(seed)
    critic, policy = learner.critic, learner.recovery
    members = slice(k * critic.members, (k + 1) * critic.members)
    return SafetyFilter(
        critic=tuple(
            (_array(w[members]), _array(b[members]))
            for w, b in zip(critic.mlp.weights, critic.mlp.biases, strict=True)
        ),
        recovery=tuple(
            (_array(w[k]), _array(b[k, 0]))
            for w, b in zip(policy.mlp.weights, policy.mlp.biases, strict=True)
        ),
        threshold=threshold,
        normalisation=normalisation,
        actions=ranges.actions,
        observations=ranges.observations,
        reach=policy.reach,
        gamma_safe=gamma_safe,
        method=learner.name,
        seed=seed,
    )


def _array(tensor: Tensor) -> NDArray[np.float32]:
    return tensor.detach().cpu().numpy().copy()
