"""The arguments by which a command is told what to write, and how exactly."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

SIBLINGS = (".lab", ".sta")
"""What belongs to a .tra file, with the same name beside it."""


def add_output_argument(
    parser: argparse.ArgumentParser, help: str, *, metavar: str = "PATH", required: bool = True
) -> None:
    """--out."""
    parser.add_argument("--out", metavar=metavar, type=parse_output, required=required, help=help)


def add_exact_argument(parser: argparse.ArgumentParser) -> None:
    """--exact."""
    parser.add_argument(
        "--exact",
        action="store_true",
        default=None,
        help="solve in fractions, without rounding; decimals of the model and of the options are "
        "taken as they are written (0.1 is 1/10), and every row has to sum to exactly 1",
    )


def parse_output(text: str) -> str:
    """The name of a file to write."""
    if not text:
        raise argparse.ArgumentTypeError("the name of the file is empty")
    return text


def check_output(out: str | None, *inputs: str | Path) -> None:
    """The file may be written, and neither it nor its siblings are read as input.

    Called before anything is read or solved, so that nothing is waited for in vain.

    Raises:
        ValueError: see :func:`dead_ends.io.atomic.check_target`.
    """
    from dead_ends.io.atomic import check_target

    if out is not None:
        sources = [part for source in inputs for part in _with_siblings(source)]
        for target in _with_siblings(out):
            check_target(target, *sources)


def _with_siblings(path: str | Path) -> Sequence[Path]:
    """The file and those that are read and written with it."""
    whole = Path(path)
    stem, dot, _ = whole.name.lower().rpartition(".tra")
    if not dot:
        return [whole]
    base, packed = whole.name[: len(stem)], whole.name[len(stem) + len(".tra") :]
    names = {base + suffix + end for suffix in SIBLINGS for end in ("", packed)}
    return [whole, *(whole.with_name(name) for name in sorted(names))]
