"""``page FILE --out PAGE``: one self-contained page, to look at in a browser."""

from __future__ import annotations

import argparse
from pathlib import Path

from dead_ends.cli.output import add_output_argument, check_output
from dead_ends.cli.source import add_source_arguments, read_policy, read_source

SUMMARY = "write a page that shows labels, witnesses and what critics block"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_output_argument(parser, "the page (.html)", metavar="PAGE")
    parser.add_argument(
        "--policy",
        metavar="FILE",
        type=Path,
        action="append",
        help="a task policy (.npy, integers (S,) or probabilities (S, A)) to compare; may be "
        "repeated; without it, the uniformly random policy",
    )


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.cli.page_answers import page_answers
    from dead_ends.draw.page import draw_page
    from dead_ends.io.atomic import atomic_path

    check_output(arguments.out, arguments.file, *(arguments.policy or ()))
    if Path(arguments.out).suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{arguments.out}: the page is written as .html")
    model = read_source(arguments)
    policies = {path.stem: read_policy(path) for path in arguments.policy or ()}
    answers = page_answers(model, policies or None)
    page = draw_page(model, answers, Path(arguments.file).stem)
    with atomic_path(arguments.out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    print(f"wrote {arguments.out}")
    return 0
