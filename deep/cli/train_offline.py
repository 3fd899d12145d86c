"""``python -m deep train-offline``: task policies from recorded transitions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep.cli.seeds import seed_lines
from deep.train.offline import OfflineConfig, train_offline


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
