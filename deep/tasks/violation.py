"""Which costs are violations: one rule for files, Minari datasets and "gym:" environments.

A cost is 1 at a violation, else 0, unless a rule says which costs are one: ``cost > 0.5``,
``cost >= 1``, or, where a row has one cost for each of several constraints, ``cost[0] > 0.5``.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["check_rule", "violations"]

Bools = NDArray[np.bool_]

_RULE = re.compile(r"\s*cost\s*(?:\[\s*(\d+)\s*\])?\s*(>=|<=|>|<)\s*(\S+)\s*")
_COMPARISONS = {">": operator.gt, ">=": operator.ge, "<": operator.lt, "<=": operator.le}


def _row(row: int) -> str:
    return f"costs: row {row}"


def _option(rule: str) -> str:
    return f'for example --violation "{rule}" (violation="{rule}")'


def check_rule(rule: str | None) -> None:
    """Refuse what is no rule; None, for costs that are 0 or 1, is one.

    Raises:
        ValueError: showing what a rule looks like.
    """
    if rule is not None:
        _parsed(rule)


def _parsed(rule: str) -> tuple[int | None, Callable[[Any, float], Any], float]:
    """Which constraint (None: the only one), the comparison, and the number."""
    match = _RULE.fullmatch(rule)
    try:
        if match is None or not np.isfinite(bound := float(match[3])):
            raise ValueError
    except ValueError:
        raise ValueError(
            f"violation: a rule is like 'cost > 0.5' or 'cost[0] > 0.5', not {rule!r}"
        ) from None
    column = None if match[1] is None else int(match[1])
    return column, _COMPARISONS[match[2]], bound


def violations(costs: NDArray[Any], rule: str | None, place: Callable[[int], str] = _row) -> Bools:
    """Where the costs (N,) or (N, constraints) are violations: (N,).

    Args:
        costs: numbers.
        rule: as above; None: each cost is 0 or 1.
        place: what an error calls a row.

    Raises:
        ValueError: for a cost that is not finite, or not 0 or 1 without a rule; for several
            constraints of which the rule picks none; for a rule that is none.
    """
    table = costs.reshape(len(costs), -1)
    bad = ~np.isfinite(table)
    if bad.any():
        row, column = map(int, np.argwhere(bad)[0])
        which = f", column {column}" if costs.ndim > 1 else ""
        raise ValueError(f"{place(row)}{which} is {table[row, column]}")
    picked, compare, bound = (None, operator.gt, 0.0) if rule is None else _parsed(rule)
    constraints = table.shape[1]
    if picked is None and constraints != 1:
        raise ValueError(
            f"{place(0)} has {constraints} costs, one for each of several constraints; choose one "
            f"of these, {_option('cost[0] > 0')}"
        )
    if picked is not None and picked >= constraints:
        raise ValueError(f"{place(0)} has {constraints} costs: there is no cost[{picked}]")
    column_of = table[:, picked or 0]
    odd = (column_of != 0) & (column_of != 1)
    if rule is None and odd.any():
        row = int(np.argmax(odd))
        raise ValueError(
            f"{place(row)} is {column_of[row]:g}; a cost is 1 at a violation, else 0, unless you "
            f"say which cost is one, {_option('cost > 0')}"
        )
    found: Bools = compare(column_of, bound)
    return found
