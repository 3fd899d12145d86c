"""PRISM's explicit files: reading, round trips, and what is said about bad ones."""

import gzip
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dead_ends.io import NoFailureWarning, load_model, save_model
from dead_ends.io.explicit import Failure
from dead_ends.io.prism import load_prism
from dead_ends.labels.classification import classify
from dead_ends.model.safe_mdp import SafeMDP

TRA = """\
4 5 7
0 0 1 0.5 go
0 0 2 0.5 go
0 1 0 1 wait
1 0 1 1 go
2 0 3 1 go
3 0 3 0.25 go
3 0 1 0.75 go
"""
LAB = """\
0="init" 1="deadlock" 2="crash"
0: 0
1: 2
"""
STA = """\
(x,y)
0:(0,0)
1:(0,1)
2:(1,0)
3:(1,1)
"""


def write(folder: Path, tra: str = TRA, lab: str | None = LAB, sta: str | None = STA) -> Path:
    for suffix, text in ((".tra", tra), (".lab", lab), (".sta", sta)):
        if text is not None:
            (folder / f"model{suffix}").write_text(text)
    return folder / "model.tra"


def test_an_mdp(tmp_path: Path) -> None:
    model = load_model(write(tmp_path), fail_label="crash")
    assert model.action_names == ("go", "wait")
    assert model.state_names == ("x=0,y=0", "x=0,y=1", "x=1,y=0", "x=1,y=1")
    assert model.fail.tolist() == [False, True, False, False]
    assert model.initial is not None
    assert model.initial.tolist() == [1, 0, 0, 0]
    assert model.available.tolist() == [[True, True], [False] * 2, [True, False], [True, False]]
    expected = np.zeros((8, 4))
    expected[0, 1:3], expected[1, 0], expected[4, 3], expected[6] = 0.5, 1, 1, [0, 0.75, 0, 0.25]
    assert np.array_equal(model.transitions().toarray(), expected)
    assert classify(model).labels.tolist() == [2, 0, 1, 1]


def test_a_dtmc_with_comments_and_a_deadlock(tmp_path: Path) -> None:
    tra = "# a chain\n3 3\n\n0 1 0.5\n0 2 0.5\n1 2 1\n"
    model = load_prism(write(tmp_path, tra, '0="init" 2="fail"\n1: 2\n0: 0\n', None))
    assert model.num_actions == 1
    assert model.terminal.tolist() == [False, False, True]
    assert classify(model).labels.tolist() == [3, 0, 2]


STORM_TRA = "mdp\n0 0 1 0.5\n0 0 2 0.5\n0 1 0 1 wait\n1 0 1 1\n2 0 3 1\n"
STORM_LAB = """\
#DECLARATION
init crash a"b [x]
c#d
#END

0 init
1 crash c#d
2 a"b [x]
3
"""


def test_storms_dialect(tmp_path: Path) -> None:
    path = write(tmp_path, STORM_TRA, STORM_LAB, None)
    model = load_prism(path, Failure("crash"))
    assert model.fail.tolist() == [False, True, False, False]
    assert model.terminal.tolist() == [False, False, False, True]
    assert model.available[0].tolist() == [True, True]
    assert classify(model).labels.tolist() == [2, 0, 2, 2]
    assert load_prism(path, Failure('a"b')).fail.tolist() == [False, False, True, False]
    assert load_prism(path, Failure("c#d")).fail.tolist() == [False, True, False, False]
    chain = load_prism(
        write(tmp_path, "DTMC\n0 1 1/3\n0 2 2/3\n1 1 1\n", STORM_LAB.replace("3\n", ""), None),
        Failure("crash"),
    )
    assert chain.exact is not None
    assert chain.exact[:2] == (Fraction(1, 3), Fraction(2, 3))


def test_storm_reads_the_same(tmp_path: Path) -> None:
    stormpy = pytest.importorskip("stormpy", reason="stormpy, the extra storm, is not installed")
    path = write(tmp_path, STORM_TRA + "3 0 3 1\n", STORM_LAB, None)
    built = stormpy.build_model_from_explicit(str(path), str(path.with_suffix(".lab")))
    for label in ("init", "crash", 'a"b', "[x]", "c#d"):
        model = load_prism(path, Failure(label))
        assert model.fail.nonzero()[0].tolist() == list(built.labeling.get_states(label))
    first = built.nondeterministic_choice_indices
    for state, action in np.argwhere(model.available).tolist():
        entries = built.transition_matrix.get_row(first[state] + action)
        own = model.transitions().toarray()[state * model.num_actions + action]
        assert [own[entry.column] for entry in entries] == [entry.value for entry in entries]


@pytest.mark.parametrize(
    ("tra", "kind"),
    [
        ("# Transitions (SMG)\n2:2 2 2\n0:0 0 1 1 go\n1:1 0 1 1\n", "a game of several players"),
        ("2:2 2 2\n0:0 0 1 1 go\n1:1 0 1 1\n", "a game of several players"),
        ("# Transitions (CSG)\n2:2 2 2\n0 0 1 1 [a,b]\n1 0 1 1 [a,b]\n", "a concurrent game"),
        ("# Transitions (CTMC)\n2 2\n0 1 1\n1 1 1\n", "a continuous-time Markov chain"),
        ("ctmc\n0 1 1\n1 1 1\n", "a continuous-time Markov chain"),
        ("2 2\n0 1 2.5\n1 1 1\n", "2.5 is no .* a rate: .* a continuous-time Markov chain"),
        ("2 2 2\n0 0 1 3/2 go\n1 0 1 1 go\n", "3/2 is no .* a rate: .* a continuous-time MDP"),
        ("ma\n0 go\n* 1 1\n", "a Markov automaton"),
        ("2 2 3 2\n0 0 0 0.5 0\n0 0 1 0.5 1\n1 0 1 1 1 go\n", "a partially observable MDP"),
        ("# Transitions (LTS)\n2 2 2\n0 0 1\n1 0 1\n", "a labelled transition system"),
        ("2 2 2\n0 0 1\n1 0 1 go\n", "a labelled transition system"),
        ("2 2 2\n0 0 1 go\n1 0 1 go\n", "a labelled transition system"),
        ("# Transitions (IMDP)\n2 2 2\n0 0 1 [1,1]\n1 0 1 [1,1]\n", "an MDP with intervals"),
        ("2 2 2\n0 0 1 [1,1] go\n1 0 1 [1,1] go\n", "the model has intervals"),
        ("2 2\n0 1 [1,1]\n1 1 [1,1]\n", "the model has intervals"),
        ("2 2\n0 1 [1, 1]\n1 1 [1, 1]\n", "the model has intervals"),
        ("2 2 2\n0 0 1 [1, 1] go\n1 0 1 [1, 1] go\n", "the model has intervals"),
        ("2 3\n0 0 1-p\n0 1 p\n1 1 1\n", "'1-p' is not a .* the model is parametric"),
        ("2 2 3\n0 0 0 p go\n0 0 1 1-p go\n1 0 1 1 go\n", "'p' is not .* the model is parametric"),
        ("2 3\n0 0.5:0 0.5:1\n1 1:1\n", r"the file is in rows \(PRISM's -exportrows\)"),
        ("2 2 3\n0 0.5:0 0.5:1 go\n1 1:1\n", r"the file is in rows \(PRISM's -exportrows\)"),
        ("P = sparse(2,2);\nP(1,2)=1;\nP(2,2)=1;\n", "the file is Matlab code"),
        ("STATES 2\nTRANSITIONS 2\n1 2 1\n2 2 1\n", "the file is in the form of MRMC"),
        ("digraph P {\n}\n", "the file is a picture for Graphviz"),
        ("@type: MDP\n@nr_states\n1\n", "the file is a DRN file"),
    ],
)
def test_other_kinds_and_forms_are_refused_by_name(tra: str, kind: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"model\.tra: line \d: .*{kind}[^\n]*$"):
        load_prism(write(tmp_path, tra, None, None), Failure(states=[1]))


def test_forms_of_the_files_beside(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"model\.lab: line 1: the file is Matlab code"):
        load_prism(write(tmp_path, lab="l_init=sparse(4,1);\n"))
    with pytest.raises(ValueError, match=r"model\.sta: line 2: the file is Matlab code"):
        load_prism(write(tmp_path, sta="# States\n% (s,d)\nstates=[\n0,0\n];\n"))


@pytest.mark.parametrize("zipped", [(".tra", ".lab", ".sta"), (".tra", ".sta"), (".lab",)])
def test_compressed_files(
    zipped: tuple[str, ...],
    tmp_path: Path,
    assert_same_dynamics: Callable[[SafeMDP, SafeMDP], None],
) -> None:
    plain = load_model(write(tmp_path), fail_label="crash")
    for suffix in zipped:
        path = tmp_path / f"model{suffix}"
        path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    path = tmp_path / ("model.tra.gz" if ".tra" in zipped else "model.tra")
    assert_same_dynamics(load_model(path, fail_label="crash"), plain)


def test_damaged_and_doubtful_compressed_files(tmp_path: Path) -> None:
    path = write(tmp_path)
    (tmp_path / "model.lab.gz").write_bytes(gzip.compress(LAB.encode()))
    with pytest.raises(ValueError, match=r"model.tra: .* there are .*model.lab and .*lab.gz$"):
        load_model(path)
    path.with_suffix(".lab").unlink()
    whole = gzip.compress(TRA.encode())
    for content in (whole[:-3], whole[:30], TRA.encode(), whole[:20] + b"x" + whole[21:]):
        (tmp_path / "model.tra.gz").write_bytes(content)
        with pytest.raises(ValueError, match=r"model\.tra\.gz: damaged, or not compressed by gz"):
            load_model(tmp_path / "model.tra.gz", fail_label="crash")
    with pytest.raises(ValueError, match=r"model.npz.gz: unknown format '.gz'"):
        load_model(tmp_path / "model.npz.gz")


def test_windows_line_ends_and_no_last_line_end(
    tmp_path: Path, assert_same_dynamics: Callable[[SafeMDP, SafeMDP], None]
) -> None:
    path = write(tmp_path, TRA.replace("\n", "\r\n")[:-2], LAB.replace("\n", "\r\n"), None)
    assert_same_dynamics(
        load_prism(path, Failure("crash")),
        load_prism(write(tmp_path, sta=None), Failure("crash")),
    )


def test_choices_are_numbered_where_labels_do_not_tell_them_apart(tmp_path: Path) -> None:
    for tra in (
        TRA.replace("wait", "go"),
        TRA.replace(" go\n3 0 3", "\n3 0 3"),
        TRA.replace(" go", ""),
    ):
        model = load_prism(write(tmp_path, tra), Failure("crash"))
        assert model.action_names is None
        assert model.available[0].tolist() == [True, True]


def test_fractions_are_kept(tmp_path: Path) -> None:
    tra = "2 3\n0 0 1/3\n0 1 2/3\n1 1 1\n"
    model = load_prism(write(tmp_path, tra, None, None), Failure(states=[1]))
    assert model.exact == (Fraction(1, 3), Fraction(2, 3))


@pytest.mark.parametrize("absurd", ["1e-999999999", "1/" + "9" * 5000])
def test_fractions_with_pages_of_digits_are_refused_soon(absurd: str, tmp_path: Path) -> None:
    tra = f"2 3\n0 0 1/3\n0 1 {absurd}\n1 1 1\n"
    with pytest.raises(ValueError, match=r"model.tra: line 3: '1\S*' (has too|is not)") as caught:
        load_prism(write(tmp_path, tra, None, None), Failure(states=[1]))
    assert len(str(caught.value)) < 300


def test_labels_with_blanks_and_brackets(tmp_path: Path) -> None:
    path = write(tmp_path, lab='0="did not fail" 1="fail" 2="door[0]"\n0: 0 2\n1: 1\n')
    assert load_prism(path).fail.tolist() == [False, True, False, False]
    assert load_prism(path, Failure("did not fail")).fail.tolist() == [True] + [False] * 3
    assert load_prism(path, Failure("door[0]")).fail.tolist() == [True] + [False] * 3


def test_which_states_fail(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert load_model(path, fail_states=[3]).fail.tolist() == [False, False, False, True]
    both = load_model(path, fail_states=[3], fail_label="crash")
    assert both.fail.tolist() == [False, True, False, True]
    added = load_model(path, fail_if="s == 0 and s2 == 2")
    assert added.fail.tolist() == [False] * 4 + [True]
    with pytest.raises(ValueError, match=r"no label 'fail' \(labels: init, deadlock, crash\); say"):
        load_model(path)
    with pytest.raises(ValueError, match=r"no label 'x' \(labels: init, deadlock, crash\)$"):
        load_model(path, fail_label="x")
    with pytest.raises(ValueError, match="unknown name 'r'"):
        load_model(path, fail_if="r > 0")


def test_several_labels_are_a_union(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert load_model(path, fail_label=["init", "crash"]).fail.tolist() == [
        True,
        True,
        False,
        False,
    ]
    with pytest.raises(ValueError, match=r"no label 'x' \(labels: init, deadlock, crash\)$"):
        load_model(path, fail_label=["crash", "x"])


@pytest.mark.parametrize("labels", ["deadlock", ["crash", "deadlock"], ["deadlock", "crash"]])
def test_a_label_that_no_state_carries_is_said(labels: Any, tmp_path: Path) -> None:
    path = write(tmp_path)
    with pytest.warns(NoFailureWarning) as said:
        model = load_model(path, fail_label=labels)
    assert model.fail.tolist() == [False, "crash" in labels, False, False]
    assert [str(warning.message) for warning in said] == [
        f"{path}: no state carries the label 'deadlock', so that failure by it is impossible"
    ]


def test_an_empty_list_of_labels_is_said(tmp_path: Path) -> None:
    with pytest.warns(NoFailureWarning, match="no label is listed in fail_label, so that"):
        assert not load_model(write(tmp_path), fail_label=[]).fail.any()


def test_the_label_fail_without_a_state_is_said(tmp_path: Path) -> None:
    path = write(tmp_path, lab=LAB.replace("deadlock", "fail"))
    with pytest.warns(NoFailureWarning, match="no state carries the label 'fail'"):
        assert not load_model(path).fail.any()


def test_variables_of_states_say_which_fail(tmp_path: Path) -> None:
    path = write(
        tmp_path, sta="(x,open,s)\n0:(0,true,0)\n1:(1,true,3)\n2:(2,false,3)\n3:(2,true,1)\n"
    )

    def fail(condition: str) -> list[bool]:
        return load_model(path, fail_if=condition).fail.tolist()

    assert fail("x > 1 and open") == [False, False, False, True]
    assert fail("not open") == [False, False, True, False]
    assert fail("model.s == 3 and x in [0, 1]") == [False, True, False, False]
    assert fail("s2 == 3") == [False, False, False, False, True]
    both = load_model(path, fail_if="not open", fail_label="crash")
    assert both.fail.tolist() == [False, True, True, False]
    with pytest.warns(NoFailureWarning, match="no state satisfies 'x > 2'"):
        assert fail("x > 2") == [False] * 4
    for condition, message in (
        ("s == 3", "'s' is a variable of the model too; write model.s for the variable"),
        ("x == 1 and s2 == 3", "'x' says which states fail and 's2' which transitions; one"),
        ("y == 1", r"unknown name 'y' \(known here: s, a, s2, or the variables x, open, s\)"),
        ("x", "gives a number, not true or false"),
    ):
        with pytest.raises(ValueError, match=f"model.tra: condition '{condition}': {message}"):
            fail(condition)


def test_large_variables_are_exact(tmp_path: Path) -> None:
    path = write(tmp_path, sta=f"(x)\n0:({2**53})\n1:({2**53 + 1})\n2:(0)\n3:(1)\n")
    assert load_model(path, fail_if=f"x == {2**53}").fail.tolist() == [True, False, False, False]


def test_names_of_states_are_no_variables(tmp_path: Path) -> None:
    path = write(tmp_path, sta="(name)\n0:(a,b)\n1:(c)\n2:(d)\n3:(e)\n")
    with pytest.raises(ValueError, match="unknown name 'name'"):
        load_model(path, fail_if="name == 1")


def test_a_state_that_leaves_is_not_terminal_whatever_its_label(tmp_path: Path) -> None:
    tra = "3 4\n0 1 1\n1 1 1\n2 1 0.5\n2 2 0.5\n"
    lab = '0="fail" 1="terminal"\n1: 0\n0: 1\n2: 1\n'
    model = load_prism(write(tmp_path, tra, lab, None))
    assert not model.terminal.any()
    assert classify(model).dead.tolist() == [True, False, True]


TABLE = np.array([[0, 1], [2, 2], [0, 0], [3, -1], [-1, 4]])
ENDS: dict[str, Any] = {
    "fail": np.array([False, False, True, False, False]),
    "terminal": np.array([False, False, False, True, False]),
}


def models() -> dict[str, SafeMDP]:
    P = np.zeros((5, 2, 5))
    P[0, 0, :3], P[0, 1, 4], P[1, :, 3], P[4, 1, [0, 2]] = 1 / 3, 1, 1, [0.1, 0.9]
    available = np.array([[1, 1], [1, 1], [0, 0], [0, 0], [0, 1]]) == 1
    third = np.vectorize(lambda p: Fraction(str(p)).limit_denominator(10), otypes=[object])
    named = {"state_names": ["a", "b b", "c:d", "(e)", "ü"], "action_names": ["go", "wait"]}
    return {
        "table": SafeMDP.deterministic(TABLE, **ENDS, initial=[0, 1]),
        "names": SafeMDP.deterministic(TABLE, **ENDS, **named),
        "floats": SafeMDP.stochastic(P, available=available, **ENDS, **named, initial=[4]),
        "fractions": SafeMDP.stochastic(third(P), available=available, **ENDS),
    }


@pytest.mark.parametrize("suffix", [".tra", ".drn"])
@pytest.mark.parametrize("name", list(models()))
def test_round_trips(
    name: str,
    suffix: str,
    tmp_path: Path,
    assert_same_dynamics: Callable[[SafeMDP, SafeMDP], None],
) -> None:
    model = models()[name]
    path = tmp_path / f"model{suffix}"
    save_model(model, path)
    loaded = load_model(path)
    assert_same_dynamics(loaded, model)
    assert loaded.action_names == (model.action_names or ("a0", "a1"))
    assert (loaded.initial is None) == (model.initial is None)
    if model.initial is not None:
        assert np.array_equal(loaded.initial, model.initial)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_an_old_state_file_does_not_stay(tmp_path: Path) -> None:
    path = tmp_path / "model.tra"
    save_model(models()["names"], path)
    assert (tmp_path / "model.sta").exists()
    save_model(models()["table"], path)
    assert load_model(path).state_names is None


@pytest.mark.parametrize("suffix", [".lab", ".sta"])
def test_nothing_is_written_beside_compressed_files_of_another_model(
    suffix: str, tmp_path: Path
) -> None:
    path, other = tmp_path / "model.tra", tmp_path / f"model{suffix}.gz"
    other.write_bytes(b"")
    with pytest.raises(ValueError, match=f"{path}: {other} is there, and would be read with"):
        save_model(models()["table"], path)
    assert list(tmp_path.iterdir()) == [other]


@pytest.mark.parametrize("suffix", [".tra", ".drn"])
def test_names_that_cannot_be_written(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"model{suffix}"
    for names in (
        {"action_names": ["a b", "c"]},
        {"action_names": ["", "c"]},
        {"action_names": ["c", "c"]},
        {"action_names": ["c", "__NOLABEL__"]},
        {"action_names": ["c", "\ud800"]},
        {"state_names": ["a\n", "b", "c", "d", "e"]},
        {"state_names": ["\ud800", "b", "c", "d", "e"]},
    ):
        with pytest.raises(ValueError, match=f"model{suffix}: the .*'s name .* cannot be written"):
            save_model(SafeMDP.deterministic(TABLE, **ENDS, **names), path)
    assert not list(tmp_path.iterdir())


MARKS = st.text(
    "\"'[](){}<>,;:.!?#$%&/\\|@_-+=01ab\x01\x1c\x85\xa0\u2028é★", min_size=1, max_size=6
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(MARKS, min_size=2, max_size=2, unique=True), st.lists(MARKS, min_size=5, max_size=5)
)
def test_names_full_of_marks(tmp_path: Path, actions: list[str], states: list[str]) -> None:
    states = [name.strip() for name in states]
    model = SafeMDP.deterministic(TABLE, **ENDS, action_names=actions, state_names=states)
    save_model(model, tmp_path / "model.tra")
    loaded = load_model(tmp_path / "model.tra")
    assert loaded.action_names == tuple(actions)
    assert loaded.state_names == tuple(states)


@pytest.mark.parametrize("suffix", [".tra", ".drn"])
def test_many_named_actions(suffix: str, tmp_path: Path) -> None:
    """Kept if a state has them all; else the tables might be too wide, and they are refused."""
    names = [f"to{state}" for state in range(70)]
    table = np.tile(np.arange(70), (70, 1))
    fail = np.arange(70) == 69
    path = tmp_path / f"model{suffix}"
    save_model(SafeMDP.deterministic(table, fail, action_names=names), path)
    assert load_model(path).action_names == tuple(names)
    table[np.arange(70) != (np.arange(70)[:, None] + 1) % 70] = -1
    with pytest.raises(ValueError, match=f"model{suffix}: the names of 70 actions, of which no"):
        save_model(SafeMDP.deterministic(table, fail, action_names=names), path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (TRA, "", "model.tra: the file is empty"),
        (TRA, "# only a comment\n", "model.tra: the file is empty"),
        ("4 5 7", "4", "line 1: expected 'states transitions' or 'states choices transitions'"),
        ("4 5 7", "4 5 x", "line 1: 'x' is not a number of states, choices or transitions"),
        ("3 0 3 0.25 go\n3 0 1 0.75 go\n", "", "line 6: the file ends after 5 of 7 transitions"),
        ("3 0 1 0.75 go", "3 0 1", "line 8: expected 'state choice successor probability .action"),
        ("4 5 7", "4 5 6", "the first line announces 6 transitions, there are 7"),
        ("4 5 7", "4 6 7", "line 1: the first line announces 6 choices, there are 5"),
        ("4 5 7", "4 1 7", "line 4: choice 1 of 1 choices in all"),
        ("2 0 3 1", "2 0 4 1", r"line 6: state 4 does not exist \(0 to 3\)"),
        ("2 0 3 1", "7 0 3 1", r"line 6: state 7 does not exist \(0 to 3\)"),
        ("2 0 3 1", "-2 0 3 1", "line 6: '-2' is not a state"),
        ("2 0 3 1", "2 x 3 1", "line 6: 'x' is not a choice"),
        ("2 0 3 1", "2 0 3 p", "line 6: 'p' is not a probability: the model is parametric"),
        ("2 0 3 1", "2 0 3 1e999", "line 6: '1e999' is not a probability$"),
        ("2 0 3 1", "2 0 3 -inf", "line 6: '-inf' is not a probability$"),
        (
            "0 0 2 0.5",
            "0 0 2 0.499",
            "line 2: state 0, choice 0: probabilities sum to 0.999, not 1",
        ),
        ("0 0 2 0.5", "0 0 2 -0.5", "line 3: state 0, choice 0: negative probability -0.5"),
        (TRA, STORM_TRA[:-1], "line 6: the line has no end; is the file truncated?"),
        (TRA, "mdp\n", "line 1: there are no transitions"),
        (TRA, STORM_TRA.replace("0 1 0 1", "0 9 0 1"), "line 4: choice 9 of 5 choices in all"),
        ("0.5", "1/3", "line 2: state 0, choice 0: probabilities sum to 2/3, not exactly 1"),
    ],
)
def test_bad_transitions(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, TRA.replace(old, new))
    with pytest.raises(ValueError, match=message) as caught:
        load_prism(path, Failure("crash"))
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('2="crash"', '2="init"', "line 1: two labels are called 'init'"),
        ('2="crash"', '0="crash"', "line 1: two labels have the number 0"),
        ('2="crash"', "crash", "line 1: expected the labels, such as"),
        ("1: 2", "1: 3", "line 3: label 3 is not in the first line"),
        ("1: 2", "1: x", "line 3: 'x' is not the number of a label"),
        ("1: 2", "9: 2", r"line 3: state 9 does not exist \(0 to 3\)"),
        ("1: 2", "1 2", "line 3: expected 'state: label label ...'"),
        ("1: 2", "x: 2", "line 3: 'x:' is not a state"),
        ("1: 2", "1:", "line 3: expected 'state: label label ...'"),
        ("1: 2\n", "1: 2", "line 3: the line has no end; is the file truncated?"),
        (LAB, STORM_LAB[:-1], "line 9: the line has no end; is the file truncated?"),
        (LAB, STORM_LAB[: STORM_LAB.index("#END")], "line 3: there is no #END of the labels"),
        (LAB, STORM_LAB.replace("c#d\n#", "crash\n#"), "line 3: two labels are called 'crash'"),
        (LAB, STORM_LAB.replace("#END", "#END 0 init"), "line 4: expected a new line after #END"),
        (LAB, STORM_LAB.replace("1 crash", "1 fail"), "line 7: the label 'fail' is not declared"),
        (LAB, STORM_LAB.replace("1 crash", "7 crash"), "line 7: state 7 does not exist"),
        (LAB, STORM_LAB.replace("1 crash", "1: crash"), "line 7: '1:' is not a state"),
        (LAB, "", "the file is empty"),
    ],
)
def test_bad_labels(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, lab=LAB.replace(old, new))
    with pytest.raises(ValueError, match=message) as caught:
        load_prism(path, Failure("crash"))
    assert str(caught.value).startswith(str(path.with_suffix(".lab")))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(x,y)", "x,y", r"line 1: expected the variables, such as \(x,y\)"),
        ("(x,y)", "(x,x)", "line 1: two variables are called 'x'"),
        ("3:(1,1)", "3:(1)", "line 5: expected 2 values, not 1"),
        ("3:(1,1)", "9:(1,1)", "line 5: state 9 does not exist"),
        ("3:(1,1)", "3 (1,1)", "line 5: expected 'state:"),
        ("3:(1,1)", "", "state 3 is missing"),
        ("3:(1,1)", "3:(1,1)\n1:(9,9)", "line 6: state 1 for the second time"),
        (STA, "", "the file is empty"),
    ],
)
def test_bad_states(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, sta=STA.replace(old, new))
    with pytest.raises(ValueError, match=message) as caught:
        load_prism(path, Failure("crash"))
    assert str(caught.value).startswith(str(path.with_suffix(".sta")))


def test_more_states_than_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before any table of that size is made."""
    monkeypatch.setattr("dead_ends.model.memory.available_memory", lambda: 4 << 30)
    path = tmp_path / "model.tra"
    path.write_text("2000000000 1 1\n0 0 0 1\n")
    with pytest.raises(MemoryError, match=r"model\.tra: a model of 2,000,000,000 states needs 149"):
        load_prism(path)


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_model(tmp_path / "absent.tra")
    with pytest.raises(ValueError, match="no label 'fail' .labels: none.; say which"):
        load_model(write(tmp_path, lab=None, sta=None))
    with pytest.raises(ValueError, match="the folder .* does not exist"):
        save_model(models()["table"], tmp_path / "absent" / "model.tra")
    with pytest.raises(ValueError, match=r"constants \(--constants\) means nothing"):
        load_model(write(tmp_path), constants="N=1")


def test_three_files_change_together_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.tra"
    save_model(models()["names"], path)
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    assert len(before) == 3

    def disk_full(*_: object) -> None:
        raise OSError("No space left on device")

    for step in ("_write_transitions", "_write_labels", "_write_names"):
        with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
            patch.setattr(f"dead_ends.io.prism.{step}", disk_full)
            save_model(models()["floats"], path)
        assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == before
