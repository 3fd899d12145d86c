"""The commands around task policies: training, online and offline, and evaluation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from deep.data import summarise
from deep.formats import write_hdf5
from deep.online.choose import choose_threshold, read_threshold, write_choice
from deep.online.config import TrainConfig
from deep.online.offline import OfflineConfig, train_offline
from deep.online.offline_data import offline_data, training_run
from deep.online.plug import evaluate_policies
from deep.online.train import train
from deep.online.wcsac import WcsacSettings

__all__ = ["ChooseThreshold", "Evaluate", "OfflineData", "Train", "TrainOffline", "seed_lines"]


def seed_lines(seeds: Iterable[dict[str, Any]]) -> Iterable[str]:
    """One line a seed of a result."""
    for entry in seeds:
        violations = "" if entry["tv"] is None else f", {entry['tv']} violations in training"
        yield (
            f"seed {entry['seed']}: ACR {entry['acr']:.3f}, AVR {entry['avr']:.3f}, "
            f"ARR {entry['arr']:.3f}{violations}"
        )


@dataclass(frozen=True)
class Train:
    """Train task policies, behind a correction if ``--safety`` is given (Algorithm 2).

    Attributes:
        out: the run folder; the same command goes on where it stopped.
        threshold_from: take epsilon, or WCSAC's cost limit, from a file that choose-threshold
            wrote.
        run_config: the run.
    """

    out: Path
    run_config: Annotated[TrainConfig, tyro.conf.arg(name="")]
    threshold_from: Path | None = None

    def run(self) -> None:
        """Train, evaluate, and say what came out."""
        config = self.run_config
        if self.threshold_from is not None:
            if config.threshold is not None:
                raise ValueError("give either threshold or threshold_from")
            method = config.method
            if isinstance(method, WcsacSettings) and method.cost_limit != WcsacSettings.cost_limit:
                raise ValueError("give either cost_limit or threshold_from")
            config = config.with_threshold(read_threshold(self.threshold_from))
        for line in seed_lines(train(config, self.out).seeds):
            print(line)
        print(self.out / "result.json")


@dataclass(frozen=True)
class TrainOffline:
    """Train task policies from recorded transitions alone (IQL).

    Attributes:
        out: the run folder; the same command goes on where it stopped.
        run_config: the run.
    """

    out: Path
    run_config: Annotated[OfflineConfig, tyro.conf.arg(name="")]

    def run(self) -> None:
        """Train, evaluate, and say what came out."""
        for line in seed_lines(train_offline(self.run_config, self.out).seeds):
            print(line)
        print(self.out / "result.json")


@dataclass(frozen=True)
class Evaluate:
    """Evaluate trained policies on whole episodes, behind any filter (plug and play).

    Attributes:
        policy: the folder of a finished training run.
        out: the folder that gets result.json.
        safety: a folder with filters of the same seeds, for example a pretraining run.
        threshold: epsilon; None: each filter's own.
        threshold_from: take the threshold from a file that choose-threshold wrote.
        episodes: whole episodes a seed.
        task: evaluate there instead of where the policies were trained.
    """

    policy: Path
    out: Path
    safety: Path | None = None
    threshold: float | None = None
    threshold_from: Path | None = None
    episodes: int = 500
    task: str | None = None

    def run(self) -> None:
        """Evaluate, and say what came out."""
        threshold = self.threshold
        if self.threshold_from is not None:
            if threshold is not None:
                raise ValueError("give either threshold or threshold_from")
            threshold = read_threshold(self.threshold_from)
        seeds = evaluate_policies(
            self.policy,
            self.safety,
            self.out,
            threshold=threshold,
            episodes=self.episodes,
            task=self.task,
        )
        for line in seed_lines(seeds):
            print(line)
        print(self.out / "result.json")


@dataclass(frozen=True)
class OfflineData:
    """The paper's offline data: a run's replay buffer and random actions, before violations.

    Attributes:
        run_folder: a finished run of SAC with ``--keep-replay``.
        out: the HDF5 file to write.
        seed: whose replay, and of the random actions.
        random: transitions with uniform random actions, before the filter.
        keep: only so many steps before each violation; None: everything.
    """

    run_folder: Path
    out: Path
    seed: int
    random: int = 1_000_000
    keep: int | None = 100

    def run(self) -> None:
        """Put them together, write, and say what there is."""
        task = training_run(self.run_folder).task
        rng = np.random.default_rng(self.seed)
        data = offline_data(task, self.run_folder, self.seed, self.random, self.keep, rng)
        self.out.parent.mkdir(parents=True, exist_ok=True)
        write_hdf5(data, self.out)
        print(f"{self.out}: {summarise(data)}")


@dataclass(frozen=True)
class ChooseThreshold:
    """Choose epsilon, or WCSAC's cost limit, so that the methods are comparably safe.

    Attributes:
        run_folder: a finished training run with another threshold for each seed.
        baseline: a training run of SAC on the same task.
        out: the JSON file to write.
        share: the largest candidate with at most this share of SAC's violations is taken.
    """

    run_folder: Path
    baseline: Path
    out: Path
    share: float = 0.05

    def run(self) -> None:
        """Choose, write, and say why."""
        choice = choose_threshold(self.run_folder, self.baseline, self.share)
        write_choice(choice, self.out)
        held = "" if choice.met else " (none is as safe as that)"
        print(f"{self.out}: {choice.threshold:g}, {choice.allowed:.1f} violations allowed{held}")
