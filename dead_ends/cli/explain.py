"""``explain FILE STATE``: why a state is what it is."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from dead_ends.cli.output import add_exact_argument
from dead_ends.cli.source import add_source_arguments, read_source

SUMMARY = "say why a state is lost, safe or at risk"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    parser.add_argument("state", metavar="STATE", help="the name or the number of a state")
    parser.add_argument("--json", action="store_true", help="print label and witness as JSON")
    add_exact_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    model = read_source(arguments)

    from dead_ends.safety.explanation import explain

    explanation = explain(model, arguments.state, exact=bool(arguments.exact))
    if arguments.json:
        label = explanation.label.name.lower().replace("_", "-")
        print(json.dumps({**asdict(explanation), "label": label}, indent=2))
    else:
        print(explanation.text)
    return 0
