"""One run of an offline baseline in a folder: from a file of transitions to task policies.

The folder is that of an online run, without a replay buffer and filters; ``step`` in its
tables counts updates, since there are no environment steps. Every update is a function of
the state before it and of its number, so a run that was killed ends as if nothing had
happened.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro
from tqdm import tqdm

from deep.data.formats import read_hdf5
from deep.data.minibatches import Batches
from deep.data.normalisation import (
    Normalisation,
    normalisation_of_observations,
    normalise,
    ranges_of,
    with_action_bounds,
)
from deep.data.transitions import Transitions
from deep.runs.checkpoint import load_checkpoint, save_checkpoint
from deep.runs.folder import (
    CsvLog,
    InterruptAfterUpdate,
    check_folder,
    fingerprint,
    only_process,
    open_folder,
)
from deep.tasks.bounds import Bounds
from deep.tasks.gym import NO_RULES, Rules
from deep.tasks.task import Sizes
from deep.tasks.vectorised import GYM, check_fit, task_spaces
from deep.tasks.violation import check_rule
from deep.train.iql import Iql, IqlSettings
from deep.train.learner import TaskBatch, TaskLosses
from deep.train.result import (
    EPISODES_KEPT_APART,
    EVALUATIONS,
    Budget,
    SeedResult,
    TrainResult,
    checked_losses,
    evaluate,
    evaluation_rows,
    read_result,
    save_all,
    task_policies,
    write_result,
)

__all__ = ["OfflineConfig", "task_batch", "train_offline"]

PROGRESS = ("step", "seed", "critic_loss", "policy_loss", "seconds")


@dataclass(frozen=True)
class OfflineConfig:
    """One run of IQL: K seeds on one data set.

    Attributes:
        task: where the policies are evaluated, as in training online ("real:", "gym:").
        data: an HDF5 file of transitions.
        rules: what an environment of "gym:" leaves open; ``violation`` is of the data too, if
            nothing else is said of them.
        data_violation: which of the file's costs are a violation, where that is another question
            than the environment's, which may report none.
        cut: end the file's episodes at every violation, see
            :func:`deep.data.transitions.cut_at_violation`.
        method: the learner's settings.
        seeds: trained side by side; seed k alone gives the same.
        updates: minibatch updates.
        evaluate_every: updates between two evaluations during training.
        evaluation_episodes: whole episodes of each of those.
        episodes: whole episodes of the evaluation at the end.
        log_every: updates between two rows of progress.csv.
        checkpoint_every: updates between two checkpoints.
    """

    task: str
    data: Path
    rules: Annotated[Rules, tyro.conf.arg(name="")] = NO_RULES
    data_violation: str | None = None
    cut: bool = False
    method: IqlSettings = field(default_factory=IqlSettings)
    seeds: tuple[int, ...] = (0,)
    updates: int = 100_000
    evaluate_every: int = 10_000
    evaluation_episodes: int = 20
    episodes: int = 500
    log_every: int = 1000
    checkpoint_every: int = 10_000

    def __post_init__(self) -> None:
        rhythms = ("evaluate_every", "evaluation_episodes", "log_every", "checkpoint_every")
        for name in ("updates", "episodes", *rhythms):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        check_rule(self.data_violation)

    @property
    def violation_in_data(self) -> str | None:
        """Which of the file's costs are a violation; None: they are 0 or 1."""
        return self.rules.violation if self.data_violation is None else self.data_violation

    @property
    def environment_rules(self) -> Rules:
        """Those of the environment: that of the data's violations only where it is of "gym:"."""
        return self.rules if self.task.startswith(GYM) else replace(self.rules, violation=None)

    def to_json(self) -> dict[str, Any]:
        """Plain values; the method by its name and settings, rules only where there are some."""
        plain = asdict(self)
        defaults = (("rules", asdict(NO_RULES)), ("cut", False), ("data_violation", None))
        for name, default in defaults:
            if plain[name] == default:
                del plain[name]
        plain["data"] = str(self.data)
        plain["method"] = {"name": Iql.name, **plain["method"]}
        return plain


def train_offline(config: OfflineConfig, folder: Path, *, quiet: bool = False) -> TrainResult:
    """Train, or go on training, in this folder; a finished run is only read.

    An interrupt (Ctrl-C) is passed on after the update at work and a checkpoint.

    Raises:
        ValueError: for a folder with another run, or another process at work, or data that do
            not fit the task.
        FloatingPointError: if a loss is not a number; the last checkpoint stays.
    """
    with only_process(folder):
        data = fingerprint(config.data)
        check_folder(folder, config.to_json(), data)
        if not (folder / "result.json").exists():
            run = _Run(config, folder, data)
            run.train(quiet)
            run.finish()
        return read_result(folder)


def task_batch(batches: Batches, update: int) -> TaskBatch:
    """The minibatch of this update, with rewards; what was done is what was meant."""
    batch = batches.get(update)
    return TaskBatch(
        observation=batch.observation,
        action=batch.action,
        executed=batch.action,
        next_observation=batch.next_observation,
        reward=batches.rewards(update),
        cost=batch.cost,
        terminal=batch.terminal,
        noise=batch.noise,
        next_noise=batch.next_noise,
    )


class _Run:
    """Everything that a run holds between two updates."""

    def __init__(self, config: OfflineConfig, folder: Path, known: str | None) -> None:
        self.config = config
        self.folder = folder
        sizes, bounds = task_spaces(config.task, config.environment_rules)
        data = read_hdf5(config.data, cut=config.cut, violation=config.violation_in_data)
        _check_fit(config, data, sizes, bounds)
        seen = normalisation_of_observations(data.observations, sizes.action)
        self.normalisation = with_action_bounds(seen, bounds)
        self.batches = Batches(
            [normalise(data, self.normalisation)],
            config.seeds,
            config.method.batch_size,
            None,
            torch.device("cpu"),
        )
        self.learner = Iql(config.method, sizes, config.seeds)
        open_folder(folder, config.to_json(), known)  # only now: everything fits
        self.updates, self.seconds = 0, 0.0
        self.checkpoint = folder / "checkpoint.safetensors"
        if self.checkpoint.exists():
            self.updates, rest = load_checkpoint(self.learner, self.checkpoint)
            self.seconds = json.loads(rest)["seconds"]
        self.progress = CsvLog(folder / "progress.csv", PROGRESS, self.updates)
        self.evaluations = CsvLog(folder / "evaluations.csv", EVALUATIONS, self.updates)

    def train(self, quiet: bool) -> None:
        """All updates that are left."""
        config = self.config
        bar = tqdm(
            total=config.updates, initial=self.updates, unit="", disable=quiet,
            desc=f"{config.task} {self.folder.name}",
        )  # fmt: skip
        before, begin = self.seconds, time.perf_counter()
        with bar, InterruptAfterUpdate() as interrupt:
            while self.updates < config.updates:
                self.learner.slow_down(self.updates / config.updates)
                losses = self.learner.update(task_batch(self.batches, self.updates))
                self.updates += 1
                bar.update()
                self.seconds = before + time.perf_counter() - begin
                stop = interrupt.asked  # read once: it may be set at any moment
                if self.updates % config.log_every == 0:
                    self._log(losses)
                if self.updates % config.evaluate_every == 0:
                    self._log_evaluation(losses)
                last = stop or self.updates == config.updates
                if self.updates % config.checkpoint_every == 0 or last:
                    self._save(losses)
                if stop:
                    raise KeyboardInterrupt

    def _checked(self, losses: TaskLosses) -> list[list[str]]:
        """Every seed's losses as they are written down."""
        return [
            checked_losses(seed, k, losses, f"update {self.updates}")
            for k, seed in enumerate(self.config.seeds)
        ]

    def _log(self, losses: TaskLosses) -> None:
        shown, seconds = self._checked(losses), f"{self.seconds:.1f}"
        self.progress.write(
            (self.updates, seed, *shown[k], seconds) for k, seed in enumerate(self.config.seeds)
        )

    def _save(self, losses: TaskLosses) -> None:
        self._checked(losses)
        rest = json.dumps({"seconds": self.seconds})
        save_checkpoint(self.learner, self.updates, self.checkpoint, rest)

    def _log_evaluation(self, losses: TaskLosses) -> None:
        config = self.config
        self._checked(losses)
        policies = task_policies(self.learner, self._normalisations(), Iql.name)
        found = evaluate(
            config.task, policies, (), config.evaluation_episodes, EPISODES_KEPT_APART,
            config.environment_rules,
        )  # fmt: skip
        self.evaluations.write(evaluation_rows(self.updates, config.seeds, found))

    def _normalisations(self) -> tuple[Normalisation, ...]:
        return (self.normalisation,) * len(self.config.seeds)

    def finish(self) -> None:
        """Evaluate, write the policies, say what came out."""
        config = self.config
        policies = task_policies(self.learner, self._normalisations(), Iql.name)
        rules = config.environment_rules
        found = evaluate(config.task, policies, (), config.episodes, rules=rules)
        save_all(self.folder / "policies", config.seeds, policies)
        budget = Budget(0, self.updates, round(self.seconds, 1), config.episodes)
        seeds = [
            SeedResult.of(seed, e, tv=0, episodes=0, training_arr=0.0)
            for seed, e in zip(config.seeds, found, strict=True)
        ]
        write_result(self.folder, config.task, Iql.name, budget, seeds)


def _check_fit(config: OfflineConfig, data: Transitions, sizes: Sizes, bounds: Bounds) -> None:
    found = Sizes(data.observations.shape[1], data.actions.shape[1])
    check_fit(f"{config.data}:", found, config.task, sizes)
    try:
        ranges_of(data, bounds)
    except ValueError as error:
        raise ValueError(f"{config.data}: {error} of {config.task}") from error
