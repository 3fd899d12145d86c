"""``python -m deep sweep``: what the choices do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from deep.runs.folder import only_process
from deep.score.sweep import SweepConfig, sweep


@dataclass(frozen=True)
class Sweep:
    """What gamma_safe, epsilon, the expectile and the data mix do.

    Attributes:
        config: the sweep.
    """

    config: Annotated[SweepConfig, tyro.conf.arg(name="")]

    def run(self) -> None:
        """Train, score, draw."""
        with only_process(self.config.out):
            sweep(self.config)
        print(self.config.out / "sweep.png")
