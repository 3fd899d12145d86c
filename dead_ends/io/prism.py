"""PRISM's explicit files: model.tra, model.lab and model.sta.

``.tra`` begins with "states choices transitions" (MDP) or "states transitions" (DTMC), then has
a line "state choice successor probability [action]" or "state successor probability" a
transition. ``.lab`` begins with the labels, ``0="init" 1="deadlock" 2="crash"``, then has a line
"state: label label ..." a state with labels. ``.sta``, optional, begins with the variables,
``(x,y)``, then has a line "state:(value,value)" a state; a condition may use them.
The three lie side by side and differ in their suffix.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from dead_ends.io.errors import located
from dead_ends.io.explicit import (
    Explicit,
    Failure,
    Integers,
    Mask,
    check_distributions,
    check_no_estimate,
    count_distinct,
    explicit_model,
    model_labels,
    model_rows,
    read_states,
)
from dead_ends.io.tokens import Tokens
from dead_ends.memory import require_memory
from dead_ends.model import SafeMDP

__all__ = ["load_prism", "save_prism"]

_LABEL = re.compile(r'(\d+)="([^"]*)"')
STATE_BYTES = 80
"""What a state costs at least: a first line may announce billions that do not follow."""

_NAMES_HEADER = "(name)"
"""The header of our own .sta files: one variable, whose values are the states' names."""


def load_prism(
    path: str | os.PathLike[str], failure: Failure | None = None, *, normalise: bool = False
) -> SafeMDP:
    """The model in a .tra file, with the .lab and .sta files beside it if there are any.

    Raises:
        ValueError: naming the file and line at fault.
        OSError: if there is no such file.
        MemoryError: if the first line announces more states than fit the memory.
    """
    explicit = _read_transitions(Tokens(path), normalise)
    labels, names = Path(path).with_suffix(".lab"), Path(path).with_suffix(".sta")
    if labels.exists():
        explicit = replace(explicit, labels=_read_labels(Tokens(labels), explicit.num_states))
    if names.exists():
        table = _read_values(Tokens(names), explicit.num_states)
        explicit = replace(explicit, state_names=_state_names(table), variables=_variables(table))
    with located(path):
        return explicit_model(explicit, failure or Failure(), normalise)


def save_prism(path: str | os.PathLike[str], model: SafeMDP) -> None:
    """Write model.tra, model.lab and, if states have names, model.sta.

    Labels: init, deadlock, fail, terminal. Fail states stay where they are. Rewards, geometry
    and the weights of the initial states are not part of the format. Each file is written
    whole or not at all, the .tra file last.

    Raises:
        ValueError: if a name cannot be written, the model is an estimate (the format cannot
            say so), or the folder does not exist.
        OSError: if a file cannot be written.
    """
    check_no_estimate(path, model)
    _check_names(path, model)
    target = Path(path)
    labels, states = (target.with_suffix(suffix) for suffix in (".lab", ".sta"))
    with ExitStack() as files:  # renamed in reverse order, once all are written
        _write_transitions(files.enter_context(atomic_path(target)), model)
        _write_labels(files.enter_context(atomic_path(labels)), model)
        if model.state_names is not None:
            _write_names(files.enter_context(atomic_path(states)), model.state_names)
    if model.state_names is None:
        states.unlink(missing_ok=True)  # of the model that was there


def _content(tokens: Tokens) -> tuple[Integers, Integers]:
    """The lines that are neither empty nor comments, and the first token of each."""
    lines = np.flatnonzero(tokens.counts > 0)
    lines = lines[tokens.initials(tokens.first[lines]) != ord("#")]
    if not len(lines):
        raise ValueError(f"{tokens.path}: the file is empty")
    return lines, tokens.first[lines]


def _read_transitions(tokens: Tokens, normalise: bool) -> Explicit:
    lines, first = _content(tokens)
    header = np.arange(tokens.first[lines[0]], tokens.first[lines[0] + 1])
    if len(header) not in (2, 3):
        raise tokens.error(
            int(lines[0]), "expected 'states transitions' or 'states choices transitions'"
        )
    sizes = tokens.integers(header, "a number of states, choices or transitions").tolist()
    is_mdp, num_states = len(header) == 3, sizes[0]
    require_memory(STATE_BYTES * num_states, f"{tokens.path}: a model of {num_states:,} states")
    lines, first = lines[1:], first[1:]
    width = 4 if is_mdp else 3
    counts = tokens.counts[lines]
    wrong = np.flatnonzero((counts != width) & (counts != width + 1))
    if len(wrong):
        what = "state choice successor probability" if is_mdp else "state successor probability"
        raise tokens.error(int(lines[wrong[0]]), f"expected '{what} [action]'")
    if len(lines) != sizes[-1]:
        raise tokens.error(
            int(lines[-1]) if len(lines) else 0,
            f"the file ends after {len(lines)} of {sizes[-1]} transitions"
            if len(lines) < sizes[-1]
            else f"the first line announces {sizes[-1]} transitions, there are {len(lines)}",
        )
    source = read_states(tokens, first, num_states)
    choice = tokens.integers(first + 1, "a choice") if is_mdp else np.zeros_like(source)
    target = read_states(tokens, first + width - 2, num_states)
    probability = tokens.numbers(first + width - 1, "a probability")
    _check_choices(tokens, lines, source, choice, sizes[1] if is_mdp else None)
    check_distributions(tokens, lines, source, choice, probability, normalise)
    named = counts == width + 1
    choice_name = np.full(len(source), -1, dtype=np.int64)
    names, choice_name[named] = tokens.distinct((first + width)[named])
    return Explicit(
        source, choice, target, probability, num_states, {}, names, choice_name, state_names=None
    )


def _check_choices(
    tokens: Tokens, lines: Integers, source: Integers, choice: Integers, announced: int | None
) -> None:
    if announced is None:
        return
    high = np.flatnonzero(choice >= announced)
    if len(high):
        raise tokens.error(
            int(lines[high[0]]), f"choice {choice[high[0]]} of {announced} choices in all"
        )
    found = count_distinct(source * announced + choice)
    if found != announced:
        raise tokens.error(0, f"the first line announces {announced} choices, there are {found}")


def _read_labels(tokens: Tokens, num_states: int) -> dict[str, Mask]:
    lines, first = _content(tokens)
    numbers = _label_numbers(tokens, int(lines[0]))
    lines, first = lines[1:], first[1:]
    counts = tokens.counts[lines]
    good = (tokens.finals(first) == ord(":")) & (counts > 1)
    if not good.all():
        raise tokens.error(int(lines[np.argmin(good)]), "expected 'state: label label ...'")
    # The file announces no size, and a lost label may be a lost failure.
    if not tokens.ended:
        raise tokens.error(len(tokens.counts) - 1, "the line has no end; is the file truncated?")
    states = read_states(tokens, first, num_states, trim=1)
    before = np.concatenate(([0], np.cumsum(counts - 1)))  # how many members earlier lines have
    members = np.arange(before[-1]) + np.repeat(first + 1 - before[:-1], counts - 1)
    values = tokens.integers(members, "the number of a label")
    unknown = np.flatnonzero(~np.isin(values, list(numbers)))
    if len(unknown):
        token = int(members[unknown[0]])
        raise tokens.error_at(token, f"label {values[unknown[0]]} is not in the first line")
    owner = np.repeat(states, counts - 1)
    labels = {}
    for number, name in numbers.items():
        labels[name] = np.zeros(num_states, dtype=np.bool_)
        labels[name][owner[values == number]] = True
    return labels


def _label_numbers(tokens: Tokens, line: int) -> dict[int, str]:
    text = tokens.line_text(line)
    if _LABEL.sub("", text).strip() or not text:
        raise tokens.error(line, 'expected the labels, such as 0="init" 1="fail"')
    numbers: dict[int, str] = {}
    for number, name in _LABEL.findall(text):
        if name in numbers.values():
            raise tokens.error(line, f"two labels are called '{name}'")
        if int(number) in numbers:
            raise tokens.error(line, f"two labels have the number {number}")
        numbers[int(number)] = name
    return numbers


def _read_values(tokens: Tokens, num_states: int) -> dict[str, list[str]]:
    """The values of each variable, S texts a variable."""
    lines, _ = _content(tokens)
    header = tokens.line_text(int(lines[0]))
    if not (header.startswith("(") and header.endswith(")")):
        raise tokens.error(int(lines[0]), "expected the variables, such as (x,y)")
    variables = header[1:-1].split(",")
    twice = [name for name in variables if variables.count(name) > 1]
    if twice:
        raise tokens.error(int(lines[0]), f"two variables are called '{twice[0]}'")
    rows: list[list[str] | None] = [None] * num_states
    for line in lines[1:].tolist():
        number, colon, values = tokens.line_text(line).partition(":")
        if not (number.isdecimal() and colon and values[:1] == "(" and values[-1:] == ")"):
            raise tokens.error(line, "expected 'state:(value,value,...)'")
        if int(number) >= num_states:
            raise tokens.error(line, f"state {number} does not exist (0 to {num_states - 1})")
        row = [values[1:-1]] if header == _NAMES_HEADER else values[1:-1].split(",")
        if len(row) != len(variables):
            raise tokens.error(line, f"expected {len(variables)} values, not {len(row)}")
        rows[int(number)] = row
    if None in rows:
        raise ValueError(f"{tokens.path}: state {rows.index(None)} is missing")
    columns = zip(*(row for row in rows if row is not None), strict=True)
    return {name: list(column) for name, column in zip(variables, columns, strict=True)}


def _state_names(table: dict[str, list[str]]) -> tuple[str, ...]:
    """States are called by their variables, or by their names in files of ours."""
    if f"({','.join(table)})" == _NAMES_HEADER:
        return tuple(table["name"])
    columns = [[f"{name}={value}" for value in values] for name, values in table.items()]
    return tuple(",".join(row) for row in zip(*columns, strict=True))


def _variables(table: dict[str, list[str]]) -> dict[str, NDArray[Any]]:
    """The variables whose values are all true or false, or all numbers."""
    columns = {}
    for name, values in table.items():
        if set(values) <= {"true", "false"}:
            columns[name] = np.array(values) == "true"
        else:
            with suppress(ValueError):  # texts
                columns[name] = np.array(values).astype(np.float64)
    return columns


def _check_names(path: str | os.PathLike[str], model: SafeMDP) -> None:
    for name in model.action_names or ():
        if not name or name.split() != [name]:
            raise ValueError(f"{path}: the action's name '{name}' cannot be written")
    for name in model.state_names or ():
        if name.strip() != name or "\n" in name or "\r" in name:
            raise ValueError(f"{path}: the state's name {name!r} cannot be written")


def _write_transitions(path: Path, model: SafeMDP) -> None:
    rows = model_rows(model)
    columns = (rows.state, rows.choice, rows.target, rows.probability, rows.action)
    with path.open("w", encoding="utf-8") as file:
        file.write(f"{model.num_states} {rows.num_choices} {len(rows.state)}\n")
        file.writelines(
            f"{state} {choice} {target} {probability} {action}\n"
            for state, choice, target, probability, action in zip(*columns, strict=True)
        )


def _write_names(path: Path, names: Sequence[str]) -> None:
    lines = [f"{state}:({name})" for state, name in enumerate(names)]
    path.write_text("\n".join([_NAMES_HEADER, *lines]) + "\n", encoding="utf-8")


def _write_labels(path: Path, model: SafeMDP) -> None:
    labels = model_labels(model)
    with path.open("w", encoding="utf-8") as file:
        file.write(" ".join(f'{i}="{name}"' for i, name in enumerate(labels)) + "\n")
        table = np.column_stack(list(labels.values()))
        for state in np.flatnonzero(table.any(axis=1)).tolist():
            file.write(f"{state}: {' '.join(map(str, np.flatnonzero(table[state])))}\n")
