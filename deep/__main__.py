"""Command line: ``python -m deep collect|pretrain|train|evaluate|grid|report|...``.

A run that was interrupted or killed goes on when the same command is given again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import torch
import tyro

from deep.compare import CompareConfig, compare, summary_table
from deep.config import Mix, PretrainConfig
from deep.data import summarise
from deep.demo import DemoConfig, demo
from deep.formats import write_hdf5
from deep.grid import JobsFailedError
from deep.grid_command import Grid
from deep.online.commands import ChooseThreshold, Evaluate, OfflineData, Train, TrainOffline
from deep.pretrain.health import Status
from deep.report import report
from deep.run import pretrain
from deep.sweep import SweepConfig, sweep
from deep.tasks import make_task

__all__ = ["main", "parse"]


@dataclass(frozen=True)
class Collect:
    """Collect offline data from a task.

    Attributes:
        task: the task's name.
        out: the HDF5 file to write.
        seed: of the collection.
        mix: who acts, and what is kept.
    """

    task: str
    out: Path
    seed: int = 0
    mix: Annotated[Mix, tyro.conf.arg(name="")] = field(default_factory=Mix)

    def run(self) -> None:
        """Collect, write, and say what there is."""
        data = self.mix.collect(make_task(self.task), np.random.default_rng(self.seed))
        write_hdf5(data, self.out)
        print(f"{self.out}: {summarise(data)}")


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


@dataclass(frozen=True)
class Compare:
    """Score every method against the exact answer of a task.

    Attributes:
        config: the comparison.
    """

    config: Annotated[CompareConfig, tyro.conf.arg(name="")]

    def run(self) -> None:
        """Train, score, and print the table."""
        print(summary_table(compare(self.config)))


@dataclass(frozen=True)
class Sweep:
    """What gamma_safe, epsilon, the expectile and the data mix do.

    Attributes:
        config: the sweep.
    """

    config: Annotated[SweepConfig, tyro.conf.arg(name="")]

    def run(self) -> None:
        """Train, score, draw."""
        sweep(self.config)
        print(self.config.out / "sweep.png")


@dataclass(frozen=True)
class Demo:
    """From nothing to the picture of learned and exact boundaries, in minutes.

    Attributes:
        config: the demonstration.
    """

    config: Annotated[DemoConfig, tyro.conf.arg(name="")] = field(default_factory=DemoConfig)

    def run(self) -> None:
        """Train, draw, and print each seed's two shares."""
        for task, scores in demo(self.config).items():
            for seed, score in zip(self.config.seeds, scores, strict=True):
                print(
                    f"{task}, seed {seed}: {100 * score.dead_called_safe:.2f}% of the dead states "
                    f"called safe, {100 * score.safe_called_dead:.2f}% of the safe called dead"
                )
        print(self.config.out / "demo.png")


@dataclass(frozen=True)
class Report:
    """Tables and pictures from a study's saved runs, whatever has finished.

    Attributes:
        study: the study's folder.
        out: the folder that gets report.md and its parts.
    """

    study: Path
    out: Path

    def run(self) -> None:
        """Read, write, and say how much there was."""
        found = report(self.study, self.out)
        print(
            f"{self.out / 'report.md'}: {len(found.runs)} finished runs, "
            f"{len(found.unfinished)} unfinished"
        )


Command: TypeAlias = (
    Annotated[Collect, tyro.conf.subcommand("collect")]
    | Annotated[Pretrain, tyro.conf.subcommand("pretrain")]
    | Annotated[OfflineData, tyro.conf.subcommand("offline-data")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[TrainOffline, tyro.conf.subcommand("train-offline")]
    | Annotated[ChooseThreshold, tyro.conf.subcommand("choose-threshold")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Grid, tyro.conf.subcommand("grid")]
    | Annotated[Report, tyro.conf.subcommand("report")]
)


def parse(arguments: Sequence[str] | None) -> Command:
    """The command that the arguments describe; exits with a message where they do not."""
    command: Command = tyro.cli(
        Command,
        args=arguments,
        prog="python -m deep",
        config=(tyro.conf.OmitSubcommandPrefixes,),
    )
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0, or 2 after one line about what was wrong, or 130 after Ctrl-C.

    1 after the table of jobs that failed.
    """
    torch.set_num_threads(1)
    try:
        parse(arguments).run()
    except (ValueError, FloatingPointError, OSError) as error:
        print(f"deep: {error}", file=sys.stderr)
        return 2
    except JobsFailedError as failed:
        print(failed, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("deep: interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
