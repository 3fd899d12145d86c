"""What the explicit formats (PRISM's .tra, Storm's .drn) have in common.

Both list transitions by state and choice, and name sets of states by labels. A model's actions
are the choices' labels where these tell the choices of each state apart, otherwise the
choices' numbers. A state without any choice is a harmless end. Labels with a meaning here:

* ``fail``, or the label that the user names: the fail states;
* ``init``: the initial states, each equally likely;
* ``terminal``: harmless ends, if indeed every choice stays (as our writers leave them).

The formats hold no rewards, and of the initial distribution only its states.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.io.condition import NAMES, evaluate_condition, names_in
from dead_ends.io.errors import warn_no_failure
from dead_ends.io.transitions import Condition, Transitions, build_model, state_mask
from dead_ends.model.checks import ROW_SUM_TOLERANCE, mendable, not_one
from dead_ends.model.safe_mdp import SafeMDP

if TYPE_CHECKING:
    from dead_ends.io.tokens import Tokens

__all__ = [
    "Explicit",
    "Failure",
    "Rows",
    "check_action_names",
    "check_distributions",
    "check_no_estimate",
    "count_distinct",
    "explicit_model",
    "is_utf8",
    "kind_of_value",
    "model_labels",
    "model_rows",
    "read_probabilities",
    "read_states",
    "unreadable_kind",
]

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

MAX_NAMED_ACTIONS = 64
"""With more different labels, and more than any state has choices, choices are numbered: the
tables have a column an action."""

KINDS = {
    "CTMC": "a continuous-time Markov chain (CTMC)",
    "CTMDP": "a continuous-time MDP (CTMDP)",
    "MA": "a Markov automaton",
    "POMDP": "a partially observable MDP (POMDP)",
    "LTS": "a labelled transition system (LTS)",
    "SMG": "a game of several players (SMG)",
    "S2PG": "a game of two players (S2PG)",
    "STPG": "a game of two players (STPG)",
    "CSG": "a concurrent game (CSG)",
    "ICSG": "a concurrent game with intervals of probabilities (ICSG)",
    "IDTMC": "a DTMC with intervals of probabilities (IDTMC)",
    "IMDP": "an MDP with intervals of probabilities (IMDP)",
    "IPOMDP": "a partially observable MDP with intervals of probabilities (IPOMDP)",
    "PTA": "a probabilistic timed automaton (PTA)",
    "POPTA": "a partially observable probabilistic timed automaton (POPTA)",
    "TA": "a timed automaton (TA)",
    "STA": "a stochastic timed automaton (STA)",
    "HA": "a hybrid automaton (HA)",
    "PHA": "a probabilistic hybrid automaton (PHA)",
    "SHA": "a stochastic hybrid automaton (SHA)",
    "TPTG": "a timed game (TPTG)",
    "TSG": "a timed game (TSG)",
}
"""Kinds of models that are not read, by the words that PRISM and Storm have for them."""

INTERVALS = "the model has intervals of probabilities; MDPs and DTMCs can be read"

PARAMETRIC = "the model is parametric; MDPs and DTMCs can be read"

RESERVED = frozenset({"__NOLABEL__"})
"""What Storm writes for a choice without a label: no name."""

_BLANKS = frozenset(" \t\n\v\f\r")
_IDENTIFIER = re.compile(r"[^\W\d]")


@dataclass(frozen=True)
class Failure:
    """Which states of a labelled model fail; several say so together.

    What selects no state is warned of: failure by it is impossible.

    Attributes:
        label: the name of a label, or several of them; "fail" if nothing is said.
        states: a mask (S,) or numbers of states.
        condition: on (s, a, s'), or on the variables of states; see
            :mod:`dead_ends.io.condition`.
    """

    label: str | Sequence[str] | None = None
    states: ArrayLike | None = None
    condition: Condition | None = None

    def among(self, explicit: Explicit) -> tuple[Mask, Condition | None]:
        """The fail states of the file, bool (S,), and the condition on its transitions."""
        result = np.zeros(explicit.num_states, dtype=np.bool_)
        for label in self._labels(explicit.labels):
            result |= explicit.labels[label]
            if not explicit.labels[label].any():
                warn_no_failure(f"no state carries the label '{label}'")
        if self.states is not None:
            result |= state_mask(self.states, explicit.num_states)
        text = self.condition
        if not isinstance(text, str) or not _speaks_of_states(text, explicit.variables):
            return result, self.condition
        chosen = evaluate_condition(text, _columns(explicit.variables))
        if not chosen.any():
            warn_no_failure(f"no state satisfies {text!r}")
        return result | chosen, None

    def _labels(self, declared: Mapping[str, Mask]) -> Sequence[str]:
        silent = self.label is None and self.states is None and self.condition is None
        labels = "fail" if silent else () if self.label is None else self.label
        labels = [labels] if isinstance(labels, str) else labels
        for label in labels:
            if label not in declared:
                known = ", ".join(declared) or "none"
                hint = "; say which states fail (--fail-label NAME)" if silent else ""
                raise ValueError(f"no label '{label}' (labels: {known}){hint}")
        return labels


def _columns(variables: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The variables as a condition names them."""
    plain = {name: values for name, values in variables.items() if name not in NAMES}
    return plain | {f"model.{name}": values for name, values in variables.items()}


def _speaks_of_states(text: str, variables: Mapping[str, NDArray[Any]]) -> bool:
    """Whether a condition is one on the variables of states, and not on transitions.

    Raises:
        ValueError: if it is on both, names neither, or is ambiguous.
    """
    names = names_in(text)
    known = _columns(variables)
    own = [name for name in names if name in known]
    others = [name for name in names if name not in known]
    both = [name for name in others if name in variables]
    if both:
        raise ValueError(
            f"condition {text!r}: '{both[0]}' is a variable of the model too; "
            f"write model.{both[0]} for the variable"
        )
    unknown = [name for name in others if name not in NAMES]
    if variables and unknown:
        raise ValueError(
            f"condition {text!r}: unknown name '{unknown[0]}' "
            f"(known here: s, a, s2, or the variables {', '.join(variables)})"
        )
    if own and others:
        raise ValueError(
            f"condition {text!r}: '{own[0]}' says which states fail and '{others[0]}' which "
            "transitions; one condition can say one of them"
        )
    return bool(own)


@dataclass(frozen=True, eq=False)
class Explicit:
    """N transitions, and the labels of S states.

    Attributes:
        source, choice, target: (N,) numbers of the state, of the choice in it, and of the
            successor, all in range.
        probability: (N,) floats or Fractions.
        labels: bool (S,) by name.
        choice_names: the different labels of choices.
        choice_name: (N,) which of them each transition's choice has; -1: none.
        state_names: S names or None.
        variables: (S,) the values that the model's variables have, by name.
    """

    source: Integers
    choice: Integers
    target: Integers
    probability: NDArray[Any]
    num_states: int
    labels: Mapping[str, Mask]
    choice_names: Sequence[str]
    choice_name: Integers
    state_names: tuple[str, ...] | None
    variables: Mapping[str, NDArray[Any]] = field(default_factory=dict)


def explicit_model(explicit: Explicit, failure: Failure, normalise: bool = False) -> SafeMDP:
    """The safe MDP of a labelled model; ``normalise`` as in :func:`build_model`.

    Raises:
        ValueError: if there is no such label, or naming the state and action at fault.
    """
    action, names = _actions(explicit)
    fail, condition = failure.among(explicit)
    transitions = Transitions(
        source=explicit.source,
        action=action,
        target=explicit.target,
        probability=explicit.probability,
        fail=fail,
        terminal=_ends(explicit) & ~fail,
        num_actions=int(action.max(initial=0)) + 1 if names is None else len(names),
        initial=_initial(explicit),
        state_names=explicit.state_names,
        action_names=names,
    )
    return build_model(transitions, condition, normalise=normalise)


def read_states(tokens: Tokens, places: Integers, num_states: int, trim: int = 0) -> Integers:
    """The numbers of states at these tokens, without ``trim`` bytes at each token's end.

    Raises:
        ValueError: naming the file and line of the first that is no state.
    """
    states = tokens.integers(places, "a state", trim)
    bad = np.flatnonzero(states >= num_states)
    if len(bad):
        raise tokens.error_at(
            int(places[bad[0]]), f"state {states[bad[0]]} does not exist (0 to {num_states - 1})"
        )
    return states


def unreadable_kind(kind: str) -> str | None:
    """A sentence that refuses a kind of model; None for MDPs, DTMCs and unknown words."""
    name = KINDS.get("MA" if kind.upper() == "MARKOV AUTOMATON" else kind.upper())
    return None if name is None else f"the model is {name}; MDPs and DTMCs can be read"


def read_probabilities(
    tokens: Tokens, places: Integers, named: Mapping[bytes, bytes] | None = None
) -> NDArray[Any]:
    """The probabilities at these tokens, where ``named`` tokens stand for others.

    Raises:
        ValueError: naming the file and line of the first that is no number, and the kind of
            model that has such things in place of probabilities.
    """
    return tokens.numbers(places, "a probability", named, kind_of_value)


def kind_of_value(text: str) -> str:
    """What is told about the model by a text that is no number; empty: nothing."""
    if text[0] in "[(" and (text[-1:] not in ")]" or "," in text):
        return f": {INTERVALS}"
    if text[0] == "$":
        return ": there is no such placeholder"
    if _IDENTIFIER.search(text) and text.strip("+-").lower() not in ("nan", "inf", "infinity"):
        return f": {PARAMETRIC}"
    return ""


def check_distributions(
    tokens: Tokens,
    lines: Integers,
    source: Integers,
    choice: Integers,
    probability: NDArray[Any],
    normalise: bool = False,
) -> None:
    """Check that the probabilities of each choice are a distribution, or can be normalised.

    Raises:
        ValueError: naming the file and line (the first of the choice), state and choice.
    """

    def fail(place: int, what: str) -> ValueError:
        where = f"state {source[place]}, choice {choice[place]}"
        return tokens.error(int(lines[place]), f"{where}: {what}")

    if not len(source):
        return
    negative = np.flatnonzero(probability < 0)
    if len(negative):
        raise fail(int(negative[0]), f"negative probability {probability[negative[0]]}")
    row = source * (int(choice.max()) + 1) + choice
    entries = np.bincount(row[probability != 0], minlength=int(row.max()) + 1)
    if probability.dtype == object:
        total = np.zeros(len(entries), dtype=object)
        np.add.at(total, row, probability)
        off = total != 1
    else:
        total = np.bincount(row, probability)
        off = np.abs(total - 1) > ROW_SUM_TOLERANCE
    if normalise:
        off &= ~mendable(total, entries).astype(np.bool_)
    wrong = np.flatnonzero(off[row])
    if len(wrong):
        at = row[wrong[0]]
        raise fail(wrong[0], not_one(total[at], int(entries[at])))


def count_distinct(values: Integers) -> int:
    """How many different values there are; linear if they are sorted, as in most files."""
    ordered = np.sort(values, kind="stable")
    return int(np.count_nonzero(np.diff(ordered))) + (len(ordered) > 0)


def check_action_names(path: str | os.PathLike[str], model: SafeMDP) -> None:
    """Check that the formats can hold the names of the actions.

    Raises:
        ValueError: naming the file and the first name that would be lost.
    """
    names = model.action_names or ()
    for action, name in enumerate(names):
        blank = not name or not _BLANKS.isdisjoint(name)
        if blank or not is_utf8(name) or name in RESERVED or name in names[:action]:
            why = "; two actions have it" if name in names[:action] else ""
            raise ValueError(f"{path}: the action's name {name!r} cannot be written{why}")
    widest = int(np.count_nonzero(model.available, axis=1).max())
    if len(names) > max(MAX_NAMED_ACTIONS, widest):
        raise ValueError(
            f"{path}: the names of {len(names)} actions, of which no state has more than "
            f"{widest}, cannot be written; at most {MAX_NAMED_ACTIONS} can"
        )


def is_utf8(name: str) -> bool:
    """Whether a name can be written at all."""
    return not any("\ud800" <= character <= "\udfff" for character in name)


@dataclass(frozen=True, eq=False)
class Rows:
    """A model's transitions as the formats list them, by state, then by choice.

    Fail states have one choice that stays, since the formats know no state without choices.

    Attributes:
        state, choice, target: (N,); the choices of a state are numbered from 0 without gaps.
        action: (N,) the name of the choice's action.
        probability: (N,) shortest decimals, or fractions if the model is exact.
    """

    state: list[int]
    choice: list[int]
    target: list[int]
    action: list[str]
    probability: list[str]
    num_choices: int


def model_rows(model: SafeMDP) -> Rows:
    """The transitions of a model, ready to be written."""
    kernel, num_actions = model.transitions(), model.num_actions
    names = model.action_names or [f"a{action}" for action in range(num_actions)]
    written = [str(p) for p in model.exact] if model.exact else map(repr, kernel.data.tolist())
    fails = np.flatnonzero(model.fail)
    row = np.repeat(np.arange(kernel.shape[0]), np.diff(kernel.indptr))
    row = np.concatenate((row, fails * num_actions))
    order = np.argsort(row, kind="stable")
    row = row[order]
    taken = model.available.copy()
    taken[fails, 0] = True
    choice = (np.cumsum(taken, axis=1) - 1).ravel()[row]
    probability = np.array([*written, *["1"] * len(fails)], dtype=object)[order]
    return Rows(
        state=(row // num_actions).tolist(),
        choice=choice.tolist(),
        target=np.concatenate((kernel.indices, fails))[order].tolist(),
        action=[names[action] for action in (row % num_actions).tolist()],
        probability=probability.tolist(),
        num_choices=int(np.count_nonzero(taken)),
    )


def check_no_estimate(path: str | os.PathLike[str], model: SafeMDP) -> None:
    """The formats cannot say that a model is an estimate, and it would be taken for the task.

    Raises:
        ValueError: naming the file, if the model is an estimate.
    """
    if model.estimate:
        raise ValueError(
            f"{path}: the format cannot say that the model is an estimate from a log; write .npz"
        )


def model_labels(model: SafeMDP) -> dict[str, Mask]:
    """The labels that our readers understand, and PRISM's "deadlock", which no state has."""
    none = np.zeros(model.num_states, dtype=np.bool_)
    initial = none if model.initial is None else model.initial > 0
    return {"init": initial, "deadlock": none, "fail": model.fail, "terminal": model.terminal}


def _actions(explicit: Explicit) -> tuple[Integers, tuple[str, ...] | None]:
    """(N,) the action of each transition, and the actions' names.

    The labels serve if each choice has one and no two choices of a state share it.
    """
    names, name = explicit.choice_names, explicit.choice_name
    widest = int(explicit.choice.max(initial=0)) + 1
    if not names or len(names) > max(MAX_NAMED_ACTIONS, widest) or (name < 0).any():
        return explicit.choice, None
    choice = explicit.source * widest + explicit.choice
    labelled = explicit.source * len(names) + name
    if (
        count_distinct(choice)
        == count_distinct(labelled)
        == count_distinct(choice * len(names) + name)
    ):
        return name, tuple(names)
    return explicit.choice, None


def _ends(explicit: Explicit) -> Mask:
    """bool (S,): states without a choice, and those labelled terminal that only stay."""
    continues = np.zeros(explicit.num_states, dtype=np.bool_)
    continues[explicit.source] = True
    ends = ~continues
    if "terminal" in explicit.labels:
        leaves = np.zeros(explicit.num_states, dtype=np.bool_)
        leaves[explicit.source[explicit.source != explicit.target]] = True
        ends |= explicit.labels["terminal"] & ~leaves
    return ends


def _initial(explicit: Explicit) -> NDArray[np.float64] | None:
    initial = explicit.labels.get("init")
    if initial is None or not initial.any():
        return None
    return initial.astype(np.float64) / np.count_nonzero(initial)
