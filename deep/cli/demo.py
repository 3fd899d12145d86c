"""``python -m deep demo``: the picture of learned and exact boundaries."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from deep.runs.folder import only_process
from deep.score.demo import DemoConfig, demo


@dataclass(frozen=True)
class Demo:
    """From nothing to the picture of learned and exact boundaries, in minutes.

    Attributes:
        config: the demonstration.
    """

    config: Annotated[DemoConfig, tyro.conf.arg(name="")] = field(default_factory=DemoConfig)

    def run(self) -> None:
        """Train, draw, and print each seed's two shares."""
        with only_process(self.config.out):
            found = demo(self.config)
        for task, scores in found.items():
            for seed, score in zip(self.config.seeds, scores, strict=True):
                print(
                    f"{task}, seed {seed}: {100 * score.dead_called_safe:.2f}% of the dead states "
                    f"called safe, {100 * score.safe_called_dead:.2f}% of the safe called dead"
                )
        print(self.config.out / "demo.png")
