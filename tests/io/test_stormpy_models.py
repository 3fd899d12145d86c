"""Symbolic models through stormpy, where it is installed."""

import sys
from pathlib import Path
from typing import Any

import pytest

from dead_ends.bellman import value_iteration
from dead_ends.io import NoFailureWarning, load_model, save_model
from dead_ends.io.errors import MissingDependencyError
from dead_ends.labels import classify

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
        save_model(tmp_path / "model.drn", model)
        theirs = stormpy.build_model_from_drn(str(tmp_path / "model.drn"))
        assert theirs.nr_states == 5
        assert set(theirs.labeling.get_labels_of_state(int(model.fail.argmax()))) == {"fail"}

    def test_umb(self, program: Path, stormpy: Any, tmp_path: Path) -> None:
        built = stormpy.build_model_from_drn(str(self._drn(program, tmp_path)))
        stormpy.io.export_to_umb(built, str(tmp_path / "model.umb"))
        model = load_model(tmp_path / "model.umb")
        assert model.num_states == 5
        assert model.fail.sum() == 1

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
        save_model(folder / "a.drn", load_model(program, fail_label="pit", constants="N=4"))
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
            with pytest.raises(ValueError, match=f"bad{suffix}: "):
                load_model(path)
        path.with_suffix(".nm").write_text(
            "ctmc\nmodule m\nx:[0..1];\n<> true -> 2:(x'=1);\nendmodule\n"
        )
        with pytest.raises(ValueError, match="bad.nm: the model is of type CTMC"):
            load_model(path.with_suffix(".nm"))
