"""Symbolic models through stormpy, where it is installed."""

import gzip
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

from dead_ends.io import NoFailureWarning, load_model, save_model
from dead_ends.io.errors import MissingDependencyError
from dead_ends.labels.classification import classify
from dead_ends.values.bellman import value_iteration

PRISM = """\
mdp
const int N;
module robot
  x : [0..N] init 1;
  [left] x>0 & x<N -> (x'=x-1);
  [right] x>0 & x<N -> 0.5:(x'=x+1) + 0.5:true;
  [stay] x=0 | x=N -> true;
endmodule
label "pit" = x=0;
label "goal" = x=N;
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "robot.nm"
    path.write_text(PRISM)
    return path


def test_without_stormpy(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stormpy", None)
    with pytest.raises(MissingDependencyError, match=r"stormpy: pip install 'dead-ends\[storm\]'"):
        load_model(program)
    with pytest.raises(FileNotFoundError):
        load_model(program.with_suffix(".jani"))
    with pytest.raises(ValueError, match="means nothing"):
        load_model(program, arguments={})


class TestWithStorm:
    """Needs the extra ``storm``."""

    @pytest.fixture(autouse=True)
    def stormpy(self) -> Any:
        return pytest.importorskip("stormpy", reason="stormpy, the extra storm, is not installed")

    def test_a_prism_program(self, program: Path) -> None:
        model = load_model(program, fail_label="pit", constants="N=4")
        assert model.num_states == 5
        assert model.action_names is not None
        assert set(model.action_names) == {"left", "right", "stay"}
        assert model.state_names is not None
        pit = model.state_names.index("x=0")
        assert model.fail.tolist() == [state == pit for state in range(5)]
        assert model.initial is not None
        assert model.state_names[int(model.initial.argmax())] == "x=1"
        assert classify(model).safe.sum() == 4

    def test_our_drn_is_read_by_storm(self, program: Path, stormpy: Any, tmp_path: Path) -> None:
        model = load_model(program, fail_label="pit", constants="N=4")
        save_model(model, tmp_path / "model.drn")
        theirs = stormpy.build_model_from_drn(str(tmp_path / "model.drn"))
        assert theirs.nr_states == 5
        assert set(theirs.labeling.get_labels_of_state(int(model.fail.argmax()))) == {"fail"}

    def test_umb(self, program: Path, stormpy: Any, tmp_path: Path) -> None:
        built = stormpy.build_model_from_drn(str(self._drn(program, tmp_path)))
        stormpy.io.export_to_umb(built, str(tmp_path / "model.umb"))
        model = load_model(tmp_path / "model.umb")
        assert model.num_states == 5
        assert model.fail.sum() == 1

    @settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        st.lists(st.text("ab \n\t\"'[](),;#_é★", min_size=1, max_size=6), min_size=4, max_size=4),
        st.lists(st.text("ab \n\t\"'[](),;#_é★", max_size=6), min_size=3, max_size=3),
    )
    def test_whatever_stands_in_a_name_is_kept(
        self, stormpy: Any, tmp_path: Path, actions: list[str], labels: list[str]
    ) -> None:
        """Two names of actions never become one; Storm's own model of the file is the oracle."""
        choices = stormpy.models.ChoiceLabeling(4)
        for choice, name in enumerate(actions):
            if not choices.contains_label(name):
                choices.add_label(name)
            choices.add_label_to_choice(name, choice)
        states = stormpy.models.StateLabeling(3)
        for state, name in enumerate(["init", *labels]):
            if not states.contains_label(name):
                states.add_label(name)
            states.add_label_to_state(name, state % 3)
        P = np.array([[0, 0.5, 0.5], [1, 0, 0], [0.1, 0.9, 0], [0, 0, 1]])
        parts = stormpy.models.SparseModelComponents(
            transition_matrix=stormpy.datastructures.build_sparse_matrix(P, [0, 2, 3]),
            state_labeling=states,
        )
        parts.choice_labeling = choices
        try:
            stormpy.io.export_to_umb(stormpy.models.SparseMdp(parts), str(tmp_path / "m.umb"))
        except RuntimeError:  # Storm gives two labels one file, as for " " and "_"
            reject()
        theirs = stormpy.build_model_from_umb(str(tmp_path / "m.umb"))
        assert theirs.labeling.get_labels() == {"init", *labels}
        for label in labels:
            model = load_model(tmp_path / "m.umb", fail_label=label)
            assert model.fail.nonzero()[0].tolist() == list(theirs.labeling.get_states(label))
        taken = [(0, 0), (0, 1), (1, 0), (2, 0)]
        if actions[0] == actions[1]:
            assert model.action_names is None
        else:
            assert model.action_names is not None
            assert set(model.action_names) == set(actions)
            numbers = [model.action_names.index(name) for name in actions]
            taken = [(s, number) for (s, _), number in zip(taken, numbers, strict=True)]
        expected = np.zeros((3 * model.num_actions, 3))
        for (state, action), row in zip(taken, P, strict=True):
            expected[state * model.num_actions + action] = row * ~model.fail[state]
        assert np.array_equal(model.transitions().toarray(), expected)

    def test_names_of_states(self, program: Path) -> None:
        text = PRISM.replace("init 1;", "init 1; up : bool init true;").replace(
            "(x'=x-1)", "(x'=x-1)&(up'=!up)"
        )
        program.write_text(text)
        model = load_model(program, fail_label="pit", constants="N=2")
        assert model.state_names is not None
        assert set(model.state_names) == {"!up, x=0", "up, x=1", "up, x=2"}

    @pytest.mark.parametrize(
        ("old", "new", "kind"),
        [
            ("mdp", "ctmc", "a continuous-time Markov chain"),
            ("mdp", "// a comment\n\n ma", "a Markov automaton"),
            ("mdp", "pomdp", "a partially observable MDP"),
            ("mdp", "smg", "a game of several players"),
            ("mdp", "csg", "a concurrent game"),
            ("mdp", "pta", "a probabilistic timed automaton"),
            ("mdp", "lts", "a labelled transition system"),
            ("mdp", "imdp", "an MDP with intervals"),
            ("0.5:(x'=x+1) + 0.5:true", "[0.4,0.5]:(x'=x+1) + [0.5,0.6]:true", "interval"),
        ],
    )
    def test_other_kinds_in_the_prism_language(
        self, old: str, new: str, kind: str, program: Path
    ) -> None:
        program.write_text(PRISM.replace(old, new, 1))
        with pytest.raises(ValueError, match=rf"robot\.nm: [^\n]*{kind}[^\n]*$"):
            load_model(program, fail_label="pit", constants="N=4")

    @pytest.mark.parametrize(("kind", "name"), [("ctmc", "continuous"), ("lts", "labelled")])
    def test_other_kinds_in_jani(self, kind: str, name: str, tmp_path: Path) -> None:
        import stormpy.examples.files as files

        content = json.loads(Path(files.jani_dtmc_die).read_text(encoding="utf-8-sig"))
        (tmp_path / "m.jani").write_text(json.dumps(content | {"type": kind}))
        with pytest.raises(ValueError, match=rf"m\.jani: [^\n]*{name}[^\n]*$"):
            load_model(tmp_path / "m.jani", fail_states=[5])

    @pytest.mark.parametrize("kind", ["ma", "pomdp", "smg", "interval"])
    def test_other_kinds_in_umb(self, kind: str, program: Path, stormpy: Any) -> None:
        text = PRISM.replace("int N", "int N = 4").replace(
            "mdp", kind if kind != "interval" else "mdp"
        )
        before = {
            "pomdp": "observables x endobservables\n",
            "smg": "player one [left], [right] endplayer player two [stay] endplayer\n",
        }
        text = text.replace("module", before.get(kind, "") + "module", 1)
        text = (
            text.replace("[stay]", "<>").replace("-> true", "-> 1:true") if kind == "ma" else text
        )
        if kind == "interval":
            text = text.replace("0.5:(x'=x+1) + 0.5:true", "[0.4,0.5]:(x'=x+1) + [0.5,0.6]:true")
        program.write_text(text)
        parsed = stormpy.parse_prism_program(str(program))
        build = stormpy.build_model[stormpy.Interval if kind == "interval" else float]
        path = str(program.with_suffix(".umb"))
        options = stormpy.BuilderOptions()
        options.set_build_choice_labels(True)
        stormpy.io.export_to_umb(build(parsed, options=options), path)
        name = {"ma": "automaton", "pomdp": "POMDP", "smg": "SMG", "interval": "intervals"}[kind]
        with pytest.raises(
            ValueError, match=rf"robot\.umb: the model .*{name}[^\n]*MDPs and DTMCs can be read$"
        ):
            load_model(path, fail_label="pit")

    def test_compressed(self, program: Path, tmp_path: Path) -> None:
        import stormpy.examples.files as files

        plain = load_model(program, fail_label="pit", constants="N=4")
        (tmp_path / "z.nm.gz").write_bytes(gzip.compress(PRISM.encode()))
        zipped = load_model(tmp_path / "z.nm.gz", fail_label="pit", constants="N=4")
        assert zipped.state_names == plain.state_names
        (tmp_path / "z.jani.gz").write_bytes(gzip.compress(Path(files.jani_dtmc_die).read_bytes()))
        assert load_model(tmp_path / "z.jani.gz", fail_states=[5]).num_states == 13
        (tmp_path / "z.nm.gz").write_bytes(PRISM.encode())
        with pytest.raises(ValueError, match=r"z\.nm\.gz: damaged, or not compressed by gzip"):
            load_model(tmp_path / "z.nm.gz", fail_label="pit")

    def test_missing_constants_name_the_file(self, program: Path) -> None:
        program.write_text(
            PRISM.replace("const int N;", "const int N; const int M; const int K=2;")
        )
        with pytest.raises(
            ValueError, match=r"robot\.nm: constants .* \(--constants N=...,M=...\)$"
        ):
            load_model(program, fail_label="pit")

    @pytest.mark.parametrize(
        ("ours", "storms"),
        [
            ("x == 2 and open", "x=2 & open"),
            ("not open or x in [0, 4]", "!open | x=0 | x=4"),
            ("model.s > 1", "s>1"),
            ("1 < x <= 3 and open == (model.s == 1)", "x>1 & x<=3 & (open = (s=1))"),
            ("x + 2 * model.s == 4", "x+2*s=4"),
        ],
    )
    def test_conditions_on_variables_agree_with_storm(
        self, ours: str, storms: str, program: Path, stormpy: Any
    ) -> None:
        """Storm evaluates the same expression in the states of the same exploration."""
        moves = "(x'=min(x+1,4))&(s'=mod(s+1,3))"
        program.write_text(
            "mdp\nmodule m\nx:[0..4]; s:[0..2]; open:bool;\n"
            f"[go] true -> 0.5:{moves} + 0.5:(open'=!open);\n[back] true -> (x'=0);\nendmodule\n"
        )
        model = load_model(program, fail_if=ours)
        with program.open("a") as file:
            file.write(f'label "bad" = {storms};')
        built = stormpy.build_model(stormpy.parse_prism_program(str(program)))
        assert model.fail.nonzero()[0].tolist() == list(built.labeling.get_states("bad"))
        assert 0 < model.fail.sum() < model.num_states == 30

    def test_conditions_on_variables_of_jani_agree_with_storm(self, stormpy: Any) -> None:
        from stormpy.examples.files import jani_dtmc_die as path

        model = load_model(path, fail_if="model.s == 7 and d >= 5")
        program, _ = stormpy.parse_jani_model(path)
        (question,) = stormpy.parse_properties("P=? [F s=7 & d>=5]", program)
        built = stormpy.build_model(program, [question])
        theirs = stormpy.model_checking(built, question).get_value(built.initial_states[0])
        assert model.initial is not None
        assert value_iteration(model, 1.0).V @ model.initial == pytest.approx(theirs)

    def test_real_variables_of_jani(self, tmp_path: Path) -> None:
        """As those that hold rewards, which most published models have."""
        from stormpy.examples.files import jani_dtmc_die as die

        content = json.loads(Path(die).read_text(encoding="utf-8-sig"))
        half = {"ref": "cost", "value": {"op": "/", "left": "d", "right": 2}}
        content["automata"][0]["locations"][0]["transient-values"] = [half]
        content["variables"] += [
            {"name": "cost", "type": "real", "transient": True, "initial-value": 0}
        ]
        path = tmp_path / "die.jani"
        path.write_text(json.dumps(content))
        costly, known = (load_model(path, fail_if=text) for text in ("cost >= 2.5", "d >= 5"))
        assert known.fail.sum() == 2
        assert np.array_equal(costly.fail, known.fail)

    def test_states_are_called_by_their_variables(self, program: Path) -> None:
        program.write_text("dtmc\nmodule m\nb:bool; x:[0..1];\n[] true -> (b'=!b);\nendmodule\n")
        assert load_model(program, fail_if="b").state_names == ("!b, x=0", "b, x=0")

    def test_a_label_that_no_state_carries_is_said(self, program: Path) -> None:
        program.write_text(PRISM + 'label "both" = x=0 & x=1;\n')
        with pytest.warns(NoFailureWarning, match="robot.nm: no state carries the label 'both'"):
            model = load_model(program, fail_label="both", constants="N=4")
        assert classify(model).safe.all()
        with pytest.raises(ValueError, match="labels: both, deadlock, goal, init, pit"):
            load_model(program, fail_label="neither", constants="N=4")

    def _drn(self, program: Path, folder: Path) -> Path:
        save_model(load_model(program, fail_label="pit", constants="N=4"), folder / "a.drn")
        return folder / "a.drn"

    @pytest.mark.parametrize(
        ("name", "label"),
        [
            ("prism_mdp_coin_2_2", "agree"),
            ("prism_mdp_coin_2_2", "all_coins_equal_1"),
            ("prism_mdp_firewire", "elected"),
            ("prism_dtmc_die", "one"),
            ("prism_dtmc_die", "done"),
        ],
    )
    def test_labels_agree_with_storm(self, name: str, label: str, stormpy: Any) -> None:
        """Storm's own states with P_min(F label) = 0 and = 1 are the oracle."""
        import stormpy.examples.files as files

        path = getattr(files, name)
        constants = "delay=3,fast=0.5" if name == "prism_mdp_firewire" else ""
        model = load_model(path, fail_label=label, constants=constants)
        labels = classify(model).labels.tolist()
        program = stormpy.parse_prism_program(path)
        program, _ = stormpy.instantiate_constants(program, constants)
        (question,) = stormpy.parse_properties(f'Pmin=? [F "{label}"]', program)
        options = stormpy.BuilderOptions()
        options.set_build_all_labels(True)  # a model built for one question may be smaller
        built = stormpy.build_model(program, options=options)
        never, surely = stormpy.analysis.compute_prob01_states(built, question)
        assert model.num_states == built.nr_states
        for state in range(built.nr_states):
            expected = 2 if never.get(state) else 1 if surely.get(state) else 3
            assert labels[state] == (0 if model.fail[state] else expected)

    def test_jani(self) -> None:
        import stormpy.examples.files as files

        model = load_model(files.jani_dtmc_die, fail_states=[5])
        assert model.num_states == 13
        assert model.num_actions == 1
        assert model.fail.sum() == 1

    def test_what_storm_refuses(self, program: Path, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="robot.nm: .*constant"):
            load_model(program, fail_label="pit", constants="M=4")
        with pytest.raises(ValueError, match="robot.nm: no label 'fail'"):
            load_model(program, constants="N=4")
        for suffix in (".nm", ".jani", ".umb"):
            path = tmp_path / f"bad{suffix}"
            path.write_text("nonsense")
            with pytest.raises(ValueError, match=rf"bad\{suffix}: [^\n]*\Z"):
                load_model(path)
        path.with_suffix(".nm").write_text(
            "ctmc\nmodule m\nx:[0..1];\n<> true -> 2:(x'=1);\nendmodule\n"
        )
        with pytest.raises(ValueError, match="bad.nm: the model is a continuous-time Markov chain"):
            load_model(path.with_suffix(".nm"))
