"""The arguments by which every command is told its model."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dead_ends.model import SafeMDP

MAX_LISTED_STATES = 10_000_000


def add_source_arguments(parser: argparse.ArgumentParser) -> None:
    """FILE and the options that say what the file does not."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help="a model (.npz; .tra with .lab and .sta; .drn; with stormpy also PRISM's .prism, .nm "
        "and .pm, .jani and .umb) or a Gymnasium environment id",
    )
    group = parser.add_argument_group("which states fail, where the model does not say it")
    group.add_argument("--fail-label", metavar="NAME", help="the label of the fail states")
    group.add_argument(
        "--fail-states", metavar="STATES", type=parse_states, help="such as 5,7,11-12"
    )
    group.add_argument(
        "--fail-if",
        metavar="CONDITION",
        help="transitions that fail, a condition on s, a, r, s2 and done, such as 'r <= -100'",
    )
    parser.add_argument(
        "--env-arg",
        metavar="KEY=VALUE",
        type=parse_argument,
        action="append",
        help="an argument of the environment, such as is_slippery=False; may be repeated",
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=parse_seed,
        help="of the reset that draws a MiniGrid's layout (default: 0)",
    )
    parser.add_argument(
        "--constants", metavar="VALUES", help="constants of a PRISM or JANI model, such as N=4,K=2"
    )


def read_source(arguments: argparse.Namespace) -> SafeMDP:
    """The model that the arguments name."""
    from dead_ends.io import load_model

    return load_model(
        arguments.file,
        fail_label=arguments.fail_label,
        fail_states=arguments.fail_states,
        fail_if=arguments.fail_if,
        arguments=dict(arguments.env_arg) if arguments.env_arg else None,
        constants=arguments.constants,
        seed=arguments.seed,
    )


def add_discount_argument(parser: argparse.ArgumentParser) -> None:
    """--gamma-safe."""
    parser.add_argument(
        "--gamma-safe",
        metavar="GAMMA",
        type=parse_discount,
        default=0.99,
        help="the discount of the cost, as 0.99 or 99/100 (default: %(default)s)",
    )


def parse_discount(text: str) -> float | Fraction:
    """A discount in (0, 1]; a fraction keeps what follows exact."""
    value = _parse_number(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not in (0, 1]")
    return value


def parse_threshold(text: str) -> float | Fraction:
    """A positive threshold; a fraction is compared exactly."""
    value = _parse_number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return value


def _parse_number(text: str) -> float | Fraction:
    try:
        return Fraction(text) if "/" in text else float(text)
    except (ValueError, ZeroDivisionError):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None


def parse_states(text: str) -> list[int]:
    """Numbers of states such as ``5,7,11-12``."""
    states: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise argparse.ArgumentTypeError(f"'{part}' is neither a state nor a range of states")
        numbers = range(int(first), int(last if dash else first) + 1)
        if len(numbers) > MAX_LISTED_STATES:
            raise argparse.ArgumentTypeError(f"'{part}' are too many states to list")
        states += numbers
    return states


def parse_seed(text: str) -> int:
    """A seed for an environment's reset."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a seed such as 0, 1 or 2")
    return int(text)


def parse_argument(text: str) -> tuple[str, Any]:
    """``KEY=VALUE``; a value that is no Python literal is a string."""
    key, equals, value = text.partition("=")
    if not equals or not key.isidentifier():
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form KEY=VALUE")
    try:
        return key, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return key, value


def print_rows(rows: Sequence[tuple[str, Any]]) -> None:
    """Names and values in two columns."""
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        text = f"{value:,}" if isinstance(value, int) else str(value)
        print(f"  {name:<{width}}  {text}")
