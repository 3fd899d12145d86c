"""The arguments by which every command is told its model, and what they name."""

from __future__ import annotations

import argparse
import ast
import sys
import warnings
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dead_ends.model.safe_mdp import SafeMDP

MAX_LISTED_STATES = 10_000_000
MAX_DIGITS = 20


def add_source_arguments(parser: argparse.ArgumentParser) -> None:
    """FILE and the options that say what the file does not."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help="a model (.npz; .tra with .lab and .sta; .drn; with stormpy also PRISM's .prism, .nm "
        "and .pm, .jani and .umb; text also as .gz) or a Gymnasium environment id",
    )
    group = parser.add_argument_group("which states fail, where the model does not say it")
    group.add_argument(
        "--fail-label",
        metavar="NAME",
        action="append",
        help="the label of the fail states; may be repeated, as the next two",
    )
    group.add_argument(
        "--fail-states",
        metavar="STATES",
        type=parse_states,
        action="extend",
        help="such as 5,7,11-12",
    )
    group.add_argument(
        "--fail-if",
        metavar="CONDITION",
        action="append",
        help="transitions that fail, a condition on s, a, r, s2 and done, such as 'r <= -100'; or "
        "states that fail, by a model's variables, such as 'x == 2 and not open'",
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
        "--constants",
        metavar="VALUES",
        action="append",
        help="constants of a PRISM or JANI model, such as N=4,K=2",
    )
    parser.add_argument(
        "--normalise",
        action="store_true",
        help="divide probabilities that miss 1 by 1e-6, or 5e-7 each, as those of six digits do, "
        "by their sum",
    )


def read_source(arguments: argparse.Namespace) -> SafeMDP:
    """The model that the arguments name; what selects no fail state is said on standard error."""
    from dead_ends.io import NoFailureWarning, load_model

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", NoFailureWarning)
        model = load_model(
            arguments.file,
            fail_label=arguments.fail_label,
            fail_states=arguments.fail_states,
            fail_if=_any_of(arguments.fail_if),
            arguments=dict(arguments.env_arg) if arguments.env_arg else None,
            constants=",".join(arguments.constants) if arguments.constants else None,
            normalise=arguments.normalise,
            seed=arguments.seed,
        )
    for warning in caught:
        if issubclass(warning.category, NoFailureWarning):
            print(f"dead-ends: {warning.message}", file=sys.stderr)
        else:
            warnings.showwarning(
                warning.message, warning.category, warning.filename, warning.lineno
            )
    return model


def _any_of(conditions: list[str] | None) -> str | None:
    if conditions is None or len(conditions) == 1:
        return conditions[0] if conditions else None
    return " or ".join(f"({condition})" for condition in conditions)


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
        if len(first) > MAX_DIGITS or len(last) > MAX_DIGITS:
            raise argparse.ArgumentTypeError(f"'{part[:40]}...' has too many digits for a state")
        start, stop = int(first), int(last if dash else first) + 1
        if stop <= start:
            raise argparse.ArgumentTypeError(f"'{part}' is no range: {last} comes before {first}")
        if stop - start > MAX_LISTED_STATES - len(states):
            raise argparse.ArgumentTypeError(f"'{part}' are too many states to list")
        states += range(start, stop)
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


def read_policy(path: str | Path) -> NDArray[Any]:
    """A policy in a .npy file.

    Raises:
        ValueError: if the file holds none.
    """
    import numpy as np

    try:
        policy = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise ValueError(f"{path}: not a policy in .npy form: {error}") from None
    if not isinstance(policy, np.ndarray):
        raise ValueError(f"{path}: not a policy in .npy form: it holds several arrays")
    return policy
