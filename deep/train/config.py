"""What an online run is, as plain numbers that are written beside its results."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro

from deep.runs.folder import from_plain
from deep.tasks.gym import NO_RULES, Rules, rules_from_json
from deep.tasks.task import Sizes
from deep.train.learner import TaskLearner, TaskSettings
from deep.train.sac import Sac, SacSettings
from deep.train.wcsac import Wcsac, WcsacSettings

__all__ = [
    "TaskMethod",
    "TrainConfig",
    "build_task_learner",
    "task_method_name",
    "train_config_from_json",
    "train_config_to_json",
]

TaskMethod: TypeAlias = (
    Annotated[SacSettings, tyro.conf.subcommand("sac")]
    | Annotated[WcsacSettings, tyro.conf.subcommand("wcsac")]
)
LEARNERS: dict[str, type[SacSettings]] = {Sac.name: SacSettings, Wcsac.name: WcsacSettings}


@dataclass(frozen=True)
class TrainConfig:
    """One run of Algorithm 2, or of a baseline: K seeds of one method on one task.

    Without ``safety`` nothing is corrected (SAC, WCSAC). With it the task policy learns
    behind the safety critic and recovery policy of a pretraining run: frozen, or finetuned.

    Attributes:
        task: the name of a task; "real:" before it means Safety-Gymnasium's own, "gym:" any
            Gymnasium environment of that id.
        rules: what an environment of "gym:" leaves open.
        method: the task policy's learner, with its settings.
        safety: the folder of a pretraining run.
        safety_seeds: whose filters the seeds use; None: each seed its own.
        threshold: epsilon, one for all seeds or one each; None: the pretraining's.
        finetune: go on learning critic and recovery policy; None: where RRL does.
        seeds: trained side by side; seed k alone gives the same.
        steps: environment steps of each seed.
        copies: parallel environments of each seed.
        start_steps: steps with uniform random actions before the first update.
        steps_per_update: environment steps between two updates.
        replay: transitions of each seed that are remembered.
        evaluate_every: steps between two evaluations during training.
        evaluation_episodes: whole episodes of each of those.
        episodes: whole episodes of the evaluation at the end.
        log_every: steps between two rows of progress.csv.
        checkpoint_every: steps between two checkpoints.
        keep_replay: leave the replay buffer's file in the folder at the end.
    """

    task: str
    rules: Annotated[Rules, tyro.conf.arg(name="")] = NO_RULES
    method: TaskMethod = field(default_factory=SacSettings)
    safety: Path | None = None
    safety_seeds: tuple[int, ...] | None = None
    threshold: tuple[float, ...] | None = None
    finetune: bool | None = None
    seeds: tuple[int, ...] = (0,)
    steps: int = 1_000_000
    copies: int = 10
    start_steps: int = 10_000
    steps_per_update: int = 10
    replay: int = 1_000_000
    evaluate_every: int = 50_000
    evaluation_episodes: int = 20
    episodes: int = 500
    log_every: int = 10_000
    checkpoint_every: int = 100_000
    keep_replay: bool = False

    def __post_init__(self) -> None:
        counts = ("steps", "copies", "start_steps", "steps_per_update", "replay", "episodes")
        rhythms = ("evaluate_every", "evaluation_episodes", "log_every", "checkpoint_every")
        for name in (*counts, *rhythms):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        for name in ("steps", "start_steps", "replay", *rhythms[0::2], "checkpoint_every"):
            if getattr(self, name) % self.copies:
                raise ValueError(
                    f"{name} must be a multiple of copies ({self.copies}), "
                    f"not {getattr(self, name)}"
                )
        if self.start_steps > self.steps:
            raise ValueError(
                f"start_steps ({self.start_steps}) must not exceed steps ({self.steps})"
            )
        if self.method.batch_size < 2:
            raise ValueError("batch_size must be at least 2: finetuning halves it")
        if self.safety is None and (self.threshold, self.safety_seeds, self.finetune) != (
            None,
            None,
            None,
        ):
            raise ValueError("threshold, safety_seeds and finetune need a pretraining run: safety")
        if self.safety_seeds is not None and len(self.safety_seeds) != len(self.seeds):
            raise ValueError(f"{len(self.safety_seeds)} safety_seeds for {len(self.seeds)} seeds")
        if self.threshold is not None and len(self.threshold) not in (1, len(self.seeds)):
            raise ValueError(
                f"{len(self.threshold)} thresholds for {len(self.seeds)} seeds: give one, "
                "or one each"
            )

    def with_threshold(self, threshold: float) -> TrainConfig:
        """With this epsilon behind a correction, or this cost limit of WCSAC."""
        if self.safety is None and isinstance(self.method, WcsacSettings):
            return replace(self, method=replace(self.method, cost_limit=(threshold,)))
        return replace(self, threshold=(threshold,))

    @property
    def thresholds(self) -> tuple[float, ...] | None:
        """epsilon of each seed."""
        if self.threshold is None or len(self.threshold) == len(self.seeds):
            return self.threshold
        return self.threshold * len(self.seeds)


def build_task_learner(config: TrainConfig, sizes: Sizes) -> TaskLearner:
    """The learner that the configuration names, freshly initialised."""
    match config.method:
        case WcsacSettings():  # before SacSettings, which it extends
            return Wcsac(config.method, sizes, config.seeds)
        case SacSettings():
            return Sac(config.method, sizes, config.seeds)


def task_method_name(settings: TaskSettings) -> str:
    """The learner's name on the command line."""
    return next(name for name, kind in LEARNERS.items() if type(settings) is kind)


def train_config_to_json(config: TrainConfig) -> dict[str, Any]:
    """Plain values; the method by its name and settings, rules only where there are some."""
    plain = asdict(config)
    if config.rules == NO_RULES:
        del plain["rules"]
    plain["safety"] = None if config.safety is None else str(config.safety)
    plain["method"] = {"name": task_method_name(config.method), **plain["method"]}
    return plain


def train_config_from_json(plain: dict[str, Any]) -> TrainConfig:
    """What :func:`train_config_to_json` wrote.

    Raises:
        ValueError: if an entry is missing or unknown.
    """
    try:
        settings = dict(plain["method"])
        kind = LEARNERS[settings.pop("name")]
        safety = None if plain["safety"] is None else Path(plain["safety"])
        nested = {"method": from_plain(kind, settings), "rules": rules_from_json(plain)}
        return from_plain(TrainConfig, plain | nested | {"safety": safety})
    except (KeyError, TypeError) as error:
        raise ValueError(f"not the configuration of a run: {error}") from error
