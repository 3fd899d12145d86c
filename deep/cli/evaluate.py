"""``python -m deep evaluate``: trained policies behind any filter."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep.cli.seeds import seed_lines
from deep.runs.folder import only_process
from deep.study.threshold_choice import read_threshold
from deep.tasks.gym import NO_RULES, Rules
from deep.train.evaluation import evaluate_policies


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
        rules: what an environment of "gym:" leaves open; by default those of the training run.
    """

    policy: Path
    out: Path
    safety: Path | None = None
    threshold: float | None = None
    threshold_from: Path | None = None
    episodes: int = 500
    task: str | None = None
    rules: Annotated[Rules, tyro.conf.arg(name="")] = NO_RULES

    def run(self) -> None:
        """Evaluate, and say what came out."""
        threshold = self.threshold
        if self.threshold_from is not None:
            if threshold is not None:
                raise ValueError("give either threshold or threshold_from")
            threshold = read_threshold(self.threshold_from)
        with only_process(self.out):
            seeds = evaluate_policies(
                self.policy,
                self.safety,
                self.out,
                threshold=threshold,
                episodes=self.episodes,
                task=self.task,
                rules=None if self.rules == NO_RULES else self.rules,
            )
        for line in seed_lines(seeds):
            print(line)
        print(self.out / "result.json")
