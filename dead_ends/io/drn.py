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

MDPs and DTMCs are read; rewards, in brackets after a state or an action, are skipped. A comment
``//[x=1 & y=2]`` after a state, as Storm writes it, is the state's name.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from dead_ends.io.atomic import atomic_path
from dead_ends.io.errors import located
from dead_ends.io.explicit import (
    Explicit,
    Failure,
    Integers,
    Mask,
    check_distributions,
    check_no_estimate,
    explicit_model,
    model_labels,
    model_rows,
    read_states,
)
from dead_ends.io.tokens import Tokens
from dead_ends.model import SafeMDP

__all__ = ["load_drn", "read_drn", "save_drn"]

_NO_LABEL = "__NOLABEL__"
"""What Storm writes for a choice without a label."""


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


def save_drn(path: str | os.PathLike[str], model: SafeMDP) -> None:
    """Write a model.

    Labels: init, fail, terminal. Fail states stay where they are. Names of states become
    comments. Rewards, geometry and the weights of the initial states are not part of it.

    Raises:
        ValueError: if a name cannot be written, the model is an estimate (the format cannot
            say so), or the folder does not exist.
        OSError: if the file cannot be written; then nothing is left behind.
    """
    check_no_estimate(path, model)
    for name in model.action_names or ():
        if not name or name.split() != [name]:
            raise ValueError(f"{path}: the action's name '{name}' cannot be written")
    for name in model.state_names or ():
        if "\n" in name or "\r" in name:
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
    num_states: int
    num_choices: int | None
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
    lines = np.flatnonzero(tokens.counts > 0)
    lines = lines[lines >= header.body]
    first = tokens.first[lines]
    initial = tokens.initials(first)
    keep = initial != ord("/")
    states, actions = (lines[keep & (initial == ord(letter))] for letter in "sa")
    moves = lines[keep & (initial != ord("s")) & (initial != ord("a"))]
    _check_lines(tokens, states, actions, moves)
    _check_counts(tokens, states, actions, header)
    owner = np.searchsorted(states, actions) - 1  # the state of each action line
    begins = np.searchsorted(owner, np.arange(header.num_states))
    choice = np.arange(len(actions)) - begins[owner] if len(actions) else owner
    of_action = np.searchsorted(actions, moves) - 1
    _check_order(tokens, states, actions, moves, owner, of_action)
    places = tokens.first[moves]
    target = read_states(tokens, places, header.num_states)
    probability = tokens.numbers(places + 2, "a probability")
    check_distributions(tokens, moves, owner[of_action], choice[of_action], probability, normalise)
    names, name = _action_names(tokens, actions)
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
    entries: dict[str, tuple[int, str]] = {}
    key = ""
    for line in range(len(tokens.counts)):
        text = tokens.line_text(line)
        if text == "@model":
            break
        if text.startswith("@"):
            key, _, value = text.partition(":")
            entries[key] = (line, value.strip())
        elif text and not text.startswith("//") and key:
            entries[key] = (line, text)
    else:
        raise ValueError(f"{tokens.path}: no line '@model'; not a DRN file, or it is truncated")
    at, kind = entries.get("@type", (line, ""))
    if kind.upper() not in ("MDP", "DTMC"):
        raise tokens.error(at, f"the type of the model is '{kind}'; MDP and DTMC can be read")
    sizes: dict[str, int | None] = {"@nr_states": None, "@nr_choices": None}
    for name in sizes:
        if name in entries:
            at, text = entries[name]
            if not text.isdecimal():
                raise tokens.error(at, f"'{text}' is not a number, for {name}")
            sizes[name] = int(text)
    num_states = sizes["@nr_states"]
    if num_states is None:
        raise tokens.error(line, "@nr_states is missing before @model")
    return _Header(num_states, sizes["@nr_choices"], line + 1)


def _check_lines(tokens: Tokens, states: Integers, actions: Integers, moves: Integers) -> None:
    """Every line is one of the three kinds."""
    for lines, keyword, least in ((states, "state", 2), (actions, "action", 2)):
        words, which = tokens.distinct(tokens.first[lines])
        good = np.array([word == keyword for word in words], dtype=np.bool_)[which]
        good &= tokens.counts[lines] >= least
        if not good.all():
            raise tokens.error(int(lines[good.argmin()]), f"expected '{keyword} ...'")
    good = tokens.counts[moves] == 3
    places = tokens.first[moves][good] + 1
    colon = (tokens.initials(places) == ord(":")) & (tokens.finals(places) == ord(":"))
    good[good] = colon
    if not good.all():
        raise tokens.error(
            int(moves[good.argmin()]), "expected 'state ...', 'action ...' or 'state : probability'"
        )


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


def _action_names(tokens: Tokens, actions: Integers) -> tuple[list[str], Integers]:
    """The different names, and which each action line has; -1 for none, as for mere numbers."""
    names, which = tokens.distinct(tokens.first[actions] + 1)
    if all(name.isdecimal() for name in names):
        return [], np.full(len(actions), -1)
    if _NO_LABEL in names:
        none = names.index(_NO_LABEL)
        which = np.where(which == none, -1, which - (which > none))
        names.remove(_NO_LABEL)
    return names, which


def _read_labels(tokens: Tokens, states: Integers) -> dict[str, Mask]:
    count = tokens.counts[states] - 2
    before = np.concatenate(([0], np.cumsum(count)))
    members = np.arange(before[-1]) + np.repeat(tokens.first[states] + 2 - before[:-1], count)
    owner = np.repeat(np.arange(len(states)), count)
    opened = np.cumsum(tokens.initials(members) == ord("["))
    closed = np.cumsum(tokens.finals(members) == ord("]"))
    closed_before = np.concatenate(([0], closed))[:-1]
    kept = opened == closed_before  # not inside [rewards]
    names, which = tokens.distinct(members[kept])
    labels = {}
    for number, name in enumerate(names):
        own = owner[kept][which == number]
        twice = np.flatnonzero(np.diff(own) == 0)
        if len(twice):
            raise tokens.error(int(states[own[twice[0]]]), f"two labels are called '{name}'")
        labels[name] = np.zeros(len(states), dtype=np.bool_)
        labels[name][own] = True
    return labels


def _read_names(tokens: Tokens, states: Integers) -> tuple[str, ...] | None:
    """The comments after the states, if each has one."""
    names = []
    for line in (states + 1).tolist():
        comment = tokens.line_text(line) if line < len(tokens.counts) else ""
        if not (comment.startswith("//[") and comment.endswith("]")):
            return None
        names.append(", ".join(comment[3:-1].split("\t& ")))
    return tuple(names)
