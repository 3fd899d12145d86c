"""Symbolic models through stormpy, where it is installed."""

import sys
from pathlib import Path
from typing import Any

import pytest

from dead_ends.io import load_model, save_model
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
        with pytest.raises(ValueError, match=r"robot\.nm: Model .* undefined constants"):
            load_model(program, fail_label="pit")

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
