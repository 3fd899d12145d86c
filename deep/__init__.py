"""Learned safety critics, recovery policies and behavior correction for continuous tasks.

The method of the paper (DEA-RRL and its three relatives) where states are continuous and
only logged data are at hand, on small tasks with an exact answer to score it against.

From a log to a protected environment:

    from deep import BehaviorCorrection, pretrain, read_hdf5

    result = pretrain(read_hdf5("log.hdf5"), horizon=3)
    print(result.health[0])
    protected = BehaviorCorrection(env, result.filters[0])

Names are imported when first used: filters need numpy and safetensors, not torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

_NAMES = {
    "data.formats": (
        "from_minari",
        "read_hdf5",
        "write_hdf5",
    ),
    "data.transitions": (
        "Transitions",
        "summarise",
    ),
    "filter.behavior_correction": (
        "BehaviorCorrection",
        "BehaviorCorrectionVector",
    ),
    "filter.onnx_export": ("export_onnx",),
    "filter.safety_filter": ("SafetyFilter",),
    "pretraining.algorithm": (
        "PretrainResult",
        "pretrain",
    ),
    "pretraining.health": (
        "FilterHealth",
        "check_filter",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [*_MODULE_OF]  # noqa: PLE0604 (strings, from the one list of names)

if TYPE_CHECKING:
    from deep.data.formats import from_minari as from_minari
    from deep.data.formats import read_hdf5 as read_hdf5
    from deep.data.formats import write_hdf5 as write_hdf5
    from deep.data.transitions import Transitions as Transitions
    from deep.data.transitions import summarise as summarise
    from deep.filter.behavior_correction import BehaviorCorrection as BehaviorCorrection
    from deep.filter.behavior_correction import BehaviorCorrectionVector as BehaviorCorrectionVector
    from deep.filter.onnx_export import export_onnx as export_onnx
    from deep.filter.safety_filter import SafetyFilter as SafetyFilter
    from deep.pretraining.algorithm import PretrainResult as PretrainResult
    from deep.pretraining.algorithm import pretrain as pretrain
    from deep.pretraining.health import FilterHealth as FilterHealth
    from deep.pretraining.health import check_filter as check_filter


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'deep' has no attribute {name!r}")
    return getattr(import_module(f"deep.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
