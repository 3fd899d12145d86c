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

Names are imported when first used, so that importing the package is cheap. What only the paper's
story needs (its methods, conventions, readings and objectives) is in :mod:`dead_ends.paper`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_NAMES = {
    "certificates.certificate": ("certify",),
    "certificates.checker": ("check_certificate",),
    "io": ("load_model", "save_model"),
    "io.estimation": ("estimate_model",),
    "labels.classification": ("classify", "safe_actions"),
    "labels.labelling": ("INFINITE", "Label"),
    "model.safe_mdp": ("SafeMDP",),
    "safety.correction": ("behavior_correction", "corrected_model", "safety_filter"),
    "safety.critics": ("unguarded",),
    "safety.explanation": ("explain",),
    "safety.filter_table": ("load_filter", "save_filter"),
    "safety.policies": ("allowed_actions", "recovery_policy"),
    "safety.tabular_correction": ("TabularCorrection",),
    "safety.thresholds": ("threshold_interval",),
    "values.bellman": ("evaluate_policy", "value_iteration"),
    "values.values": ("Values",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = ["__version__", *_MODULE_OF]  # noqa: PLE0604 (strings, from the one list of names)

if TYPE_CHECKING:
    from dead_ends.certificates.certificate import certify as certify
    from dead_ends.certificates.checker import check_certificate as check_certificate
    from dead_ends.io import load_model as load_model
    from dead_ends.io import save_model as save_model
    from dead_ends.io.estimation import estimate_model as estimate_model
    from dead_ends.labels.classification import classify as classify
    from dead_ends.labels.classification import safe_actions as safe_actions
    from dead_ends.labels.labelling import INFINITE as INFINITE
    from dead_ends.labels.labelling import Label as Label
    from dead_ends.model.safe_mdp import SafeMDP as SafeMDP
    from dead_ends.safety.correction import behavior_correction as behavior_correction
    from dead_ends.safety.correction import corrected_model as corrected_model
    from dead_ends.safety.correction import safety_filter as safety_filter
    from dead_ends.safety.critics import unguarded as unguarded
    from dead_ends.safety.explanation import explain as explain
    from dead_ends.safety.filter_table import load_filter as load_filter
    from dead_ends.safety.filter_table import save_filter as save_filter
    from dead_ends.safety.policies import allowed_actions as allowed_actions
    from dead_ends.safety.policies import recovery_policy as recovery_policy
    from dead_ends.safety.tabular_correction import TabularCorrection as TabularCorrection
    from dead_ends.safety.thresholds import threshold_interval as threshold_interval
    from dead_ends.values.bellman import evaluate_policy as evaluate_policy
    from dead_ends.values.bellman import value_iteration as value_iteration
    from dead_ends.values.values import Values as Values


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'dead_ends' has no attribute {name!r}")
    return getattr(import_module(f"dead_ends.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
