"""Algorithm 1 in the paper's four forms and in this project's own: a file each, and its rows."""

from __future__ import annotations

from collections.abc import Sequence

from deep.pretraining import dea_rrl, dea_rrl_annealed, dearrl_iql, rrl, rrl_msdp
from deep.pretraining.dea_rrl import DeaRrl, DeaRrlSettings
from deep.pretraining.dea_rrl_annealed import DeaRrlAnnealed, DeaRrlAnnealedSettings
from deep.pretraining.dearrl_iql import DearrlIql, DearrlIqlSettings
from deep.pretraining.learner import Form, Learner, Losses, Settings
from deep.pretraining.rrl import Rrl, RrlSettings, TaskPolicy, uniform_task_policy
from deep.pretraining.rrl_msdp import RrlMsdp, RrlMsdpSettings
from deep.tasks.task import Sizes

__all__ = [
    "DEFAULT",
    "FORMS",
    "DeaRrl",
    "DeaRrlAnnealed",
    "DeaRrlAnnealedSettings",
    "DeaRrlSettings",
    "DearrlIql",
    "DearrlIqlSettings",
    "Form",
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
    "form_of",
    "uniform_task_policy",
]

ROWS = (
    rrl.FORM,
    rrl_msdp.FORM,
    dea_rrl.FORM,
    dea_rrl_annealed.FORM,
    dearrl_iql.FORM,
)
FORMS: dict[str, Form] = {form.name: form for form in ROWS}
"""By name, in the order of tables and legends; a new form is a file and a row."""
DEFAULT = dea_rrl_annealed.FORM


def form_of(settings: Settings) -> Form:
    """The form that these settings belong to."""
    return next(form for form in ROWS if type(settings) is form.settings)


def build_learner(settings: Settings, sizes: Sizes, seeds: Sequence[int]) -> Learner:
    """The learner that these settings belong to, freshly initialised."""
    return form_of(settings).build(settings, sizes, seeds)
