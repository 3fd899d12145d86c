"""Command line: ``python -m deep collect|pretrain|train|evaluate|grid|report|...``.

A run that was interrupted or killed goes on when the same command is given again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import NoReturn, Protocol

from deep.cli import COMMANDS
from deep.study.schedule import JobsFailedError

__all__ = ["main", "parse"]

PACKAGES = ("torch", "tyro", "gymnasium", "h5py", "safetensors")
"""What the extra ``deep`` brings."""


class Command(Protocol):
    """What :mod:`deep.cli` has one of for every name."""

    def run(self) -> None:
        """Do the work, and say what there is."""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"deep: {message} (see {self.prog} --help)\n")


def make_parser() -> argparse.ArgumentParser:
    """The parser of the first word; a command's own options are its dataclass's fields."""
    parser = _Parser(
        prog="python -m deep",
        description="Learned safety critics, recovery policies and behavior correction for "
        "continuous tasks.",
    )
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True)
    for name, summary in COMMANDS.items():
        commands.add_parser(name, help=summary)
    return parser


def parse(arguments: Sequence[str]) -> Command:
    """The command that the arguments describe; exits with a message where they do not."""
    name: str = make_parser().parse_args(arguments[:1]).command
    import tyro

    from deep.runs.folder import refuse_empty_names

    refuse_empty_names(arguments)
    module = import_module(f"deep.cli.{name.replace('-', '_')}")
    command: Command = tyro.cli(
        getattr(module, name.title().replace("-", "")),
        args=arguments[1:],
        prog=f"python -m deep {name}",
        config=(tyro.conf.OmitSubcommandPrefixes,),
    )
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0, or 2 after one line about what was wrong, or 130 after Ctrl-C.

    1 after the table of jobs that failed.
    """
    given = sys.argv[1:] if arguments is None else arguments
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing and given[:1] not in (["-h"], ["--help"]):
        names = ", ".join(missing)
        print(f"deep: it needs {names}: pip install 'dead-ends[deep]'", file=sys.stderr)
        return 2
    try:
        command = parse(given)
        if "torch" in sys.modules:  # by the command: seeds are batched, threads do not pay
            sys.modules["torch"].set_num_threads(1)
        command.run()
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
