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

_NAMES = {
    "certificates.certificate": (
        "certify",
        "load_certificate",
        "save_certificate",
    ),
    "certificates.checker": ("check_certificate",),
    "io": (
        "load_model",
        "save_model",
    ),
    "io.estimation": (
        "Unseen",
        "estimate_model",
    ),
    "labels.classification": (
        "classify",
        "safe_actions",
    ),
    "labels.labelling": (
        "INFINITE",
        "Label",
        "Labelling",
    ),
    "model.safe_mdp": (
        "Geometry",
        "SafeMDP",
    ),
    "paper.methods": (
        "Conservatism",
        "Method",
        "conservatism",
        "dea_rrl",
        "dea_rrl_expectile",
        "rrl",
        "rrl_msdp",
    ),
    "safety.correction": (
        "behavior_correction",
        "corrected_model",
        "safety_filter",
    ),
    "safety.critics": ("unguarded",),
    "safety.explanation": (
        "Explanation",
        "explain",
    ),
    "safety.filter_table": (
        "FilterTable",
        "load_filter",
        "save_filter",
    ),
    "safety.guarantees": (
        "EpisodeGuarantee",
        "ExpectedSurvival",
        "episode_guarantee",
        "expected_survival",
        "one_step_risk",
    ),
    "safety.planning": (
        "PlanResult",
        "PriceOfConservatism",
        "plan",
        "price_of_conservatism",
    ),
    "safety.policies": (
        "Reading",
        "allowed_actions",
        "greedy_actions",
        "in_policy_set",
        "recovery_policy",
    ),
    "safety.tabular_correction": ("TabularCorrection",),
    "safety.thresholds": (
        "ThresholdInterval",
        "threshold_interval",
    ),
    "values.bellman": (
        "evaluate_policy",
        "value_iteration",
    ),
    "values.conventions": (
        "CriticConvention",
        "ValueConvention",
    ),
    "values.expectile": ("expectile_iteration",),
    "values.values": ("Values",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = ["__version__", *_MODULE_OF]  # noqa: PLE0604 (strings, from the one list of names)

if TYPE_CHECKING:
    from dead_ends.certificates.certificate import certify as certify
    from dead_ends.certificates.certificate import load_certificate as load_certificate
    from dead_ends.certificates.certificate import save_certificate as save_certificate
    from dead_ends.certificates.checker import check_certificate as check_certificate
    from dead_ends.io import load_model as load_model
    from dead_ends.io import save_model as save_model
    from dead_ends.io.estimation import Unseen as Unseen
    from dead_ends.io.estimation import estimate_model as estimate_model
    from dead_ends.labels.classification import classify as classify
    from dead_ends.labels.classification import safe_actions as safe_actions
    from dead_ends.labels.labelling import INFINITE as INFINITE
    from dead_ends.labels.labelling import Label as Label
    from dead_ends.labels.labelling import Labelling as Labelling
    from dead_ends.model.safe_mdp import Geometry as Geometry
    from dead_ends.model.safe_mdp import SafeMDP as SafeMDP
    from dead_ends.paper.methods import Conservatism as Conservatism
    from dead_ends.paper.methods import Method as Method
    from dead_ends.paper.methods import conservatism as conservatism
    from dead_ends.paper.methods import dea_rrl as dea_rrl
    from dead_ends.paper.methods import dea_rrl_expectile as dea_rrl_expectile
    from dead_ends.paper.methods import rrl as rrl
    from dead_ends.paper.methods import rrl_msdp as rrl_msdp
    from dead_ends.safety.correction import behavior_correction as behavior_correction
    from dead_ends.safety.correction import corrected_model as corrected_model
    from dead_ends.safety.correction import safety_filter as safety_filter
    from dead_ends.safety.critics import unguarded as unguarded
    from dead_ends.safety.explanation import Explanation as Explanation
    from dead_ends.safety.explanation import explain as explain
    from dead_ends.safety.filter_table import FilterTable as FilterTable
    from dead_ends.safety.filter_table import load_filter as load_filter
    from dead_ends.safety.filter_table import save_filter as save_filter
    from dead_ends.safety.guarantees import EpisodeGuarantee as EpisodeGuarantee
    from dead_ends.safety.guarantees import ExpectedSurvival as ExpectedSurvival
    from dead_ends.safety.guarantees import episode_guarantee as episode_guarantee
    from dead_ends.safety.guarantees import expected_survival as expected_survival
    from dead_ends.safety.guarantees import one_step_risk as one_step_risk
    from dead_ends.safety.planning import PlanResult as PlanResult
    from dead_ends.safety.planning import PriceOfConservatism as PriceOfConservatism
    from dead_ends.safety.planning import plan as plan
    from dead_ends.safety.planning import price_of_conservatism as price_of_conservatism
    from dead_ends.safety.policies import Reading as Reading
    from dead_ends.safety.policies import allowed_actions as allowed_actions
    from dead_ends.safety.policies import greedy_actions as greedy_actions
    from dead_ends.safety.policies import in_policy_set as in_policy_set
    from dead_ends.safety.policies import recovery_policy as recovery_policy
    from dead_ends.safety.tabular_correction import TabularCorrection as TabularCorrection
    from dead_ends.safety.thresholds import ThresholdInterval as ThresholdInterval
    from dead_ends.safety.thresholds import threshold_interval as threshold_interval
    from dead_ends.values.bellman import evaluate_policy as evaluate_policy
    from dead_ends.values.bellman import value_iteration as value_iteration
    from dead_ends.values.conventions import CriticConvention as CriticConvention
    from dead_ends.values.conventions import ValueConvention as ValueConvention
    from dead_ends.values.expectile import expectile_iteration as expectile_iteration
    from dead_ends.values.values import Values as Values


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'dead_ends' has no attribute {name!r}")
    return getattr(import_module(f"dead_ends.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
