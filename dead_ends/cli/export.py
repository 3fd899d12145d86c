"""``export FILE --out PATH``: the safety filter as a table for a runtime.

The file says which actions pass and what is executed instead; see
:mod:`dead_ends.safety.filter_table`. Without ``--epsilon-safe`` exactly the actions pass that keep
a safe state safe; with it those with Q*(s, a) < epsilon_safe. The recovery policy takes an
action that keeps the state safe where there is one, and is greedy on Q* elsewhere.

A filter may be so cautious that the task cannot be done any more: where starts can reach a goal,
and behind the filter cannot, a line on standard error says so.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from dead_ends.cli.label import ESTIMATE
from dead_ends.cli.output import add_exact_argument, add_output_argument, check_output
from dead_ends.cli.source import (
    add_discount_argument,
    add_source_arguments,
    parse_threshold,
    read_source,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dead_ends.model.safe_mdp import SafeMDP

SUMMARY = "write the allowed actions and the recovery policy for a runtime"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_output_argument(parser, "the filter table (.npz or .json)")
    add_discount_argument(parser)
    parser.add_argument(
        "--epsilon-safe",
        metavar="EPSILON",
        type=parse_threshold,
        help="the threshold on Q*, as 0.9 or 9/10 (default: decide exactly, without one)",
    )
    add_exact_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.model.digest import model_digest
    from dead_ends.safety.correction import safety_filter
    from dead_ends.safety.filter_table import save_filter
    from dead_ends.values.bellman import value_iteration

    check_output(arguments.out, arguments.file)
    model = read_source(arguments)
    critic = value_iteration(model, arguments.gamma_safe, exact=arguments.exact)
    threshold = arguments.epsilon_safe
    metadata = {
        "model": str(arguments.file),
        "sha256": model_digest(model),
        "estimate": model.estimate,
        "gamma_safe": str(arguments.gamma_safe),
        "epsilon_safe": None if threshold is None else str(threshold),
        "exact": critic.exact,
    }
    table = safety_filter(model, critic, threshold, metadata)
    save_filter(table, arguments.out)
    passing = f"{int(table.allowed.sum()):,} of {table.allowed.size:,} actions pass"
    print(f"wrote {arguments.out}: {passing}")
    if model.estimate:
        print(f"dead-ends: the filter is of {ESTIMATE}", file=sys.stderr)
    if lost := cut_off(model, table.allowed, table.recovery):
        print(f"dead-ends: {lost}", file=sys.stderr)
    return 0


def cut_off(model: SafeMDP, allowed: NDArray[np.bool_], recovery: NDArray[np.int64]) -> str:
    """Which starts can reach a goal, but not behind the filter; empty if there are none.

    Goals are the terminal states. It is a question of possible paths, not of probabilities.
    """
    import numpy as np

    if model.initial is None or not model.terminal.any():
        return ""
    available = model.available
    blocked = (available & ~allowed).any(axis=1)
    executed = available & allowed
    executed[blocked, recovery[blocked]] = available[blocked, recovery[blocked]]
    could = np.flatnonzero((model.initial > 0) & _reaches_goal(model, available))
    lost = could[~_reaches_goal(model, executed)[could]]
    if not len(lost):
        return ""
    which = model.state_name(int(lost[0])) if len(lost) == 1 else f"{len(lost):,} starts"
    if len(lost) == len(could):
        return f"no start reaches a goal behind this filter ({which} could without it)"
    return f"behind this filter {which} of {len(could):,} can no longer reach a goal"


def _reaches_goal(model: SafeMDP, choices: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """bool (S,): a goal can be reached by some path that takes only ``choices``."""
    import numpy as np
    from scipy import sparse
    from scipy.sparse import csgraph

    matrix = model.transitions()
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    taken = choices.ravel()[rows]
    source, target = rows[taken] // model.num_actions, matrix.indices[taken]
    goals = np.flatnonzero(model.terminal)
    size = model.num_states + 1  # one more node, from which every goal is reached
    backwards = sparse.coo_array(
        (
            np.ones(len(source) + len(goals)),
            (
                np.concatenate((target, np.full(len(goals), size - 1))),
                np.concatenate((source, goals)),
            ),
        ),
        shape=(size, size),
    )
    found = csgraph.breadth_first_order(
        backwards.tocsr(), size - 1, directed=True, return_predecessors=False
    )
    reached = np.zeros(size, dtype=np.bool_)
    reached[found] = True
    return reached[:-1]
