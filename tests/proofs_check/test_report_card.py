"""The report card: verdicts from numbers, cells, and when the README is not current."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from proofs_check.machinery import report_card as report
from proofs_check.machinery.cases import small_cases
from proofs_check.machinery.implementation import LIBRARY
from proofs_check.machinery.report_card import Card, Means, gather, properties
from proofs_check.machinery.statement import Finding, Row, Tally, finding, run

FOLDER = Path(report.__file__).parents[1]
TEXT = (
    f"head\n{report.BEGIN}\n{report.END}\nmiddle\n"
    f"{report.GALLERY_BEGIN}\n\n{report.GALLERY_END}\ntail\n"
)


def row(name: str = "one", **fields) -> Row:
    def check(_, case) -> Finding:
        return finding(case, case.dead)

    return Row(name=name, place="here", claim="|x| is y", check=check, **fields)


def entry(tally: Tally, *, means: Means = Means.EXHAUSTIVE, **fields) -> dict:
    return properties(row(**fields), means, tally)


@pytest.mark.parametrize(
    ("tally", "passed", "accepted", "verdict"),
    [
        (Tally(9, 9, 0), True, frozenset(), "holds"),
        (Tally(9, 9, 0), True, frozenset({"A"}), "holds"),
        (Tally(9, 9, 0), True, frozenset({"A", "B"}), "proved"),
        (Tally(9, 9, 1), True, frozenset({"A", "B"}), "false"),
        (Tally(9, 9, 0), False, frozenset({"A", "B"}), "broken"),
    ],
)
def test_verdict(tally: Tally, passed: bool, accepted: frozenset[str], verdict: str) -> None:
    statement = gather([(entry(tally, kernel=("A", "B")), passed)])["one"]
    assert statement.verdict(accepted) == verdict


def test_without_theorems_nothing_is_proved() -> None:
    statement = gather([(entry(Tally(9, 9, 0)), True)])["one"]
    assert statement.verdict(frozenset({"A"})) == "holds"


def test_tallies_of_one_means_add_up() -> None:
    entries = [(entry(Tally(2, 1, 0)), True), (entry(Tally(3, 3, 1)), True)]
    entries.append((entry(Tally(5, 5, 0), means=Means.SAMPLED), True))
    statement = gather(entries)["one"]
    assert statement.results == {"exhaustive": Tally(5, 4, 1), "drawn": Tally(5, 5, 0)}


def test_a_kernel_that_did_not_run_does_not_count() -> None:
    card = Card(gather([(entry(Tally(9, 9, 0), kernel=("A",)), True)]), None, "coqc not installed")
    lines = "\n".join(report.terminal_lines(card))
    assert "kernel: not run: coqc not installed" in lines
    assert lines.startswith("holds")
    assert "0 proved, 1 holds" in lines


def test_a_rejected_theorem_is_named() -> None:
    card = Card(gather([(entry(Tally(9, 9, 0), kernel=("A", "B")), True)]), frozenset({"A"}))
    assert card.cells(card.statements["one"])["kernel"] == "A, B NOT PROVED"


@pytest.mark.parametrize(
    ("tally", "text"),
    [
        (Tally(1234, 1234, 0), "1,234"),
        (Tally(1234, 12, 0), "1,234 (12 meet the premise)"),
        (Tally(1234, 12, 7), "broken by 7 of 1,234"),
    ],
)
def test_numbers(tally: Tally, text: str) -> None:
    assert report.numbers(tally) == text


@pytest.fixture
def readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "README.md"
    path.write_text(TEXT, encoding="utf-8")
    monkeypatch.setattr(report, "README", path)
    return path


def test_what_is_written_is_current(readme: Path) -> None:
    card = Card(gather([(entry(Tally(9, 9, 2)), True), (entry(Tally(5), name="two"), True)]), None)
    assert report.stale(card, complete=True) == ["one: no such row", "two: no such row"]
    report.write(card, complete=True)
    assert report.stale(card, complete=True) == []
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("head\n")
    assert text.endswith("tail\n")
    assert "| one | here | \\|x\\| is y | false | broken by 2 of 9 models, all |" in text
    assert "counterexample-one.png" in text
    assert "counterexample-two.png" not in text


def test_another_number_is_not_current(readme: Path) -> None:
    report.write(Card(gather([(entry(Tally(9, 9, 0)), True)]), None), complete=True)
    differences = report.stale(Card(gather([(entry(Tally(8, 8, 0)), True)]), None), complete=False)
    assert differences == ["one, checked: found '8 models, all', not '9 models, all'"]
    assert readme.exists()


def test_what_a_run_did_not_look_into_is_kept(readme: Path) -> None:
    report.write(Card(gather([(entry(Tally(9, 9, 0)), True)]), None), complete=True)
    other = entry(Tally(7, 7, 0), means=Means.SIX_STATES)
    report.write(Card(gather([(other, True)]), None), complete=False)
    rows = report.parse(readme.read_text(encoding="utf-8"))
    assert rows["one"]["checked"] == "9 models, all"
    assert rows["one"]["n = 6"] == "7"


def test_a_statement_that_is_gone_is_not_current(readme: Path) -> None:
    report.write(
        Card(gather([(entry(Tally(9)), True), (entry(Tally(9), name="old"), True)]), None),
        complete=True,
    )
    now = Card(gather([(entry(Tally(9)), True)]), None)
    assert report.stale(now, complete=False) == []
    assert report.stale(now, complete=True) == ["old: no such statement"]
    report.write(now, complete=True)
    assert list(report.parse(readme.read_text(encoding="utf-8"))) == ["one"]


def test_a_changed_gallery_is_not_current(readme: Path) -> None:
    card = Card(gather([(entry(Tally(9, 9, 2)), True)]), None)
    report.write(card, complete=True)
    text = readme.read_text(encoding="utf-8")
    readme.write_text(text.replace("counterexample-one", "counterexample-1"), encoding="utf-8")
    assert report.stale(card, complete=True) == ["the counterexamples are not those of the table"]


def rows_of_the_tests() -> dict[str, Row]:
    """Every row of every test file."""
    found: dict[str, Row] = {}
    for path in sorted(FOLDER.glob("claims/test_*.py")):
        for value in vars(import_module(f"proofs_check.claims.{path.stem}")).values():
            rows = value if isinstance(value, tuple) else (value,)
            found |= {each.name: each for each in rows if isinstance(each, Row)}
    return found


def test_every_row_is_in_the_readme_and_the_other_way_round() -> None:
    table = report.parse(report.README.read_text(encoding="utf-8"))
    assert table.keys() == rows_of_the_tests().keys()
    for name, cells in table.items():
        assert (cells["verdict"] == "false") != rows_of_the_tests()[name].holds, name
        assert cells["checked"], name


def test_counterexamples_are_those_of_refuted_rows() -> None:
    refuted = {name for name, each in rows_of_the_tests().items() if not each.holds}
    assert {path.stem for path in (FOLDER / "counterexamples").glob("*.npz")} == refuted
    figures = FOLDER.parent.joinpath("figures").glob("counterexample-*.png")
    assert {path.stem.removeprefix("counterexample-") for path in figures} == refuted


def test_every_row_has_a_wrong_variant() -> None:
    for name, each in rows_of_the_tests().items():
        assert each.mutants, name
        assert all(mutant is not LIBRARY for mutant in each.mutants.values()), name


def test_run_counts_labelled_models() -> None:
    """81 models with n = 3, m = 2; the check calls those with a dead state violations."""
    case = next(c for c in small_cases() if (c.states, c.model.num_actions) == (3, 2))
    total = run(row(), LIBRARY, iter([case]))
    assert (total.models, total.met) == (81, 81)
    assert total.violated == int(case.weight[case.any_of(case.dead)].sum())
    assert np.all(case.weight >= 1)
