"""Storm's DRN files: reading what Storm writes, and what is said about bad files."""

import gzip
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dead_ends.io import load_model
from dead_ends.io.drn import load_drn, read_drn
from dead_ends.io.explicit import Failure
from dead_ends.labels.classification import classify

STORM = """\
// Exported by storm
// Original model type: MDP
@type: MDP
@value_type: double
@parameters

@reward_models
steps fuel
@nr_states
4
@nr_choices
5
@model
state 0 [0, 1] init
//[x=0\t& y=0]
\taction go [1, 0.5]
\t\t1 : 0.5
\t\t2 : 0.5
\taction wait [0, 0]
\t\t0 : 1
state 1 [0, 0] crash bad
//[x=0\t& y=1]
\taction go [0, 0]
\t\t1 : 1
state 2 [2, 0]
//[x=1\t& y=0]
\taction go [1, 1]
\t\t3 : 1
state 3 [0, 0] bad
//[x=1\t& y=1]
\taction go [1, 1]
\t\t1 : 0.75
\t\t3 : 0.25
"""


def write(folder: Path, text: str = STORM) -> Path:
    path = folder / "model.drn"
    path.write_text(text)
    return path


def test_an_mdp(tmp_path: Path) -> None:
    model = load_model(write(tmp_path), fail_label="crash")
    assert model.action_names == ("go", "wait")
    assert model.state_names == ("x=0, y=0", "x=0, y=1", "x=1, y=0", "x=1, y=1")
    assert model.initial is not None
    assert model.initial.tolist() == [1, 0, 0, 0]
    expected = np.zeros((8, 4))
    expected[0, 1:3], expected[1, 0], expected[4, 3], expected[6] = 0.5, 1, 1, [0, 0.75, 0, 0.25]
    assert np.array_equal(model.transitions().toarray(), expected)
    assert classify(model).labels.tolist() == [2, 0, 1, 1]
    bad = load_model(write(tmp_path), fail_label="bad")
    assert bad.fail.tolist() == [False, True, False, True]


def test_names_that_mean_nothing(tmp_path: Path) -> None:
    numbers = STORM.replace("action go", "action 0").replace("action wait", "action 1")
    assert load_drn(write(tmp_path, numbers), Failure("bad")).action_names is None
    none = STORM.replace("action go", "action __NOLABEL__")
    model = load_drn(write(tmp_path, none), Failure("bad"))
    assert model.action_names is None
    assert model.available[0].tolist() == [True, True]
    unnamed = STORM.replace("//[x=1\t& y=1]\n", "")
    assert load_drn(write(tmp_path, unnamed), Failure("bad")).state_names is None


def test_numbers_that_are_names(tmp_path: Path) -> None:
    """Action 5 of one state and action 0 of another are two actions."""
    numbers = STORM.replace("action go", "action 5").replace("action wait", "action 0")
    model = load_drn(write(tmp_path, numbers), Failure("bad"))
    assert model.action_names == ("5", "0")
    assert model.available.tolist() == [[True, True], [False] * 2, [True, False], [False] * 2]


def test_names_of_one_hash_stay_two(tmp_path: Path) -> None:
    """Both have the 64-bit FNV-1a hash 0x4eac0c95540867e4."""
    pair = ("8yn0iYCKYHlIj4-BwPqk", "GReLUrM4wMqfg9yzV3KQ")
    text = STORM.replace("action go", f"action {pair[0]}").replace(
        "action wait", f"action {pair[1]}"
    )
    text = text.replace("crash bad", f"{pair[0]} bad").replace("[2, 0]", f"[2, 0] {pair[1]}")
    assert load_drn(write(tmp_path, text), Failure("bad")).action_names == pair
    assert (
        load_drn(write(tmp_path, text), Failure(pair[0])).fail.tolist()
        == [False, True] + [False] * 2
    )


def test_labels_with_blanks_brackets_and_marks(tmp_path: Path) -> None:
    text = STORM.replace("crash bad", '"did not fail here" door[0] "[1, 2]""fail"')
    text = text.replace("state 2 [2, 0]", "state 2 [-2e-1, inf] #1 {x} !y")
    explicit = read_drn(write(tmp_path, text))
    words = [[n for n, mask in explicit.labels.items() if mask[s]] for s in range(4)]
    assert words == [
        ["init"],
        ["did not fail here", "door[0]", "[1, 2]", "fail"],
        ["#1", "{x}", "!y"],
        ["bad"],
    ]


def test_placeholders_and_other_annotations(tmp_path: Path) -> None:
    text = STORM.replace("@nr_states", "@placeholders\n$0 : 0.5\n$q : 1/4\n@nr_states")
    text = text.replace(" : 0.5\n\t", " : $0\n\t").replace("3 : 0.25", "3 : $q")
    text = text.replace("go [1, 0.5]", "go [$0,-1.5e3]").replace("@value_type: double\n", "")
    model = load_drn(write(tmp_path, text.replace("wait [0, 0]", "wait []")), Failure("crash"))
    assert model.exact is not None
    assert model.exact[:2] == (Fraction(1, 2), Fraction(1, 2))
    assert Fraction(1, 4) in model.exact
    assert model.action_names == ("go", "wait")


@pytest.mark.parametrize("kind", ["CTMC", "Markov Automaton", "POMDP", "SMG", "S2PG", "LTS"])
def test_other_kinds_are_refused_by_name(kind: str, tmp_path: Path) -> None:
    head, word = STORM.replace("MDP", kind), kind.replace(" A", " a")
    with pytest.raises(ValueError, match=f"line 3: the model is a .*{word}.*; MDPs and DTMCs"):
        load_drn(write(tmp_path, head), Failure("bad"))


def test_a_dtmc_with_a_deadlock(tmp_path: Path) -> None:
    text = "@type: DTMC\n@nr_states\n2\n@model\nstate 0 fail\naction 0\n0 : 1\nstate 1\n"
    model = load_drn(write(tmp_path, text))
    assert model.terminal.tolist() == [False, True]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (STORM, "", "model.drn: no line '@model'; not a DRN file, or it is truncated"),
        (
            "@type: MDP",
            "@type: CTMC",
            "line 3: the model is a continuous-time Markov chain .CTMC.; MDPs",
        ),
        ("@type: MDP\n", "", "the type of the model is ''"),
        ("@nr_states\n4\n", "", "line 11: @nr_states is missing before @model"),
        ("@nr_states\n4", "@nr_states\nx", "line 10: 'x' is not a number, for @nr_states"),
        ("@nr_states\n4", "@nr_states\n5", "line 33: the file ends after 4 of 5 states"),
        ("@nr_choices\n5", "@nr_choices\n6", "line 33: the file ends after 5 of 6 choices"),
        ("state 2", "state 3", "line 25: expected state 2, in this order"),
        ("state 2", "state x", "line 25: 'x' is not a state"),
        ("state 2", "stage 2", "line 25: expected 'state ...'"),
        ("state 2 [2, 0]", "state", "line 25: expected 'state ...'"),
        ("action wait", "act wait", "line 19: expected 'action ...'"),
        ("3 : 1\n", "4 : 1\n", r"line 28: state 4 does not exist \(0 to 3\)"),
        ("3 : 1\n", "3 : p\n", "line 28: 'p' is not a probability"),
        ("3 : 1\n", "3 1\n", "line 28: expected 'state ...', 'action ...' or 'state : prob"),
        ("3 : 1\n", "3 = 1\n", "line 28: expected 'state ...', 'action ...' or 'state : prob"),
        ("3 : 1\n", "3 : 0.999\n", "line 28: state 2, choice 0: probabilities sum to 0.999"),
        ("\t\t3 : 1\n", "", "line 27: an action without a transition"),
        ("state 0 [0, 1] init\n", "", "line 14: an action before the first state|expected state 0"),
        ("crash bad", "crash crash", "line 21: two labels are called 'crash'"),
        (": double", ": double-interval", "line 4: double-interval: the model has intervals"),
        (
            ": double",
            ": rational-interval",
            "line 4: rational-interval: the model has intervals",
        ),
        (": double", ": parametric", "line 5: the model is parametric"),
        (": double", ": complex", "line 4: the type of the values is 'complex'"),
        ("@parameters\n", "@parameters\np q \n", r"line 6: the model is parametric \(p q\)"),
        ("3 : 1\n", "3 : [0.1, 1]\n", "line 28: .*: the model has intervals of probabilities"),
        ("3 : 1\n", "3 : [0.1,1]\n", "line 28: .*: the model has intervals of probabilities"),
        ("3 : 1\n", "3 : 1-p\n", "line 28: '1-p' is not a probability: the model is parametric"),
        ("3 : 1\n", "3 : 1 - p\n", "line 28: expected .*: the model is parametric"),
        ("3 : 1\n", "3 : nan\n", "line 28: 'nan' is not a probability$"),
        ("3 : 1\n", "3 : $p\n", "line 28: '.p' is not a probability: .* no such placeholder"),
        ("@type: MDP", "@type: DTMC", "line 19: a state of a DTMC has a second action"),
        ("@reward_models", "@rewards", "line 7: '@rewards' is unknown"),
        ("@reward_models", "@type: MDP", "line 7: @type for the second time"),
        ("fuel", "fuel\nmore", "line 9: expected '@model' or another entry, not 'more'"),
        ("@nr_states", "@placeholders\n$0 = 1\n@nr_states", "line 10: expected a placeholder"),
        ("@nr_states", "@placeholders\n$0 : 1\n$0 : 1\n@nr_states", "line 11: .*second time"),
        ("wait [0, 0]", "wait a bit", "line 19: 'action wait a bit': the name .* no blanks"),
        ("wait [0, 0]", "wait  [0, 0]", "line 19: .*: the name of an action has no blanks"),
        ("wait [0, 0]", "wait [x]", "line 19: .*: the name of an action has no blanks"),
        ("action wait", "action  wait", "line 19: .*: the name of an action has no blanks"),
        ("action wait", "action w\ta", "line 19: .*: the name of an action has no blanks"),
        ("1 [0, 0]", "1 [x]", r"line 21: '\[x\] crash bad': labels stand between blanks"),
        ("1 [0, 0]", "1  [0, 0]", "line 21: one space separates a state from its rewards"),
        ("crash", "[crash", r"line 21: '\[crash bad': labels stand between blanks"),
        ("crash", 'cr"ash"', "line 21: 'cr\"ash\" bad': labels stand between blanks"),
        ("crash", '"cr"ash', "line 21: '\"cr\"ash bad': labels stand between blanks"),
        ("crash", '"crash', "line 21: '\"crash bad': labels stand between blanks"),
        ("crash", '""', "line 21: '\"\" bad': labels stand between blanks"),
        ("//[x=1\t& y=1]", "/ [x=1]", "line 30: expected 'state ...'"),
        ("bad", "good", r"no label 'bad' \(labels: init, crash, good\)"),
    ],
)
def test_bad_files(old: str, new: str, message: str, tmp_path: Path) -> None:
    text = STORM.replace(old, new)
    assert text != STORM
    path = write(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        load_drn(path, Failure("bad"))
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("action 0\n0 : 1\nstate 0\n", "line 5: an action before the first state"),
        ("0 : 1\nstate 0\naction 0\n0 : 1\n", "line 5: a transition before the first action"),
        (
            "state 0\naction 0\n0 : 1\nstate 1\n0 : 1\n",
            "line 9: a transition before the state's first action",
        ),
    ],
)
def test_order(body: str, message: str, tmp_path: Path) -> None:
    head = f"@type: MDP\n@nr_states\n{body.count('state')}\n@model\n"
    with pytest.raises(ValueError, match=message):
        load_drn(write(tmp_path, head + body), Failure(states=[0]))


def test_a_compressed_file(tmp_path: Path) -> None:
    path = tmp_path / "model.drn.gz"
    path.write_bytes(gzip.compress(STORM.encode()))
    assert load_model(path, fail_label="crash").action_names == ("go", "wait")
    path.write_bytes(gzip.compress(STORM.encode())[:-9])
    with pytest.raises(ValueError, match=r"model\.drn\.gz: damaged, or not compressed by gzip"):
        load_model(path, fail_label="crash")


def test_names_that_are_not_utf8(tmp_path: Path) -> None:
    """Two of them must not become one."""
    path = write(tmp_path)
    path.write_bytes(STORM.encode().replace(b"action wait", b"action \xff"))
    with pytest.raises(ValueError, match=r"model\.drn: line 19: b'.xff' is not UTF-8"):
        load_drn(path, Failure("bad"))


def test_every_truncation_is_noticed(tmp_path: Path) -> None:
    for length in range(len(STORM) - 1):
        cut = STORM[:length]
        if cut.splitlines() != STORM.splitlines():
            with pytest.raises(ValueError, match=r"model\.drn: "):
                load_drn(write(tmp_path, cut), Failure("bad"))
