"""One run of Algorithm 2 (or of a baseline) in a folder, resumable at any moment.

    for each step:
        a_task ~ pi_task(s);  a = a_task, or the recovery action where Q_c(s, a_task) >= epsilon
        execute a;  store (s, a_task, s', r)
        every ``steps_per_update`` steps: update pi_task on a minibatch

The folder holds ``config.json``, ``progress.csv`` (training), ``evaluations.csv``,
``checkpoint.safetensors`` with the replay buffer beside it, and at the end ``policies/``,
``filters/`` and ``result.json``, whose presence says that the run is finished. Noise,
minibatches and environments are functions of seed and step, so a run that was killed ends
as if nothing had happened (tasks with "real:" or "gym:" excepted: they begin new episodes).
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from deep.data.normalisation import Normalisation, TensorNormalisation, with_action_bounds
from deep.filter.task_policy import TrainedPolicy
from deep.pretraining import Learner, form_of
from deep.pretraining.run import read_run
from deep.runs.checkpoint import load_checkpoint, save_checkpoint
from deep.runs.folder import CsvLog, InterruptAfterUpdate, check_folder, only_process, open_folder
from deep.tasks.task import Sizes
from deep.tasks.vectorised import Fleet
from deep.train.config import (
    TrainConfig,
    build_task_learner,
    task_method_name,
    train_config_to_json,
)
from deep.train.correction import FinetunedCorrection
from deep.train.counts import Counts
from deep.train.learner import TaskLearner, TaskLosses
from deep.train.noise import ActionNoise
from deep.train.pretrained import build_correction
from deep.train.replay import Arrival, Replay
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

__all__ = ["method_of", "train"]

PROGRESS = (
    "step", "seed", "episodes", "violations", "interventions", "return", "length",
    "critic_loss", "policy_loss", "seconds",
)  # fmt: skip


def train(config: TrainConfig, folder: Path, *, quiet: bool = False) -> TrainResult:
    """Train, or go on training, in this folder; a finished run is only read.

    An interrupt (Ctrl-C) is passed on after the step at work and a checkpoint.

    Raises:
        ValueError: for a folder with another run, or another process at work, or a pretraining
            that does not fit.
        FloatingPointError: if a loss is not a number; the last checkpoint stays.
    """
    with only_process(folder):
        check_folder(folder, train_config_to_json(config))
        if not (folder / "result.json").exists():
            run = _Run(config, folder)
            try:
                run.train(quiet)
                run.finish()
            finally:
                run.fleet.close()
        return read_result(folder)


def method_of(config: TrainConfig) -> str:
    """The run's name in the tables: the correction's form, or the task learner's."""
    if config.safety is None:
        return task_method_name(config.method)
    return form_of(read_run(config.safety).method).name


class _State(nn.Module):
    """All networks and optimizers of a run, as one checkpoint sees them."""

    def __init__(self, learners: list[TaskLearner | Learner]) -> None:
        super().__init__()
        self.learners = nn.ModuleList(learners)
        self.optimizers = tuple(o for learner in learners for o in learner.optimizers)


class _Run:
    """Everything that a run holds between two steps."""

    def __init__(self, config: TrainConfig, folder: Path) -> None:
        self.config = config
        self.folder = folder
        self.method = method_of(config)
        self.fleet = Fleet(config.task, config.seeds, config.copies, config.rules)
        sizes = Sizes(self.fleet.observation_dim, self.fleet.action_dim)
        self.learner = build_task_learner(config, sizes)
        # Actions are kept in the environment's units; the learner's fill [-1, 1].
        self.bounds = self.fleet.action_bounds
        identity = with_action_bounds(Normalisation.identity(*sizes), self.bounds)
        self.units = TensorNormalisation([identity] * len(config.seeds))
        self.correction = build_correction(config, sizes, self.bounds)
        # Of the task policy; known after the start phase.
        self.normalisation: TensorNormalisation | None = None
        learners: list[TaskLearner | Learner] = [self.learner]
        if isinstance(self.correction, FinetunedCorrection):
            learners.append(self.correction.learner)
        self.state = _State(learners)
        open_folder(folder, train_config_to_json(config))  # only now: everything fits
        checkpoint, replay = folder / "checkpoint.safetensors", folder / "replay.bin"
        if checkpoint.exists() and not replay.exists():
            raise ValueError(f"{replay}: the run cannot go on without its replay buffer")
        self.replay = Replay(
            replay,
            config.seeds,
            config.copies,
            config.replay // config.copies,
            config.checkpoint_every // config.copies,
            *sizes,
        )
        self.counts = Counts.zero(len(config.seeds), config.copies)
        self.updates = 0
        self.step = 0
        self.actions = ActionNoise(config.seeds, config.copies, sizes.action)
        self.observation = self._resume(checkpoint) if checkpoint.exists() else self.fleet.reset()
        done = self.step * config.copies
        self.progress = CsvLog(folder / "progress.csv", PROGRESS, done)
        self.evaluations = CsvLog(folder / "evaluations.csv", EVALUATIONS, done)

    def train(self, quiet: bool) -> None:
        """All steps that are left."""
        config = self.config
        total = config.steps // config.copies
        bar = tqdm(
            total=config.steps, initial=self.step * config.copies, unit="step", disable=quiet,
            desc=f"{config.task} {self.folder.name}",
        )  # fmt: skip
        before, begin = self.counts.seconds, time.perf_counter()
        latest: TaskLosses | None = None
        with bar, InterruptAfterUpdate() as interrupt:
            while self.step < total:
                losses = self.advance()
                latest = losses or latest
                bar.update(config.copies)
                self.counts.seconds = before + time.perf_counter() - begin
                stop = interrupt.asked  # read once: it may be set at any moment
                done = self.step * config.copies
                if done % config.log_every == 0 or self.step == total:
                    self._log(done, losses)
                if done % config.evaluate_every == 0 and self.normalisation:
                    self._checked(done, latest)
                    self._log_evaluation(done)
                if done % config.checkpoint_every == 0 or stop or self.step == total:
                    self._checked(done, latest)
                    self._save()
                if stop:
                    raise KeyboardInterrupt

    def advance(self) -> TaskLosses | None:
        """One step of every copy, and the updates that are due after it."""
        config = self.config
        noise, uniform = self.actions.draw(self.step)
        begun = self.step * config.copies < config.start_steps
        action = self._start(uniform) if begun else self._propose(noise)
        executed, intervened = self.correction.correct(self.observation, action)
        arrived = self.fleet.step(executed)
        self.replay.add(
            self.step,
            Arrival(
                self.observation, action, executed, arrived.last,
                arrived.reward, arrived.cost, arrived.terminal, arrived.timeout,
            ),
        )  # fmt: skip
        self.observation = arrived.observation
        self.counts.add(arrived, intervened)
        self.step += 1
        steps = self.step * config.copies
        if self.normalisation is None and steps >= config.start_steps:
            seen = self.replay.normalisation(self.step)
            self.normalisation = TensorNormalisation(
                [with_action_bounds(n, self.bounds) for n in seen]
            )
            self.learner.look(partial(self.replay.normalisation, self.step))
        due = max(0, steps - config.start_steps) // config.steps_per_update
        losses = None
        while self.updates < due:
            losses = self._update()
        return losses

    def _start(self, uniform: NDArray[np.float32]) -> NDArray[np.float32]:
        return self.units.raw_action(torch.from_numpy(uniform)).numpy()

    def _propose(self, noise: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.no_grad():
            action = self._act(torch.from_numpy(self.observation), torch.from_numpy(noise))
        return action.numpy()

    def _act(self, observation: Tensor, noise: Tensor) -> Tensor:
        """The task policy's actions, in the environment's units, in raw observations (K, B, o)."""
        assert self.normalisation is not None
        action, _ = self.learner.policy.sample(self.normalisation.observation(observation), noise)
        return self.normalisation.raw_action(action)

    def _update(self) -> TaskLosses:
        assert self.normalisation is not None
        config = self.config
        raw = self.replay.sample(self.updates, self.step, config.method.batch_size)
        self.learner.slow_down(self.step * config.copies / config.steps)
        losses = self.learner.update(
            raw._replace(
                observation=self.normalisation.observation(raw.observation),
                next_observation=self.normalisation.observation(raw.next_observation),
                action=self.normalisation.action(raw.action),
                executed=self.normalisation.action(raw.executed),
            )
        )
        self.correction.learn(self.updates, raw, self._act)
        self.updates += 1
        return losses

    def _checked(self, done: int, losses: TaskLosses | None) -> list[list[str]]:
        """Every seed's losses as they are written down."""
        return [
            checked_losses(seed, k, losses, f"step {done}")
            for k, seed in enumerate(self.config.seeds)
        ]

    def _log(self, done: int, losses: TaskLosses | None) -> None:
        shown, seconds = self._checked(done, losses), f"{self.counts.seconds:.1f}"
        self.progress.write(
            (done, seed, *self.counts.row(k, done), *shown[k], seconds)
            for k, seed in enumerate(self.config.seeds)
        )
        self.counts.begin_row(done)

    def _log_evaluation(self, done: int) -> None:
        config = self.config
        found = evaluate(
            config.task, self.policies(), self.correction.filters(), config.evaluation_episodes,
            EPISODES_KEPT_APART, config.rules,
        )  # fmt: skip
        self.evaluations.write(evaluation_rows(done, config.seeds, found))

    def policies(self) -> tuple[TrainedPolicy, ...]:
        """Every seed's task policy of the moment."""
        assert self.normalisation is not None
        return task_policies(self.learner, self.normalisation.of_seeds, self.method)

    def finish(self) -> None:
        """Evaluate, write policies and filters, say what came out, forget the replay buffer."""
        config, counts = self.config, self.counts
        policies, filters = self.policies(), self.correction.filters()
        found = evaluate(config.task, policies, filters, config.episodes, rules=config.rules)
        save_all(self.folder / "policies", config.seeds, policies)
        save_all(self.folder / "filters", config.seeds, filters)
        thresholds = [f.threshold for f in filters] or self.learner.limits
        seeds = [
            SeedResult.of(
                seed,
                evaluated,
                tv=int(counts.violations[k]),
                episodes=int(counts.episodes[k]),
                training_arr=float(counts.interventions[k] / config.steps),
                threshold=thresholds[k] if thresholds else None,
            )
            for k, (seed, evaluated) in enumerate(zip(config.seeds, found, strict=True))
        ]
        budget = Budget(config.steps, self.updates, round(counts.seconds, 1), config.episodes)
        write_result(self.folder, config.task, self.method, budget, seeds)
        if not config.keep_replay:
            self.replay.path.unlink()

    def _save(self) -> None:
        rest = {
            "step": self.step,
            "counts": self.counts.to_json(),
            "normalisation": self.normalisation
            and [asdict(n) for n in self.normalisation.of_seeds],
            "environments": self.fleet.snapshot(),
            "actions": asdict(self.bounds),
        }
        path = self.folder / "checkpoint.safetensors"
        self.replay.flush()
        save_checkpoint(self.state, self.updates, path, json.dumps(rest))

    def _resume(self, checkpoint: Path) -> NDArray[np.float32]:
        self.updates, text = load_checkpoint(self.state, checkpoint)
        rest = json.loads(text)
        if rest.get("actions") != json.loads(json.dumps(asdict(self.bounds))):
            raise ValueError(
                f"{checkpoint}: its actions are not in the environment's units, within "
                f"{self.bounds}: another version or environment made it; begin in a new folder"
            )
        self.step = rest["step"]
        self.counts = Counts.from_json(rest["counts"])
        if rest["normalisation"]:
            self.normalisation = TensorNormalisation(
                [Normalisation.from_json(n) for n in rest["normalisation"]]
            )
        if rest["environments"] is None:
            self.counts.running_return[:] = self.counts.running_length[:] = 0
            self.replay.cut(self.step)
            return self.fleet.reset(self.step)
        return self.fleet.restore(rest["environments"])
