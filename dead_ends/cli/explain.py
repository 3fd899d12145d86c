"""``explain FILE STATE``: why a state is what it is."""

from __future__ import annotations

import argparse

from dead_ends.cli.source import add_source_arguments, read_source

SUMMARY = "say why a state is lost, safe or at risk"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    parser.add_argument("state", metavar="STATE", help="the name or the number of a state")


def run(arguments: argparse.Namespace) -> int:
    model = read_source(arguments)

    from dead_ends.explanation import explain

    print(explain(model, arguments.state).text)
    return 0
