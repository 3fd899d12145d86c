"""What the page about a model tells, solved before it is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.certificates.certificate import find_witnesses
from dead_ends.draw.page import PageAnswers
from dead_ends.labels.classification import classify
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.safety.thresholds import threshold_interval
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention

__all__ = ["page_answers"]

GAMMAS = (0.5, 0.7, 0.8, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)
MAX_STATES = 100_000
TIME: Any = {
    "value": ValueConvention.TIME,
    "critic": CriticConvention.NEXT_VALUE,
    "tolerance": 1e-6,  # the page shows five digits
}


def page_answers(model: SafeMDP, policies: Mapping[str, NDArray[Any]] | None = None) -> PageAnswers:
    """Labels, witnesses, thresholds and critics over a grid of gammas.

    Args:
        model: the model.
        policies: task policies by name, int (S,) or float (S, A), whose critics can be
            chosen beside Q*; without any, the uniformly random policy.

    Raises:
        ValueError: if the model has more states than a page can show.
    """
    require_type(model, SafeMDP, "page_answers")
    if model.num_states > MAX_STATES:
        raise ValueError(
            f"the page shows at most {MAX_STATES:,} states, the model has {model.num_states:,}; "
            "`label --out` writes the labels of any model"
        )
    if policies is None:
        policies = {"uniformly random policy": _uniform(model)}
    labelling = classify(model)
    return PageAnswers(
        labelling,
        find_witnesses(model, labelling),
        GAMMAS,
        [threshold_interval(model, gamma) for gamma in GAMMAS],
        {"best policy, Q*": [value_iteration(model, gamma, **TIME) for gamma in GAMMAS]}
        | {
            name: [evaluate_policy(model, policy, gamma, **TIME) for gamma in GAMMAS]
            for name, policy in policies.items()
        },
    )


def _uniform(model: SafeMDP) -> NDArray[np.float64]:
    """(S, A): each available action with the same probability; anything on fail rows."""
    available = model.available
    count = np.maximum(available.sum(axis=1, keepdims=True), 1)
    policy = available / count
    policy[model.fail] = 1 / model.num_actions
    return np.asarray(policy)
