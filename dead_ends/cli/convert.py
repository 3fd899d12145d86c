"""``convert FILE --out PATH``: a model in another format."""

from __future__ import annotations

import argparse

from dead_ends.cli.output import add_output_argument, check_output
from dead_ends.cli.source import add_source_arguments, read_source

SUMMARY = "write a model in another format"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_output_argument(parser, "the file; its suffix says the format")


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.io import save_model

    check_output(arguments.out, arguments.file)
    model = read_source(arguments)
    save_model(model, arguments.out)
    print(f"wrote {arguments.out}: {model}")
    return 0
