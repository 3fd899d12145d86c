"""Algorithm 1 in the paper's four forms and in this project's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from deep.pretraining.dea_rrl import DeaRrl, DeaRrlSettings
from deep.pretraining.dea_rrl_annealed import DeaRrlAnnealed, DeaRrlAnnealedSettings
from deep.pretraining.dearrl_iql import DearrlIql, DearrlIqlSettings
from deep.pretraining.learner import Learner, Losses, Settings
from deep.pretraining.rrl import Rrl, RrlSettings, TaskPolicy, uniform_task_policy
from deep.pretraining.rrl_msdp import RrlMsdp, RrlMsdpSettings
from deep.tasks.task import Sizes

__all__ = [
    "SETTINGS",
    "AnySettings",
    "DeaRrl",
    "DeaRrlAnnealed",
    "DeaRrlAnnealedSettings",
    "DeaRrlSettings",
    "DearrlIql",
    "DearrlIqlSettings",
    "Learner",
    "Losses",
    "Rrl",
    "RrlMsdp",
    "RrlMsdpSettings",
    "RrlSettings",
    "Settings",
    "Sizes",
    "TaskPolicy",
    "build_learner",
    "method_name",
    "uniform_task_policy",
]

AnySettings: TypeAlias = (
    DeaRrlAnnealedSettings | DeaRrlSettings | DearrlIqlSettings | RrlSettings | RrlMsdpSettings
)

SETTINGS: dict[str, type[AnySettings]] = {
    DeaRrlAnnealed.name: DeaRrlAnnealedSettings,
    DeaRrl.name: DeaRrlSettings,
    DearrlIql.name: DearrlIqlSettings,
    Rrl.name: RrlSettings,
    RrlMsdp.name: RrlMsdpSettings,
}


def build_learner(settings: AnySettings, sizes: Sizes, seeds: Sequence[int]) -> Learner:
    """The learner that these settings belong to, freshly initialised."""
    match settings:
        case DeaRrlAnnealedSettings():
            return DeaRrlAnnealed(settings, sizes, seeds)
        case DeaRrlSettings():
            return DeaRrl(settings, sizes, seeds)
        case DearrlIqlSettings():
            return DearrlIql(settings, sizes, seeds)
        case RrlSettings():
            return Rrl(settings, sizes, seeds)
        case RrlMsdpSettings():
            return RrlMsdp(settings, sizes, seeds)


def method_name(settings: AnySettings) -> str:
    """The method's name on the command line."""
    return next(name for name, kind in SETTINGS.items() if type(settings) is kind)
