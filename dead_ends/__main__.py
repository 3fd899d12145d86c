"""``python -m dead_ends COMMAND ...``: the toolkit on the command line.

Exit status: 0; 1 if what was asked does not hold (a certificate that is refused, say); 2 if
the input is wrong, with one line on standard error that says what and where; 130 after an
interrupt, 141 if nobody reads the output any more.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from dead_ends import __version__
from dead_ends.cli import COMMANDS
from dead_ends.io.errors import MissingDependencyError
from dead_ends.values.precision import UndecidedError

USAGE_ERROR, INTERRUPTED, BROKEN_PIPE = 2, 130, 141


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(USAGE_ERROR, f"{self.prog}: {message} (see {self.prog} --help)\n")


def make_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(
        prog="dead-ends",
        description="Exact answers about dead-ends: states from which the agent fails whatever "
        "it does, in a task in which the first violation ends the episode.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = import_module(f"dead_ends.cli.{name}")
        command = commands.add_parser(name, help=module.SUMMARY, description=module.__doc__)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    parsed = make_parser().parse_args(arguments)
    try:
        status: int = parsed.run(parsed)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # Python would flush standard output once more at exit, and complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except KeyboardInterrupt:
        return INTERRUPTED
    except MemoryError as error:
        return _complain(str(error) or "not enough memory for this model")
    except OSError as error:
        path = error.filename2 or error.filename  # of a renaming, the target
        return _complain(f"{path}: {error.strerror}" if path else str(error))
    except UndecidedError as error:
        return _complain(error.with_options(vars(parsed)))
    except (ValueError, MissingDependencyError) as error:
        return _complain(str(error))


def _complain(message: str) -> int:
    line = " ".join(message.split())
    print(f"dead-ends: {line}", file=sys.stderr)
    return USAGE_ERROR


if __name__ == "__main__":
    sys.exit(main())
