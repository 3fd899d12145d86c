"""What a run is: configurations that are resolved to plain numbers and written as JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar, Union

import numpy as np
import tyro

from deep.data.collect import (
    Source,
    collect_mix,
    corner_policy,
    random_policy,
    towards_obstacle_policy,
    uniform_starts,
)
from deep.data.transitions import Transitions
from deep.pretraining import DEFAULT, FORMS, Settings, form_of
from deep.runs.folder import from_plain
from deep.tasks import Task
from deep.tasks.bounds import Bounds
from deep.tasks.violation import check_rule

__all__ = [
    "MethodChoice",
    "Mix",
    "PretrainConfig",
    "Training",
    "config_from_json",
    "config_to_json",
    "resolve",
]

AnyTraining = TypeVar("AnyTraining", bound="Training")

if TYPE_CHECKING:
    MethodChoice: TypeAlias = Settings
else:  # the command line asks which form's
    MethodChoice = Union[  # noqa: UP007  (of as many as there are rows)
        tuple(Annotated[f.settings, tyro.conf.subcommand(f.name)] for f in FORMS.values())
    ]


@dataclass(frozen=True)
class Mix:
    """Where offline data come from; the shares sum to 1.

    Attributes:
        transitions: how many are kept.
        random: share of uniform actions.
        corners: share of actions at the ends of their range.
        adversary: share of actions that head for the nearest obstacle.
        keep: only so many steps before each violation; None: all.
        anywhere: start episodes all over the task's box instead of at its own starts.
        max_steps: cut episodes off there; None: at the task's time limit.
    """

    transitions: int = 40_000
    random: float = 0.5
    corners: float = 0.5
    adversary: float = 0.0
    keep: int | None = 100
    anywhere: bool = False
    max_steps: int | None = None

    def collect(self, task: Task, rng: np.random.Generator) -> Transitions:
        """Draw the data."""
        starts = uniform_starts(task) if self.anywhere else None
        shares = (
            (random_policy(task), self.random),
            (corner_policy(task), self.corners),
            (towards_obstacle_policy(task), self.adversary),
        )
        sources = [
            Source(policy, share, starts, self.keep, self.max_steps)
            for policy, share in shares
            if share != 0
        ]
        return collect_mix(task, sources, rng, self.transitions)


@dataclass(frozen=True)
class Training:
    """What Algorithm 1 learns, and for how long, whatever the data.

    Attributes:
        method: the form of Algorithm 1, with its settings.
        seeds: one critic and recovery policy each, trained side by side.
        updates: minibatch updates.
        horizon: H, the most steps from a dead-end to the violation; None: the task's own,
            where it has an exact answer.
        gamma_safe: None: what the form makes of H, or the settings' where it makes nothing.
        sharpness: power to which the critic raises the observations' closenesses, the
            coordinates that stay in [0, 1] (lidars), before it normalises them: 1 leaves
            them; a high one spreads the last centimetres before an obstacle.
        threshold: None: by the form's rule, gamma_safe^(H + 1/2) or gamma_safe^H / 4.
        action_low: the environment's lower action bounds, one number a coordinate, for
            data whose actions do not show them; None: the least in the data.
        action_high: the upper ones, likewise.
        device: cpu or cuda.
        log_every: updates between two looks at the losses, two rows of progress.csv.
    """

    method: MethodChoice = field(default_factory=DEFAULT.settings)
    seeds: tuple[int, ...] = (0,)
    updates: int = 4000
    horizon: int | None = None
    gamma_safe: float | None = None
    sharpness: float = 1.0
    threshold: float | None = None
    action_low: tuple[float, ...] | None = None
    action_high: tuple[float, ...] | None = None
    device: str = "cpu"
    log_every: int = 250

    def __post_init__(self) -> None:
        if self.device not in ("cpu", "cuda"):
            raise ValueError(f"device must be cpu or cuda, not {self.device!r}")
        if self.sharpness < 1:
            raise ValueError(f"sharpness must be at least 1, not {self.sharpness}")
        for name in ("updates", "log_every"):
            _at_least_one(name, getattr(self, name))
        if (self.action_low is None) != (self.action_high is None):
            raise ValueError("give both action_low and action_high, or neither")
        _ = self.action_bounds

    @property
    def action_bounds(self) -> Bounds | None:
        """The environment's, where they are stated."""
        if self.action_low is None or self.action_high is None:
            return None
        return Bounds(self.action_low, self.action_high)


@dataclass(frozen=True)
class PretrainConfig(Training):
    """One run of Algorithm 1 in a folder: what is learned, and from which data.

    Attributes:
        task: the name of a task, from which every seed collects its own data.
        data: a file of transitions for all seeds, instead of a task.
        cut: end the file's episodes at every violation, see
            :func:`deep.data.transitions.cut_at_violation`.
        violation: which of the file's costs are one, as in "cost > 0.5"; None: they are 0 or 1.
        mix: of the data that are collected.
        checkpoint_every: updates between two checkpoints.
    """

    task: str | None = None
    data: Path | None = None
    cut: bool = False
    violation: str | None = None
    mix: Mix = field(default_factory=Mix)
    checkpoint_every: int = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.task is None) == (self.data is None):
            raise ValueError("give either a task or a data file")
        if self.task is not None and self.task.startswith(("real:", "gym:")):
            raise ValueError(
                f"{self.task}: pretraining collects from this project's own tasks only; make a "
                "file with collect or offline-data, and give it as data"
            )
        check_rule(self.violation)
        if self.data is None and (self.cut or self.violation is not None):
            raise ValueError("cut and violation are of a data file: a task ends at violations")
        if self.task is not None and self.action_low is not None:
            raise ValueError("action_low and action_high go with a data file: a task knows them")
        _at_least_one("checkpoint_every", self.checkpoint_every)


def _at_least_one(name: str, number: int) -> None:
    if number < 1:
        raise ValueError(f"{name} must be at least 1, not {number}")


def resolve(config: AnyTraining, horizon: int | None = None) -> AnyTraining:
    """The same run with every number filled in; ``horizon`` is the task's, if known.

    Raises:
        ValueError: if the discount or the threshold needs a horizon and there is none.
    """
    horizon = config.horizon if config.horizon is not None else horizon
    form, gamma, threshold = form_of(config.method), config.gamma_safe, config.threshold
    if horizon is None and (threshold is None or (form.discount and gamma is None)):
        raise ValueError(
            "give the horizon (the most steps from a dead-end to the violation), "
            "or both gamma_safe and threshold"
        )
    if gamma is None:
        gamma = config.method.gamma_safe
        if form.discount:
            assert horizon is not None
            gamma = form.discount(horizon)
    if threshold is None:
        assert horizon is not None
        threshold = form.threshold(gamma, horizon)
    return replace(
        config,
        horizon=horizon,
        gamma_safe=gamma,
        threshold=threshold,
        method=replace(config.method, gamma_safe=gamma),
    )


WHEN_GIVEN: dict[str, Any] = {"cut": False, "violation": None}
"""What is written only where it is something else."""


def config_to_json(config: PretrainConfig) -> dict[str, Any]:
    """Plain values; the method by its name and settings."""
    plain = asdict(config)
    plain = {k: v for k, v in plain.items() if k not in WHEN_GIVEN or v != WHEN_GIVEN[k]}
    plain["data"] = None if config.data is None else str(config.data)
    plain["method"] = {"name": form_of(config.method).name, **plain["method"]}
    return plain


def config_from_json(plain: dict[str, Any]) -> PretrainConfig:
    """What :func:`config_to_json` wrote.

    Raises:
        ValueError: if an entry is missing or unknown.
    """
    try:
        settings = dict(plain["method"])
        kind = FORMS[settings.pop("name")].settings
        data = plain["data"]
        nested = {"method": from_plain(kind, settings), "mix": from_plain(Mix, plain["mix"])}
        path = None if data is None else Path(data)
        return from_plain(PretrainConfig, WHEN_GIVEN | plain | nested | {"data": path})
    except (KeyError, TypeError) as error:
        raise ValueError(f"not the configuration of a run: {error}") from error
