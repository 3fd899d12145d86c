"""``python -m deep pretrain``: Algorithm 1."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep.pretraining.config import PretrainConfig
from deep.pretraining.run import pretrain_in_folder


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
        """Train, report on every seed, and warn of filters that are of no use.

        A filter of no use is a result, and the run finished: the status is 0.
        """
        result = pretrain_in_folder(self.run_config, self.out)
        for safety, health in zip(result.filters, result.health, strict=True):
            print(f"{self.out / 'filters'}/seed{safety.seed}.safetensors: {health}")
        useless = [str(health.seed) for health in result.health if health.fault]
        if useless:
            print(
                f"deep: warning: {len(useless)} of {len(result.health)} filters are of no use "
                f"(seeds: {', '.join(useless)})",
                file=sys.stderr,
            )
