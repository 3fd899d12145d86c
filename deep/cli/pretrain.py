"""``python -m deep pretrain``: Algorithm 1."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep.config import PretrainConfig
from deep.pretrain.health import Status
from deep.run import pretrain


@dataclass(frozen=True)
class Pretrain:
    """Learn safety critics and recovery policies from offline data (Algorithm 1).

    Attributes:
        out: the run folder; the same command goes on where it stopped.
        run_config: the run.
    """

    out: Path
    run_config: Annotated[PretrainConfig, tyro.conf.arg(name="")]

    def run(self) -> None:
        """Train, report on every seed, and warn of critics that are of no use."""
        result = pretrain(self.run_config, self.out)
        for safety, health in zip(result.filters, result.health, strict=True):
            print(f"{self.out / 'filters'}/seed{safety.seed}.safetensors: {health}")
        broken = [str(h.seed) for h in result.health if h.status != Status.SOUND]
        if broken:
            print(
                f"deep: warning: {len(broken)} of {len(result.health)} critics are of no use "
                f"(seeds: {', '.join(broken)})",
                file=sys.stderr,
            )
