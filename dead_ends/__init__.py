"""Exact dead-ends, safety critics, recovery policies and behavior correction.

A *dead-end* is a state from which the agent fails whatever it does. This package takes a
finite model of a task in which the first violation ends the episode and answers exactly:
which states are lost, how long they survive, which threshold a safety filter must use and
which recovery policy keeps it safe.

    >>> import numpy as np
    >>> from dead_ends import SafeMDP, classify
    >>> model = SafeMDP.deterministic(np.array([[0, 1], [2, 2], [2, 2]]), np.array([0, 0, 1]) == 1)
    >>> classify(model).labels
    array([2, 1, 0], dtype=uint8)

Names are imported when first used, so that importing the package is cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_MODULE_OF = {
    "allowed_actions": "policies",
    "behavior_correction": "correction",
    "classify": "labels",
    "conservatism": "methods",
    "corrected_model": "correction",
    "CriticConvention": "conventions",
    "dea_rrl": "methods",
    "dea_rrl_expectile": "methods",
    "estimate_model": "estimation",
    "evaluate_policy": "bellman",
    "expectile_iteration": "expectile",
    "explain": "explanation",
    "Geometry": "model",
    "greedy_actions": "policies",
    "in_policy_set": "policies",
    "INFINITE": "results",
    "Label": "results",
    "Labelling": "results",
    "plan": "planning",
    "price_of_conservatism": "planning",
    "Reading": "policies",
    "recovery_policy": "policies",
    "rrl": "methods",
    "rrl_msdp": "methods",
    "safe_actions": "labels",
    "SafeMDP": "model",
    "threshold_interval": "thresholds",
    "ThresholdInterval": "thresholds",
    "value_iteration": "bellman",
    "ValueConvention": "conventions",
    "Values": "results",
}

__all__ = [
    "INFINITE",
    "CriticConvention",
    "Geometry",
    "Label",
    "Labelling",
    "Reading",
    "SafeMDP",
    "ThresholdInterval",
    "ValueConvention",
    "Values",
    "__version__",
    "allowed_actions",
    "behavior_correction",
    "classify",
    "conservatism",
    "corrected_model",
    "dea_rrl",
    "dea_rrl_expectile",
    "estimate_model",
    "evaluate_policy",
    "expectile_iteration",
    "explain",
    "greedy_actions",
    "in_policy_set",
    "plan",
    "price_of_conservatism",
    "recovery_policy",
    "rrl",
    "rrl_msdp",
    "safe_actions",
    "threshold_interval",
    "value_iteration",
]

if TYPE_CHECKING:
    from dead_ends.model import Geometry as Geometry
    from dead_ends.model import SafeMDP as SafeMDP


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'dead_ends' has no attribute {name!r}")
    return getattr(import_module(f"dead_ends.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
