"""``python -m deep train``: Algorithm 2, online."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep.cli.seeds import seed_lines
from deep.study.threshold_choice import read_threshold
from deep.train.config import TrainConfig
from deep.train.run import train
from deep.train.wcsac import WcsacSettings


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
