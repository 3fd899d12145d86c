"""Conditions on transitions, written as text: ``r <= -100 and not done``.

A condition is a Python expression over the names

* ``s``, ``a``, ``s2``: numbers of the state, the action and the successor,
* ``r``: the reward of the transition,
* ``done``: whether the episode ends with it,

or, instead of them, over the variables of a model that has them: ``col == 2 and x > 3`` says which
states fail. A variable that is called like one of the names above is written ``model.s``.

Both come with numbers, arithmetic, comparisons (``in`` with a list too) and ``and``, ``or``,
``not``. The text is parsed and interpreted here on whole arrays; nothing of it is ever executed.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["NAMES", "evaluate_condition", "names_in"]

NAMES = ("s", "a", "r", "s2", "done")

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: np.isin,
    ast.NotIn: lambda value, members: ~np.isin(value, members),
}


def evaluate_condition(text: str, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Whether each transition satisfies the condition.

    Args:
        text: the condition.
        columns: equally long arrays for the names that the transitions have.

    Raises:
        ValueError: quoting the part of the condition that has no meaning here.
    """
    tree = _parse(text)
    try:
        with np.errstate(divide="raise", invalid="raise", over="raise"):
            value = np.asarray(_evaluate(tree, columns))
    except (FloatingPointError, ZeroDivisionError) as error:
        what = "numbers are too large" if "overflow" in str(error) else "division by zero"
        raise ValueError(f"condition {text!r}: {what}") from None
    except (_Meaningless, OverflowError, RecursionError) as error:
        raise ValueError(f"condition {text!r}: {error}") from None
    if value.dtype != np.bool_:
        raise ValueError(f"condition {text!r}: gives a number, not true or false")
    length = len(next(iter(columns.values())))
    return np.broadcast_to(value, (length,)).copy()


def names_in(text: str) -> list[str]:
    """The different names of a condition in alphabetical order, ``model.s`` being one.

    Raises:
        ValueError: if the text is not an expression.
    """
    names, owners = set(), set()
    for node in ast.walk(_parse(text)):  # from the outside to the inside
        match node:
            case ast.Attribute(value=ast.Name(id=owner) as inner, attr=attribute):
                names.add(f"{owner}.{attribute}")
                owners.add(inner)
            case ast.Name(id=name) if node not in owners:
                names.add(name)
    return sorted(names)


def _parse(text: str) -> ast.expr:
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"condition {text!r}: not an expression") from None


class _Meaningless(Exception):
    """A part of the text that is not in the language above."""


def _evaluate(node: ast.expr, columns: Mapping[str, NDArray[Any]]) -> Any:
    match node:
        case ast.Constant(value=bool() | int() | float() as value):
            return value
        case ast.Name(id=name) if name in columns:
            return columns[name]
        case ast.Attribute(value=ast.Name(id=owner), attr=name) if f"{owner}.{name}" in columns:
            return columns[f"{owner}.{name}"]
        case ast.Name(id=name):
            known = ", ".join(columns)
            raise _Meaningless(f"unknown name '{name}' (known here: {known})")
        case ast.BoolOp(op=op, values=values):
            combine = np.logical_and if isinstance(op, ast.And) else np.logical_or
            terms = [_truth(value, columns) for value in values]
            return combine.reduce(np.broadcast_arrays(*terms))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return np.logical_not(_truth(operand, columns))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_number(operand, columns)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _calculated(_BINARY[type(op)], _number(left, columns), _number(right, columns))
        case ast.Compare(left=left, ops=ops, comparators=comparators):
            return _compare(left, ops, comparators, columns)
    raise _Meaningless(f"'{ast.unparse(node)}' is not allowed")


def _compare(
    left: ast.expr,
    ops: list[ast.cmpop],
    comparators: list[ast.expr],
    columns: Mapping[str, NDArray[Any]],
) -> Any:
    """A chain ``0 < r <= 3`` holds where each of its links does."""
    result: Any = True
    value = _evaluate(left, columns)
    for op, comparator in zip(ops, comparators, strict=True):
        if type(op) not in _COMPARE:
            raise _Meaningless("'is' is not allowed; use ==")
        if isinstance(op, ast.In | ast.NotIn):
            following: Any = _members(comparator, columns)
        else:
            following = _evaluate(comparator, columns)
        result = np.logical_and(result, _COMPARE[type(op)](value, following))
        value = following
    return result


def _members(node: ast.expr, columns: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    if not isinstance(node, ast.List | ast.Tuple | ast.Set):
        raise _Meaningless(f"'{ast.unparse(node)}' is not a list")
    members = [_number(element, columns) for element in node.elts]
    if any(isinstance(member, np.ndarray) for member in members):
        raise _Meaningless(f"'{ast.unparse(node)}' is not a list of numbers")
    return np.array(members)


def _truth(node: ast.expr, columns: Mapping[str, NDArray[Any]]) -> Any:
    value = _evaluate(node, columns)
    if np.asarray(value).dtype != np.bool_:
        raise _Meaningless(f"'{ast.unparse(node)}' is not true or false")
    return value


def _calculated(operate: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """The result of an operation; integers beyond 64 bits would wrap around without a word."""
    value = operate(left, right)
    if np.asarray(value).dtype.kind in "iu":
        rough = operate(np.asarray(left, np.float64), np.asarray(right, np.float64))
        if np.any(np.abs(rough) >= 2.0**63):
            raise _Meaningless("numbers are too large")
    return value


def _number(node: ast.expr, columns: Mapping[str, NDArray[Any]]) -> Any:
    value = _evaluate(node, columns)
    if np.asarray(value).dtype == np.bool_:
        raise _Meaningless(f"'{ast.unparse(node)}' is not a number")
    return value
