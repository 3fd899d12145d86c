"""``statements FILE``: which statements of the paper hold on a model, with the numbers."""

from __future__ import annotations

import argparse
import textwrap
from typing import TYPE_CHECKING, Any

from dead_ends.cli.output import add_exact_argument
from dead_ends.cli.source import (
    add_discount_argument,
    add_source_arguments,
    parse_threshold,
    print_rows,
    read_policy,
    read_source,
)

if TYPE_CHECKING:
    from dead_ends.paper import Verification

SUMMARY = "check the paper's statements on a model"
VERDICTS = {True: "holds", False: "FAILS", None: "open"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_discount_argument(parser)
    add_exact_argument(parser)
    parser.add_argument(
        "--epsilon-safe",
        metavar="EPSILON",
        type=parse_threshold,
        help="the threshold (default: the recommended one)",
    )
    parser.add_argument(
        "--policy",
        metavar="PATH",
        help="the task policy, a .npy file: actions (S,) or probabilities (S, A) "
        "(default: the first available action)",
    )


def run(arguments: argparse.Namespace) -> int:
    model = read_source(arguments)

    from dead_ends.paper import verify_statements
    from dead_ends.values.discount import read_discount

    policy = None if arguments.policy is None else read_policy(arguments.policy)
    gamma, _ = read_discount(arguments.gamma_safe, arguments.exact)
    found = verify_statements(model, gamma, arguments.epsilon_safe, policy)
    print(f"{arguments.file}: {model!r}")
    print_rows(_rows(found, arguments.policy))
    for statement in found.statements:
        print(f"\n{VERDICTS[statement.holds]}  {statement.place}")
        for text in filter(None, (statement.claim, statement.detail)):
            print(textwrap.fill(text, 92, initial_indent="       ", subsequent_indent="       "))
    return 0


def _rows(found: Verification, policy: str | None) -> list[tuple[str, Any]]:
    from dead_ends.values.discount import scientific

    labelling, interval = found.labelling, found.interval
    return [
        ("H", "none" if labelling.horizon is None else labelling.horizon),
        ("H_b", "none" if labelling.boundary_horizon is None else labelling.boundary_horizon),
        ("gamma_safe", str(found.gamma_safe)),
        ("exact thresholds", str(interval)),
        ("epsilon_safe", scientific(found.epsilon_safe)),
        ("task policy", policy or "the first available action in every state"),
    ]
