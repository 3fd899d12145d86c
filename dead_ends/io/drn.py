"""Storm's DRN files: states with labels, their actions, and the successors of each.

    @type: MDP
    @nr_states
    2
    @nr_choices
    3
    @model
    state 0 init
        action go
            0 : 0.5
            1 : 0.5
        action wait
            0 : 1
    state 1 fail
        action go
            1 : 1

MDPs and DTMCs are read, in floats or fractions; other kinds are refused by name. Rewards, in
brackets after a state or an action, are skipped. Labels stand between blanks or, if they have
blanks themselves or begin with a bracket, in quotation marks, ``"far away" door[0]``; the format
knows no escapes. The name of an action ends with the first blank. ``@placeholders`` such as
``$0 : 0.5`` stand for probabilities. What Storm's own parser drops without a word, as the second
word of an action's name or what sticks to a quotation mark, is refused here. A comment
``//[x=1 & y=2]`` after a state, as Storm writes it, is the state's name.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from dead_ends.io.atomic import atomic_path
from dead_ends.io.errors import located
from dead_ends.io.explicit import (
    INTERVALS,
    Explicit,
    Failure,
    Integers,
    Mask,
    check_action_names,
    check_distributions,
    check_no_estimate,
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
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["load_drn", "read_drn", "save_drn"]

_NO_LABEL = "__NOLABEL__"
"""What Storm writes for a choice without a label."""

_ENTRIES = (
    "@type",
    "@value_type",
    "@parameters",
    "@placeholders",
    "@reward_models",
    "@nr_states",
    "@nr_choices",
)
_INTERVALS = ("double-interval", "rational-interval")
_NAME_BREAK = "\t& "
"""Storm's separator of variables in a comment."""

_INDEX = re.compile("0|[1-9][0-9]{0,8}")
_BLANK = r"[ \t\v\f\r]"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?:/\d+)?|[+-]?inf|nan|\$[^],]+"
_REWARDS = re.compile(rf"\[ *(?:{_NUMBER})(?: *, *(?:{_NUMBER}))* *\]", re.ASCII)
_LABEL = re.compile(
    rf'{_BLANK}*(?:"([^"]+)"(?={_BLANK}|"|\Z)|([^"[ \t\v\f\r][^" \t\v\f\r]*)(?={_BLANK}|\Z))'
)


def load_drn(
    path: str | os.PathLike[str], failure: Failure | None = None, *, normalise: bool = False
) -> SafeMDP:
    """The model in a DRN file.

    Raises:
        ValueError: naming the file and line at fault.
        OSError: if there is no such file.
    """
    explicit = read_drn(path, normalise=normalise)
    with located(path):
        return explicit_model(explicit, failure or Failure(), normalise)


def save_drn(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    """Write a model.

    Labels: init, fail, terminal. Fail states stay where they are. Names of states become
    comments; actions that are called 0, 1, 2, ... are read back without names. Rewards,
    geometry and the weights of the initial states are not part of it.

    Raises:
        ValueError: if a name cannot be written, the model is an estimate (the format cannot
            say so), or the folder does not exist.
        OSError: if the file cannot be written; then nothing is left behind.
    """
    check_no_estimate(path, model)
    check_action_names(path, model)
    for name in model.state_names or ():
        if "\n" in name or "\r" in name or _NAME_BREAK in name or not is_utf8(name):
            raise ValueError(f"{path}: the state's name {name!r} cannot be written")
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(_lines(model))


def _lines(model: SafeMDP) -> Iterator[str]:
    rows = model_rows(model)
    labels = {name: mask for name, mask in model_labels(model).items() if mask.any()}
    names = model.state_names
    yield f"@type: {'DTMC' if model.num_actions == 1 else 'MDP'}\n"
    yield f"@value_type: {'double' if model.exact is None else 'rational'}\n"
    yield "@parameters\n\n@reward_models\n\n"
    yield f"@nr_states\n{model.num_states}\n@nr_choices\n{rows.num_choices}\n@model\n"
    columns = zip(rows.state, rows.choice, rows.action, rows.target, rows.probability, strict=True)
    for state, of_state in groupby(columns, key=lambda row: row[0]):
        own = "".join(f" {name}" for name, mask in labels.items() if mask[state])
        yield f"state {state}{own}\n"
        if names is not None:
            yield f"//[{names[state]}]\n"
        for (_, action), of_choice in groupby(of_state, key=lambda row: row[1:3]):
            yield f"\taction {action}\n"
            for _, _, _, target, probability in of_choice:
                yield f"\t\t{target} : {probability}\n"


@dataclass(frozen=True)
class _Header:
    deterministic: bool
    num_states: int
    num_choices: int | None
    placeholders: Mapping[bytes, bytes]
    body: int
    """The line after @model."""


def read_drn(path: str | os.PathLike[str], *, normalise: bool = False) -> Explicit:
    """What a DRN file says, before it is decided which states fail.

    Raises:
        ValueError: naming the file and line at fault.
        OSError: if there is no such file.
    """
    tokens = Tokens(path)
    header = _read_header(tokens)
    states, actions, moves = _sort_lines(tokens, header.body)
    _check_counts(tokens, states, actions, header)
    owner = np.searchsorted(states, actions) - 1  # the state of each action line
    begins = np.searchsorted(owner, np.arange(header.num_states))
    choice = np.arange(len(actions)) - begins[owner] if len(actions) else owner
    of_action = np.searchsorted(actions, moves) - 1
    _check_order(tokens, states, actions, moves, owner, of_action)
    if header.deterministic:
        _check_chain(tokens, actions, choice)
    places = tokens.first[moves]
    target = read_states(tokens, places, header.num_states)
    probability = read_probabilities(tokens, places + 2, header.placeholders)
    check_distributions(tokens, moves, owner[of_action], choice[of_action], probability, normalise)
    names, name = _action_names(tokens, actions, choice)
    return Explicit(
        source=owner[of_action],
        choice=choice[of_action],
        target=target,
        probability=probability,
        num_states=header.num_states,
        labels=_read_labels(tokens, states),
        choice_names=names,
        choice_name=name[of_action],
        state_names=_read_names(tokens, states),
    )


def _read_header(tokens: Tokens) -> _Header:
    entries, placeholders, end = _read_entries(tokens)

    def entry(name: str) -> tuple[int, str]:
        return entries.get(name, (end, ""))

    line, kind = entry("@type")
    if kind.upper() not in ("MDP", "DTMC"):
        unknown = f"the type of the model is '{kind}'; MDPs and DTMCs can be read"
        raise tokens.error(line, unreadable_kind(kind) or unknown)
    line, value_type = entry("@value_type")
    if value_type in _INTERVALS:
        raise tokens.error(line, f"{value_type}: {INTERVALS}")
    line_of_parameters, parameters = entry("@parameters")
    if value_type == "parametric" or parameters:
        raise tokens.error(
            line_of_parameters,
            f"the model is parametric ({parameters}); MDPs and DTMCs can be read",
        )
    if value_type not in ("", "double", "rational"):
        raise tokens.error(
            line, f"the type of the values is '{value_type}', not double or rational"
        )
    num_states = _size(tokens, entry("@nr_states"), "@nr_states")
    if num_states is None:
        raise tokens.error(end, "@nr_states is missing before @model")
    num_choices = _size(tokens, entry("@nr_choices"), "@nr_choices")
    return _Header(kind.upper() == "DTMC", num_states, num_choices, placeholders, end + 1)


def _read_entries(
    tokens: Tokens,
) -> tuple[dict[str, tuple[int, str]], dict[bytes, bytes], int]:
    """The header's entries by name, each with its line; the placeholders; the line @model."""
    entries: dict[str, tuple[int, str]] = {}
    placeholders: dict[bytes, bytes] = {}
    key = ""
    for line in range(len(tokens.counts)):
        text = tokens.line_text(line)
        if text == "@model":
            return entries, placeholders, line
        if not text or text.startswith("//"):
            continue
        if text.startswith("@"):
            key, _, value = text.partition(":")
            if key not in _ENTRIES:
                raise tokens.error(line, f"'{key}' is unknown (known: {', '.join(_ENTRIES)})")
            if key in entries:
                raise tokens.error(line, f"{key} for the second time")
            entries[key] = (line, value.strip())
        elif key == "@placeholders":
            _read_placeholder(tokens, line, placeholders)
        elif key and not entries[key][1]:
            entries[key] = (line, text)
        else:
            raise tokens.error(line, f"expected '@model' or another entry, not '{text}'")
    raise ValueError(f"{tokens.path}: no line '@model'; not a DRN file, or it is truncated")


def _read_placeholder(tokens: Tokens, line: int, placeholders: dict[bytes, bytes]) -> None:
    words = tokens.line_text(line).encode().split()
    if len(words) != 3 or not words[0].startswith(b"$") or words[1] != b":":
        raise tokens.error(line, "expected a placeholder and its value, such as '$0 : 0.5'")
    if words[0] in placeholders:
        raise tokens.error(line, f"the placeholder {words[0].decode()} for the second time")
    placeholders[words[0]] = words[2]


def _size(tokens: Tokens, entry: tuple[int, str], name: str) -> int | None:
    line, text = entry
    if not text:
        return None
    if not text.isdecimal():
        raise tokens.error(line, f"'{text}' is not a number, for {name}")
    return int(text)


def _sort_lines(tokens: Tokens, body: int) -> tuple[Integers, Integers, Integers]:
    """The lines of states, of actions and of transitions; every other line is a comment."""
    lines = np.flatnonzero(tokens.counts > 0)
    lines = lines[lines >= body]
    initial = tokens.initials(tokens.first[lines])
    keep = np.ones(len(lines), dtype=np.bool_)
    slashes = np.flatnonzero(initial == ord("/"))
    keep[slashes] = [not tokens.raw(at).startswith(b"//") for at in tokens.first[lines[slashes]]]
    states, actions = (lines[keep & (initial == ord(letter))] for letter in "sa")
    moves = lines[keep & (initial != ord("s")) & (initial != ord("a"))]
    for own, keyword in ((states, "state"), (actions, "action")):
        words, which = tokens.distinct(tokens.first[own])
        good = np.array([word == keyword for word in words], dtype=np.bool_)[which]
        good &= tokens.counts[own] >= 2
        if not good.all():
            raise tokens.error(int(own[good.argmin()]), f"expected '{keyword} ...'")
    _check_moves(tokens, moves)
    return states, actions, moves


def _check_moves(tokens: Tokens, moves: Integers) -> None:
    """Every other line is a transition, 'state : probability'."""
    good = tokens.counts[moves] == 3
    places = tokens.first[moves][good] + 1
    good[good] = (tokens.initials(places) == ord(":")) & (tokens.finals(places) == ord(":"))
    if good.all():
        return
    line = int(moves[good.argmin()])
    value = tokens.line_text(line).partition(" : ")[2].strip()
    hint = kind_of_value(value) if value else ""
    raise tokens.error(line, f"expected 'state ...', 'action ...' or 'state : probability'{hint}")


def _check_counts(tokens: Tokens, states: Integers, actions: Integers, header: _Header) -> None:
    numbers = tokens.integers(tokens.first[states] + 1, "a state")
    wrong = np.flatnonzero(numbers != np.arange(len(numbers)))
    if len(wrong):
        raise tokens.error(int(states[wrong[0]]), f"expected state {wrong[0]}, in this order")
    last = len(tokens.counts) - 1
    for found, announced, what in (
        (len(states), header.num_states, "states"),
        (len(actions), header.num_choices, "choices"),
    ):
        if announced is not None and found != announced:
            raise tokens.error(last, f"the file ends after {found} of {announced} {what}")


def _check_order(
    tokens: Tokens,
    states: Integers,
    actions: Integers,
    moves: Integers,
    owner: Integers,
    of_action: Integers,
) -> None:
    """Actions follow their state, transitions their action."""
    if len(owner) and owner[0] < 0:
        raise tokens.error(int(actions[0]), "an action before the first state")
    if len(of_action) and of_action[0] < 0:
        raise tokens.error(int(moves[0]), "a transition before the first action")
    own = np.searchsorted(states, moves) - 1
    stray = np.flatnonzero(own != owner[of_action])
    if len(stray):
        raise tokens.error(int(moves[stray[0]]), "a transition before the state's first action")
    idle = np.flatnonzero(np.bincount(of_action, minlength=len(actions)) == 0)
    if len(idle):
        raise tokens.error(int(actions[idle[0]]), "an action without a transition")


def _check_chain(tokens: Tokens, actions: Integers, choice: Integers) -> None:
    """A Markov chain has no choices."""
    second = np.flatnonzero(choice > 0)
    if len(second):
        raise tokens.error(int(actions[second[0]]), "a state of a DTMC has a second action")


def _action_names(
    tokens: Tokens, actions: Integers, choice: Integers
) -> tuple[list[str], Integers]:
    """The different names, and which each action line has; -1 for none.

    Where each choice is named by its own number no choice has a name.
    """
    _check_actions(tokens, actions)
    names, which = tokens.distinct(tokens.first[actions] + 1)
    if all(_INDEX.fullmatch(name) for name in names):
        number = np.array([int(name) for name in names], dtype=np.int64)
        if np.array_equal(number[which], choice):
            return [], np.full(len(actions), -1)
    if _NO_LABEL in names:
        none = names.index(_NO_LABEL)
        which = np.where(which == none, -1, which - (which > none))
        names.remove(_NO_LABEL)
    return names, which


def _check_actions(tokens: Tokens, actions: Integers) -> None:
    """Nothing follows an action's name but rewards, for a name ends with the first blank."""
    name = tokens.first[actions] + 1
    good = tokens.adjacent(name - 1) & tokens.closed(name)
    more = tokens.counts[actions] > 2
    first, last = name[more] + 1, tokens.first[actions[more] + 1] - 1
    rests, which = tokens.distinct(first, last)
    rewards = [rest == "[]" or _REWARDS.fullmatch(rest) is not None for rest in rests]
    good[more] &= tokens.adjacent(first - 1) & np.array(rewards, dtype=np.bool_)[which]
    if not good.all():
        line = int(actions[good.argmin()])
        text = tokens.line_text(line)
        raise tokens.error(
            line, f"'{text}': the name of an action has no blanks, and only [rewards] follow it"
        )


def _read_labels(tokens: Tokens, states: Integers) -> dict[str, Mask]:
    """The states of each label; the same words on many lines are read once."""
    more = np.flatnonzero(tokens.counts[states] > 2)
    if not len(more):
        return {}
    lines = states[more]
    first = tokens.first[lines] + 2
    far = np.flatnonzero((tokens.initials(first) == ord("[")) & ~tokens.adjacent(first - 1))
    if len(far):
        raise tokens.error(int(lines[far[0]]), "one space separates a state from its rewards")
    texts, which = tokens.distinct(first, tokens.first[lines + 1] - 1)
    order = np.argsort(which, kind="stable")
    owners = np.split(more[order], np.cumsum(np.bincount(which, minlength=len(texts)))[:-1])
    labels: dict[str, Mask] = {}
    for text, own in zip(texts, owners, strict=True):
        for label in _labels(tokens, int(states[own[0]]), text):
            labels.setdefault(label, np.zeros(len(states), dtype=np.bool_))[own] = True
    return labels


def _labels(tokens: Tokens, line: int, text: str) -> list[str]:
    """The labels of a state, after its rewards."""
    rewards = _REWARDS.match(text)
    place = rewards.end() if rewards else 0
    labels: list[str] = []
    while place < len(text):
        found = _LABEL.match(text, place)
        if found is None:
            raise tokens.error(
                line,
                f"'{text[place:].strip()}': labels stand between blanks, or in quotation marks "
                "if they have blanks or begin with '['",
            )
        place = found.end()
        labels.append(found[1] or found[2])
        if labels[-1] in labels[:-1]:
            raise tokens.error(line, f"two labels are called '{labels[-1]}'")
    return labels


def _read_names(tokens: Tokens, states: Integers) -> tuple[str, ...] | None:
    """The comments after the states, if each has one."""
    names = []
    for line in (states + 1).tolist():
        comment = tokens.line_text(line) if line < len(tokens.counts) else ""
        if not (comment.startswith("//[") and comment.endswith("]")):
            return None
        names.append(", ".join(comment[3:-1].split(_NAME_BREAK)))
    return tuple(names)
