"""Explicit files of PRISM, and of Storm: model.tra, model.lab and model.sta.

``.tra`` begins with "states choices transitions" (MDP) or "states transitions" (DTMC), then has
a line "state choice successor probability [action]" or "state successor probability" a
transition. ``.lab`` begins with the labels, ``0="init" 1="deadlock" 2="crash"``, then has a line
"state: label label ..." a state with labels. ``.sta``, optional, begins with the variables,
``(x,y)``, then has a line "state:(value,value)" a state; a condition may use them. The three lie
side by side and differ in their suffix; each may be compressed, as ``model.tra.gz``.

Storm's dialect: ``.tra`` begins with "mdp" or "dtmc" and announces no sizes; ``.lab`` lists the
labels between ``#DECLARATION`` and ``#END``, then has a line "state label label ..." a state.

Files of other kinds (games, continuous time, intervals, ...) and of other forms (rows, Matlab,
MRMC) are refused by name. A chain in continuous time whose rates sum to 1 and that does not say
what it is cannot be told from a DTMC.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from dead_ends.io.compressed import GZIP, plain_path
from dead_ends.io.errors import located
from dead_ends.io.explicit import (
    Explicit,
    Failure,
    Integers,
    Mask,
    check_action_names,
    check_distributions,
    check_no_estimate,
    count_distinct,
    explicit_model,
    is_utf8,
    kind_of_value,
    model_labels,
    model_rows,
    read_probabilities,
    read_states,
    unreadable_kind,
)
from dead_ends.io.tokens import Tokens
from dead_ends.model.memory import require_memory
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["load_prism", "save_prism"]

_LABEL = re.compile(r'(\d+)="([^"]*)"')
_KIND = re.compile(r"# Transitions \((\w+)\)")
"""How PRISM's files begin since version 4.8.1."""

_IDENTIFIER = re.compile(r"[^\W\d]\w*")
_DECLARATION, _END = "#DECLARATION", "#END"
STATE_BYTES = 80
"""What a state costs at least: a first line may announce billions that do not follow."""

RATE_TOLERANCE = 1e-6
"""A number above 1 by more than this is a rate, not a probability."""

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
    labels, names = _beside(path, ".lab"), _beside(path, ".sta")
    if labels is not None:
        explicit = replace(explicit, labels=_read_labels(Tokens(labels), explicit.num_states))
    if names is not None:
        table = _read_values(Tokens(names), explicit.num_states)
        explicit = replace(explicit, state_names=_state_names(table), variables=_variables(table))
    with located(path):
        return explicit_model(explicit, failure or Failure(), normalise)


def save_prism(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    """Write model.tra, model.lab and, if states have names, model.sta.

    Labels: init, deadlock, fail, terminal. Fail states stay where they are. Rewards, geometry
    and the weights of the initial states are not part of the format. Each file is written
    whole or not at all, the .tra file last.

    Raises:
        ValueError: if a name cannot be written, the model is an estimate (the format cannot
            say so), the folder does not exist, or compressed labels or states lie there.
        OSError: if a file cannot be written.
    """
    check_no_estimate(path, model)
    _check_names(model, path)
    target = Path(path)
    labels, states = (target.with_suffix(suffix) for suffix in (".lab", ".sta"))
    for beside in (Path(f"{labels}{GZIP}"), Path(f"{states}{GZIP}")):
        if beside.exists():
            raise ValueError(f"{path}: {beside} is there, and would be read with this model")
    with ExitStack() as files:  # renamed in reverse order, once all are written
        _write_transitions(files.enter_context(atomic_path(target)), model)
        _write_labels(files.enter_context(atomic_path(labels)), model)
        if model.state_names is not None:
            _write_names(files.enter_context(atomic_path(states)), model.state_names)
    if model.state_names is None:
        states.unlink(missing_ok=True)  # of the model that was there


def _beside(path: str | os.PathLike[str], suffix: str) -> Path | None:
    """The file of another suffix beside a .tra file, compressed or not, if there is one."""
    plain = plain_path(path).with_suffix(suffix)
    there = [one for one in (plain, Path(f"{plain}{GZIP}")) if one.exists()]
    if len(there) > 1:
        raise ValueError(f"{path}: which labels or states? there are {there[0]} and {there[1]}")
    return there[0] if there else None


def _content(tokens: Tokens) -> tuple[Integers, Integers]:
    """The lines that are neither empty nor comments, and the first token of each."""
    lines = np.flatnonzero(tokens.counts > 0)
    lines = lines[tokens.initials(tokens.first[lines]) != ord("#")]
    if not len(lines):
        raise ValueError(f"{tokens.path}: the file is empty")
    return lines, tokens.first[lines]


@dataclass(frozen=True)
class _Sizes:
    """What the first line of a .tra file says; None: it does not say it."""

    is_mdp: bool
    states: int | None = None
    choices: int | None = None
    transitions: int | None = None


def _read_sizes(tokens: Tokens, line: int) -> _Sizes:
    """The first line: numbers (PRISM) or the kind of the model (Storm).

    Raises:
        ValueError: naming the file and line, and the kind or the form if it is another one.
    """
    comment = _KIND.match(tokens.line_text(0))
    text = tokens.line_text(line)
    refusal = unreadable_kind(comment[1] if comment else text) or _other_form(text)
    if refusal:
        raise tokens.error(line, refusal)
    if text.lower() in ("mdp", "dtmc"):
        return _Sizes(text.lower() == "mdp")
    header = np.arange(tokens.first[line], tokens.first[line + 1])
    if len(header) not in (2, 3):
        raise tokens.error(
            line,
            "expected 'states transitions' or 'states choices transitions', "
            "or in Storm's dialect 'dtmc' or 'mdp'",
        )
    sizes = tokens.integers(header, "a number of states, choices or transitions").tolist()
    return _Sizes(len(header) == 3, sizes[0], sizes[1] if len(header) == 3 else None, sizes[-1])


def _other_form(text: str) -> str | None:
    """A sentence on a first line that begins another kind of file."""
    words = text.split()
    if ":" in words[0] and words[0].replace(":", "").isdecimal():  # states:players
        return unreadable_kind("SMG")
    if len(words) == 4 and all(word.isdecimal() for word in words):
        return unreadable_kind("POMDP")
    for name, found in (
        ("in the form of MRMC", words[0] == "STATES"),
        ("Matlab code", "sparse(" in text or words[0].startswith("%")),
        ("a picture for Graphviz", words[0] == "digraph"),
        ("a DRN file", text.startswith(("@type", "// Exported by"))),
    ):
        if found:
            return f"the file is {name}; PRISM's plain form can be read"
    return None


def _check_form(tokens: Tokens, line: int, is_mdp: bool) -> None:
    """Check at the first transition that the file is neither in rows nor without probabilities."""
    words = tokens.line_text(line).split()
    if any(":" in word for word in words[1:3]):
        raise tokens.error(
            line, "the file is in rows (PRISM's -exportrows); export it without that option"
        )
    nameless = len(words) == 4 and _IDENTIFIER.fullmatch(words[3])
    if is_mdp and (len(words) == 3 or nameless):
        raise tokens.error(line, f"there is no probability: {unreadable_kind('LTS')}")


def _read_transitions(tokens: Tokens, normalise: bool) -> Explicit:
    lines, first = _content(tokens)
    sizes = _read_sizes(tokens, int(lines[0]))
    lines, first = lines[1:], first[1:]
    if len(lines):
        _check_form(tokens, int(lines[0]), sizes.is_mdp)
    width = 4 if sizes.is_mdp else 3
    counts = tokens.counts[lines]
    wrong = np.flatnonzero((counts != width) & (counts != width + 1))
    if len(wrong):
        what = f"state{' choice' if sizes.is_mdp else ''} successor probability [action]"
        more = counts[wrong[0]] > width
        hint = kind_of_value(tokens.text(int(first[wrong[0]]) + width - 1)) if more else ""
        raise tokens.error(int(lines[wrong[0]]), f"expected '{what}'{hint}")
    _check_length(tokens, lines, sizes.transitions)
    num_states = _count_states(tokens, first, first + width - 2, sizes.states)
    require_memory(STATE_BYTES * num_states, f"{tokens.path}: a model of {num_states:,} states")
    source = read_states(tokens, first, num_states)
    choice = tokens.integers(first + 1, "a choice") if sizes.is_mdp else np.zeros_like(source)
    target = read_states(tokens, first + width - 2, num_states)
    probability = read_probabilities(tokens, first + width - 1)
    _check_rates(tokens, first + width - 1, probability, sizes.is_mdp)
    _check_choices(tokens, lines, source, choice, sizes)
    check_distributions(tokens, lines, source, choice, probability, normalise)
    named = counts == width + 1
    choice_name = np.full(len(source), -1, dtype=np.int64)
    names, choice_name[named] = tokens.distinct((first + width)[named])
    return Explicit(
        source, choice, target, probability, num_states, {}, names, choice_name, state_names=None
    )


def _check_length(tokens: Tokens, lines: Integers, announced: int | None) -> None:
    """All transitions are there, or at least the last line is whole."""
    last = int(lines[-1]) if len(lines) else 0
    if announced is None:
        _check_end(tokens)
        if not len(lines):
            raise tokens.error(last, "there are no transitions")
    elif len(lines) < announced:
        raise tokens.error(last, f"the file ends after {len(lines)} of {announced} transitions")
    elif len(lines) > announced:
        raise tokens.error(
            last, f"the first line announces {announced} transitions, there are {len(lines)}"
        )


def _count_states(tokens: Tokens, source: Integers, target: Integers, announced: int | None) -> int:
    """The announced number of states, or one more than the highest number in the file."""
    if announced is not None:
        return announced
    ends = (tokens.integers(places, "a state") for places in (source, target))
    return max(int(states.max()) for states in ends) + 1


def _check_rates(tokens: Tokens, places: Integers, probability: NDArray[Any], is_mdp: bool) -> None:
    """No probability is above 1; rates may be."""
    high = np.flatnonzero(probability > 1 + RATE_TOLERANCE)
    if len(high):
        token = int(places[high[0]])
        raise tokens.error_at(
            token,
            f"{tokens.text(token)} is no probability but a rate: "
            f"{unreadable_kind('CTMDP' if is_mdp else 'CTMC')}",
        )


def _check_choices(
    tokens: Tokens, lines: Integers, source: Integers, choice: Integers, sizes: _Sizes
) -> None:
    if not sizes.is_mdp:
        return
    bound = len(lines) if sizes.choices is None else sizes.choices
    high = np.flatnonzero(choice >= bound)
    if len(high):
        raise tokens.error(
            int(lines[high[0]]), f"choice {choice[high[0]]} of {bound} choices in all"
        )
    found = count_distinct(source * bound + choice)
    if sizes.choices is not None and found != bound:
        raise tokens.error(0, f"the first line announces {bound} choices, there are {found}")


def _read_labels(tokens: Tokens, num_states: int) -> dict[str, Mask]:
    if tokens.first[-1] and tokens.text(0) == _DECLARATION:
        return _read_declared_labels(tokens, num_states)
    lines, first = _content(tokens)
    numbers = _label_numbers(tokens, int(lines[0]))
    lines, first = lines[1:], first[1:]
    counts = tokens.counts[lines]
    good = (tokens.finals(first) == ord(":")) & (counts > 1)
    if not good.all():
        raise tokens.error(int(lines[np.argmin(good)]), "expected 'state: label label ...'")
    _check_end(tokens)
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


def _check_end(tokens: Tokens) -> None:
    """A file that announces no size must end with a whole line: a lost label may be a lost
    failure."""
    if not tokens.ended:
        raise tokens.error(len(tokens.counts) - 1, "the line has no end; is the file truncated?")


def _read_declared_labels(tokens: Tokens, num_states: int) -> dict[str, Mask]:
    """Storm's dialect: #DECLARATION label label ... #END, then 'state label label ...'."""
    names: list[str] = []
    for token in range(1, int(tokens.first[-1])):
        name = tokens.name(token)
        if name == _END:
            break
        if name in names:
            raise tokens.error_at(token, f"two labels are called '{name}'")
        names.append(name)
    else:
        raise tokens.error(len(tokens.counts) - 1, f"there is no {_END} of the labels")
    _check_end(tokens)
    line = int(tokens.lines_of(np.array([token]))[0])
    if tokens.first[line + 1] > token + 1:
        raise tokens.error(line, f"expected a new line after {_END}")
    lines = np.flatnonzero(tokens.counts > 0)
    lines = lines[lines > line]
    states = read_states(tokens, tokens.first[lines], num_states)
    members = np.setdiff1d(np.arange(token + 1, tokens.first[-1]), tokens.first[lines])
    owner = np.repeat(states, tokens.counts[lines] - 1)
    found, which = tokens.distinct(members)
    labels = {name: np.zeros(num_states, dtype=np.bool_) for name in names}
    for number, name in enumerate(found):
        if name not in labels:
            at = int(members[np.argmax(which == number)])
            raise tokens.error_at(at, f"the label '{name}' is not declared")
        labels[name][owner[which == number]] = True
    return labels


def _label_numbers(tokens: Tokens, line: int) -> dict[int, str]:
    text = tokens.line_text(line)
    if _LABEL.sub("", text).strip() or not text:
        expected = 'expected the labels, such as 0="init" 1="fail"'
        raise tokens.error(line, _other_form(text) or expected)
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
        expected = "expected the variables, such as (x,y)"
        raise tokens.error(int(lines[0]), _other_form(header) or expected)
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
        if rows[int(number)] is not None:
            raise tokens.error(line, f"state {int(number)} for the second time")
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
            for kind in (np.float64, np.int64):  # integers are exact, also beyond 2**53
                with suppress(ValueError, OverflowError):  # texts
                    columns[name] = np.array(values).astype(kind)
    return columns


def _check_names(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    check_action_names(path, model)
    for name in model.state_names or ():
        if name.strip() != name or "\n" in name or "\r" in name or not is_utf8(name):
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
