"""``export FILE --out PATH``: the safety filter as a table for a runtime.

The file says which actions pass and what is executed instead; see
:mod:`dead_ends.io.filter_table`. Without ``--epsilon-safe`` exactly the actions pass that keep
a safe state safe; with it those with Q*(s, a) < epsilon_safe. The recovery policy takes an
action that keeps the state safe where there is one, and is greedy on Q* elsewhere.
"""

from __future__ import annotations

import argparse

from dead_ends.cli.source import (
    add_discount_argument,
    add_source_arguments,
    parse_threshold,
    read_source,
)

SUMMARY = "write the allowed actions and the recovery policy for a runtime"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    parser.add_argument(
        "--out", metavar="PATH", required=True, help="the filter table (.npz or .json)"
    )
    add_discount_argument(parser)
    parser.add_argument(
        "--epsilon-safe",
        metavar="EPSILON",
        type=parse_threshold,
        help="the threshold on Q*, as 0.9 or 9/10 (default: decide exactly, without one)",
    )


def run(arguments: argparse.Namespace) -> int:
    import numpy as np

    from dead_ends.bellman import value_iteration
    from dead_ends.checker import model_digest
    from dead_ends.io.filter_table import save_filter
    from dead_ends.labels import safe_actions
    from dead_ends.policies import allowed_actions, recovery_policy

    model = read_source(arguments)
    critic = value_iteration(model, arguments.gamma_safe)
    stays = safe_actions(model)
    threshold = arguments.epsilon_safe
    allowed = stays if threshold is None else allowed_actions(critic, threshold)
    recovery = np.where(stays.any(axis=1), stays.argmax(axis=1), recovery_policy(critic))
    metadata = {
        "model": str(arguments.file),
        "sha256": model_digest(model),
        "gamma_safe": str(arguments.gamma_safe),
        "epsilon_safe": None if threshold is None else str(threshold),
    }
    save_filter(arguments.out, allowed, recovery, metadata)
    print(f"wrote {arguments.out}: {int(allowed.sum()):,} of {allowed.size:,} actions pass")
    return 0
