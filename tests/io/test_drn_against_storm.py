"""DRN files as Storm itself reads them, over names full of what separates names."""

import contextlib
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dead_ends import SafeMDP
from dead_ends.io.drn import load_drn, read_drn, save_drn
from dead_ends.io.explicit import Explicit

stormpy = pytest.importorskip("stormpy", reason="stormpy, the extra storm, is not installed")

T = TypeVar("T")
HEAD = """\
@type: MDP
@value_type: double
@parameters

@reward_models
{rewards}
@placeholders
$0 : 0.25
$half : 1/2
@nr_states
2
@nr_choices
3
@model
"""
BLANKS = " \t\r\x0b\x0c"
MARKS = "'[](){}<>,;:.!?#$%&/\\|@_-+=01ab\x01\x1c\x85\xa0\u2028é★𝔸"
"""Brackets, quotes, commas, hashes, digits, control characters, Unicode."""

NAMES = st.text(st.sampled_from(BLANKS + '"' + MARKS), max_size=6)
UNBROKEN = st.text(st.sampled_from('"' + MARKS), min_size=1, max_size=6)
QUOTABLE = st.text(st.sampled_from(BLANKS + MARKS), min_size=1, max_size=6)


def storm(path: Path) -> Any:
    options = stormpy.io.DirectEncodingParserOptions()
    options.build_choice_labeling = True
    return stormpy.build_model_from_drn(str(path), options=options)


def labels_by_storm(path: Path) -> list[set[str]]:
    model = storm(path)
    return [set(model.labeling.get_labels_of_state(state)) for state in range(model.nr_states)]


def choices_by_storm(path: Path) -> list[tuple[set[str], dict[int, float]]]:
    """Names and successors of each choice."""
    model = storm(path)
    return [
        (
            set(model.choice_labeling.get_labels_of_choice(row)),
            {entry.column: entry.value for entry in model.transition_matrix.get_row(row)},
        )
        for row in range(model.nr_choices)
    ]


def labels_of(explicit: Explicit) -> list[set[str]]:
    return [
        {label for label, mask in explicit.labels.items() if mask[state]}
        for state in range(explicit.num_states)
    ]


def choices_of(explicit: Explicit) -> list[tuple[set[str], dict[int, float]]]:
    choices: dict[tuple[int, int], tuple[set[str], dict[int, float]]] = {}
    columns = (explicit.source, explicit.choice, explicit.choice_name, explicit.target)
    for state, choice, number, target, probability in zip(
        *(column.tolist() for column in columns), explicit.probability.tolist(), strict=True
    ):
        names = {explicit.choice_names[number]} if number >= 0 else set()
        if not explicit.choice_names:
            names = {str(choice)}
        successors = choices.setdefault((state, choice), (names, {}))[1]
        successors[target] = successors.get(target, 0.0) + float(probability)
    return list(choices.values())


def write(path: Path, states: Sequence[str], actions: Sequence[str], rewards: str = "") -> Path:
    """Two states and three actions, each line ending in what is given."""
    text = (
        f"{HEAD.format(rewards=rewards)}"
        f"state 0{states[0]}\n\taction {actions[0]}\n\t\t0 : $half\n\t\t1 : 0.5\n"
        f"\taction {actions[1]}\n\t\t1 : $0\n\t\t0 : 3/4\n"
        f"state 1{states[1]}\n//[x=1\t& y=0]\n\taction {actions[2]}\n\t\t1 : 1e0\n"
    )
    path.write_bytes(text.encode())
    return path


def attempt(call: Callable[[], T]) -> tuple[T | None, str]:
    """What the call gives, or why it refuses."""
    try:
        return call(), ""
    except ValueError as error:
        return None, str(error)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("drn") / "model.drn"


@given(st.lists(st.lists(QUOTABLE, max_size=3, unique=True), min_size=2, max_size=2), st.booleans())
def test_labels_written_plainly_or_in_quotes(
    path: Path, labels: list[list[str]], rewards: bool
) -> None:
    """As Storm writes them: in quotation marks if they have blanks or begin with a bracket."""
    states = ["", ""]
    for state, names in enumerate(labels):
        quoted = [name[0] == "[" or not set(name).isdisjoint(BLANKS) for name in names]
        words = [f'"{n}"' if q else n for n, q in zip(names, quoted, strict=True)]
        states[state] = "".join(f" {word}" for word in ["[1.5]"] * rewards + words)
    write(path, states, ["a", "b", "a"], "cost" if rewards else "")
    assert labels_of(read_drn(path)) == labels_by_storm(path) == [set(names) for names in labels]


@given(st.lists(NAMES, min_size=2, max_size=2), st.lists(NAMES, min_size=3, max_size=3))
@example(["", ""], ["0", "0", "0\r\x0c"])
@example(["", ""], ["0", "0 1", "0 2"])
@example([" [1]", "[x]"], ["a [1]", "a\t[1]", "a"])
@example(['a"b', '"a b" c'], ["a", "b", " c"])
def test_whatever_stands_there_is_read_as_storm_reads_it_or_refused(
    path: Path, states: list[str], actions: list[str]
) -> None:
    """A refusal is right, too, where Storm drops a part of a name; another name never is."""
    write(path, [f" {words}" for words in states], actions)
    explicit, refusal = attempt(lambda: read_drn(path))
    if explicit is None:
        assert refusal.startswith(f"{path}: line ")
        return
    with contextlib.suppress(RuntimeError):  # what Storm refuses may be read all the same
        labels, choices = labels_by_storm(path), choices_by_storm(path)
        assert labels_of(explicit) == labels
        assert choices_of(explicit) == choices


@given(st.lists(UNBROKEN, min_size=3, max_size=3), st.booleans())
def test_names_of_actions(path: Path, names: list[str], rewards: bool) -> None:
    """Every name without blanks is read, and no two become one."""
    actions = [f"{name} [$0, 1, -2e1]" if rewards else name for name in names]
    write(path, [" init", ""], actions)
    choices = choices_of(read_drn(path))
    assert choices == choices_by_storm(path)
    assert [own for own, _ in choices] == [{name} for name in names]


@given(
    st.lists(UNBROKEN | NAMES, min_size=2, max_size=2),
    st.lists(NAMES, min_size=3, max_size=3),
    st.booleans(),
)
@example(["a", "b"], ["x\t& y", "", ""], False)
def test_what_we_write_is_read_by_storm_and_by_us(
    path: Path, actions: list[str], states: list[str], exact: bool
) -> None:
    """Or refused by name, and then only what Storm would not read."""
    third = Fraction(1, 3) if exact else 0.25
    P = np.array([[[0, third, 1 - third], [1, 0, 0]], [[0, 1, 0]] * 2, [[0, 0, 1]] * 2])
    model = SafeMDP.stochastic(
        P,
        np.array([False, False, True]),
        terminal=np.array([False, True, False]),
        action_names=actions,
        state_names=states,
    )
    path.unlink(missing_ok=True)
    _, refusal = attempt(lambda: save_drn(model, path))
    if refusal:
        lost = [n for n in actions if not n or set(n) & set(BLANKS)]
        lost += [n for n in states if "\r" in n or "\t& " in n]
        assert lost or actions[0] == actions[1]
        assert refusal.startswith(f"{path}: the ")
        assert not path.exists()
        return
    loaded = load_drn(path)
    assert loaded.state_names == tuple(states)
    assert loaded.action_names == (None if actions == ["0", "1"] else tuple(actions))
    assert np.array_equal(loaded.available, [[True, True], [True, True], [False, False]])
    assert [own for own, _ in choices_by_storm(path)][:2] == [{actions[0]}, {actions[1]}]
    assert labels_by_storm(path) == [set(), {"terminal"}, {"fail"}]
