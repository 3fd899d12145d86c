"""One run of Algorithm 2 (or of a baseline) in a folder, resumable at any moment.

    for each step:
        a_task ~ pi_task(s);  a = a_task, or the recovery action where Q_c(s, a_task) >= epsilon
        execute a;  store (s, a_task, s', r)
        every ``steps_per_update`` steps: update pi_task on a minibatch

The folder holds ``config.json``, ``progress.csv`` (training), ``evaluations.csv``,
``checkpoint.safetensors`` with the replay buffer beside it, and at the end ``policies/``,
``filters/`` and ``result.json``, whose presence says that the run is finished. Noise,
minibatches and environments are functions of seed and step, so a run that was killed ends
as if nothing had happened (Safety-Gymnasium's own tasks excepted: they begin new episodes).
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from tqdm import tqdm

from dead_ends.io.atomic import atomic_path
from deep.checkpoint import load_checkpoint, save_checkpoint
from deep.folder import CsvLog, InterruptAfterUpdate, versions
from deep.online.config import (
    TrainConfig,
    build_task_learner,
    task_method_name,
    train_config_from_json,
    train_config_to_json,
)
from deep.online.counts import Counts
from deep.online.episodes import Episodes, run_episodes
from deep.online.fleet import REAL, Fleet
from deep.online.gate import FinetunedGate
from deep.online.learner import TaskLearner, TaskLosses
from deep.online.noise import ActionNoise
from deep.online.pretrained import build_gate
from deep.online.replay import Arrival, Replay, normalised
from deep.pretrain import Learner, method_name
from deep.pretrain.learner import Sizes
from deep.run import read_run
from deep.safety_filter import Normalisation, SafetyFilter
from deep.task_policy import TrainedPolicy

__all__ = ["TrainResult", "train"]

REAL_COPIES = 4
PROGRESS = (
    "step", "seed", "episodes", "violations", "interventions", "return", "length",
    "critic_loss", "policy_loss", "seconds",
)  # fmt: skip
EVALUATIONS = ("step", "seed", "episodes", "acr", "avr", "arr", "length")
EPISODES_KEPT_APART = 1000
"""Evaluations during training draw other episodes than the one at the end."""


@dataclass(frozen=True)
class TrainResult:
    """What a finished run says.

    Attributes:
        folder: where it is.
        method: as in the tables: sac, wcsac, or the form of the correction.
        seeds: one entry a seed, as in ``result.json``.
    """

    folder: Path
    method: str
    seeds: tuple[dict[str, Any], ...]


def train(config: TrainConfig, folder: Path, *, quiet: bool = False) -> TrainResult:
    """Train, or go on training, in this folder; a finished run is only read.

    An interrupt (Ctrl-C) is passed on after the step at work and a checkpoint.

    Raises:
        ValueError: for a folder with another run, or a pretraining that does not fit.
        FloatingPointError: if a loss is not a number; the last checkpoint stays.
    """
    _open_folder(config, folder)
    result = folder / "result.json"
    if not result.exists():
        run = _Run(config, folder)
        try:
            run.train(quiet)
            run.finish()
        finally:
            run.fleet.close()
    content = json.loads(result.read_text())
    return TrainResult(folder, content["method"], tuple(content["seeds"]))


def method_of(config: TrainConfig) -> str:
    """The run's name in the tables: the correction's form, or the task learner's."""
    if config.safety is None:
        return task_method_name(config.method)
    return method_name(read_run(config.safety).method)


def _open_folder(config: TrainConfig, folder: Path) -> None:
    path = folder / "config.json"
    plain = train_config_to_json(config)
    if path.exists():
        if train_config_from_json(json.loads(path.read_text())["run"]) != config:
            raise ValueError(f"{folder} holds a run with another configuration")
        return
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"run": plain, "made with": versions()}, indent=2) + "\n")


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
        self.fleet = Fleet(config.task, config.seeds, config.copies)
        sizes = Sizes(self.fleet.observation_dim, self.fleet.action_dim)
        self.learner = build_task_learner(config, sizes)
        self.gate, self.normalisation = build_gate(config, sizes)
        learners: list[TaskLearner | Learner] = [self.learner]
        if isinstance(self.gate, FinetunedGate):
            learners.append(self.gate.learner)
        self.state = _State(learners)
        self.replay = Replay(
            folder / "replay.bin",
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
        checkpoint = folder / "checkpoint.safetensors"
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
        with bar, InterruptAfterUpdate() as interrupt:
            while self.step < total:
                losses = self.advance()
                bar.update(config.copies)
                self.counts.seconds = before + time.perf_counter() - begin
                stop = interrupt.asked  # read once: it may be set at any moment
                done = self.step * config.copies
                if done % config.log_every == 0:
                    self._log(done, losses)
                if done % config.evaluate_every == 0 and self.normalisation:
                    self._log_evaluation(done)
                if done % config.checkpoint_every == 0 or stop or self.step == total:
                    self._save()
                if stop:
                    raise KeyboardInterrupt

    def advance(self) -> TaskLosses | None:
        """One step of every copy, and the updates that are due after it."""
        config = self.config
        noise, uniform = self.actions.draw(self.step)
        begun = self.step * config.copies < config.start_steps
        action = uniform if begun else self._propose(noise)
        executed, intervened = self.gate.correct(self.observation, action)
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
        if not self.normalisation and steps >= config.start_steps:
            self.normalisation = self.replay.normalisation(self.step)
        due = max(0, steps - config.start_steps) // config.steps_per_update
        losses = None
        while self.updates < due:
            losses = self._update()
        return losses

    def _propose(self, noise: NDArray[np.float32]) -> NDArray[np.float32]:
        s = torch.from_numpy(normalised(self.observation, self.normalisation))
        with torch.no_grad():
            action, _ = self.learner.policy.sample(s, torch.from_numpy(noise))
        return action.numpy()

    def _update(self) -> TaskLosses:
        batch = self.replay.sample(
            self.updates, self.step, self.config.method.batch_size, self.normalisation
        )
        self.learner.slow_down(self.step * self.config.copies / self.config.steps)
        losses = self.learner.update(batch)
        self.gate.learn(self.updates, batch, self.learner.policy)
        self.updates += 1
        return losses

    def _log(self, done: int, losses: TaskLosses | None) -> None:
        rows = []
        for k, seed in enumerate(self.config.seeds):
            numbers = [float(loss[k]) for loss in losses] if losses else [None, None]
            if any(x is not None and not np.isfinite(x) for x in numbers):
                raise FloatingPointError(
                    f"step {done}: a loss of seed {seed} is not a number; "
                    "try a smaller learning rate"
                )
            shown = ("" if x is None else f"{x:.6g}" for x in numbers)
            rows.append(
                (done, seed, *self.counts.row(k, done), *shown, f"{self.counts.seconds:.1f}")
            )
        self.progress.write(rows)
        self.counts.begin_row(done)

    def _log_evaluation(self, done: int) -> None:
        episodes = self.evaluate(self.config.evaluation_episodes, EPISODES_KEPT_APART)
        self.evaluations.write(
            (done, seed, len(e.returns), *(f"{x:.6g}" for x in (e.acr, e.avr, e.arr, e.length)))
            for seed, e in zip(self.config.seeds, episodes, strict=True)
        )

    def evaluate(self, episodes: int, stream: int) -> list[Episodes]:
        """Whole episodes of every seed's mean policy behind the filter of the moment."""
        filters = self.gate.filters() or (None,) * len(self.config.seeds)
        copies = REAL_COPIES if self.config.task.startswith(REAL) else None
        return [
            run_episodes(
                self.config.task, policy.act, safety, episodes, policy.seed + stream, copies
            )
            for policy, safety in zip(self.policies(), filters, strict=True)
        ]

    def policies(self) -> tuple[TrainedPolicy, ...]:
        """Every seed's task policy of the moment."""
        mlp, seeds = self.learner.policy.mlp, self.config.seeds
        return tuple(
            TrainedPolicy(
                tuple(
                    (w[k].detach().numpy().copy(), b[k, 0].detach().numpy().copy())
                    for w, b in zip(mlp.weights, mlp.biases, strict=True)
                ),
                normalisation,
                self.method,
                seed,
            )
            for k, (seed, normalisation) in enumerate(zip(seeds, self.normalisation, strict=True))
        )

    def finish(self) -> None:
        """Evaluate, write policies and filters, say what came out, forget the replay buffer."""
        config, counts = self.config, self.counts
        episodes = self.evaluate(config.episodes, 0)
        filters = self.gate.filters()
        _save_all(self.folder / "policies", config.seeds, self.policies())
        _save_all(self.folder / "filters", config.seeds, filters)
        seeds = [
            {
                "seed": seed,
                "tv": int(counts.violations[k]),
                "episodes": int(counts.episodes[k]),
                "acr": e.acr,
                "avr": e.avr,
                "arr": e.arr,
                "length": e.length,
                "training_arr": float(counts.interventions[k] / config.steps),
                "threshold": filters[k].threshold if filters else None,
            }
            for k, (seed, e) in enumerate(zip(config.seeds, episodes, strict=True))
        ]
        content = {
            "task": config.task,
            "method": self.method,
            "budget": {
                "env_steps": config.steps,
                "updates": self.updates,
                "wall_seconds": round(counts.seconds, 1),
                "evaluation_episodes": config.episodes,
            },
            "seeds": seeds,
            "made with": versions(),
        }
        with atomic_path(self.folder / "result.json") as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n")
        if not config.keep_replay:
            self.replay.path.unlink()

    def _save(self) -> None:
        rest = {
            "step": self.step,
            "counts": self.counts.to_json(),
            "normalisation": [asdict(n) for n in self.normalisation],
            "environments": self.fleet.snapshot(),
        }
        path = self.folder / "checkpoint.safetensors"
        self.replay.flush()
        save_checkpoint(self.state, self.updates, path, json.dumps(rest))

    def _resume(self, checkpoint: Path) -> NDArray[np.float32]:
        self.updates, text = load_checkpoint(self.state, checkpoint)
        rest = json.loads(text)
        self.step = rest["step"]
        self.counts = Counts.from_json(rest["counts"])
        self.normalisation = tuple(Normalisation.from_json(n) for n in rest["normalisation"])
        if rest["environments"] is None:
            self.counts.running_return[:] = self.counts.running_length[:] = 0
            return self.fleet.reset()
        return self.fleet.restore(rest["environments"])


def _save_all(
    folder: Path, seeds: tuple[int, ...], made: Sequence[TrainedPolicy | SafetyFilter]
) -> None:
    """One file a seed; no folder where there is nothing."""
    if not made:
        return
    folder.mkdir(exist_ok=True)
    for seed, one in zip(seeds, made, strict=True):
        one.save(folder / f"seed{seed}.safetensors")
