"""The tests that every row gets: all small models, drawn models, wrong variants.

A test file defines its rows and calls these factories once; the tests carry the rows' names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from hypothesis import event, given, settings, target
from hypothesis import strategies as st
from PIL import Image

from dead_ends.__main__ import main
from dead_ends.io.npz import load_npz
from proofs_check.machinery import counterexamples
from proofs_check.machinery.cases import (
    EXHAUSTIVE_SIZES,
    Case,
    large_cases,
    small_cases,
    stochastic_cases,
)
from proofs_check.machinery.enumerate_models import count
from proofs_check.machinery.implementation import LIBRARY
from proofs_check.machinery.report_card import Means, Recorder
from proofs_check.machinery.statement import Row, Tally, run, tally

Test = Callable[..., None]


def _over(rows: Sequence[Row], test: Test) -> Test:
    return pytest.mark.parametrize("row", rows, ids=[row.name for row in rows])(test)


def judge(row: Row, total: Tally) -> None:
    """The claim is as expected, and the check was not vacuous."""
    assert total.met > 0, f"{row.name}: no model meets the premise"
    if row.holds:
        assert total.violated == 0, f"{row.name}: violated by {total.violated} models"
    else:
        assert total.violated > 0, f"{row.name}: expected to be refuted, but it holds"


def exhaustive_test(rows: Sequence[Row]) -> Test:
    """Every deterministic model with n <= 5, m = 2 or n <= 4, m = 3, every task policy.

    One model of each class under renaming is run and counted as often as the class is large.
    """

    def test(row: Row, record: Recorder) -> None:
        total = run(row, LIBRARY, iter(small_cases()))
        assert total.models == sum(count(n, m) for n, m in EXHAUSTIVE_SIZES)
        record(row, Means.EXHAUSTIVE, total)
        judge(row, total)

    return _over(rows, test)


def large_test(rows: Sequence[Row]) -> Test:
    """Every deterministic model with n = 6, m = 2, up to the states' names."""

    @pytest.mark.slow
    def test(row: Row, record: Recorder) -> None:
        total = run(row, LIBRARY, iter(large_cases()))
        assert total.models == count(6, 2)
        record(row, Means.SIX_STATES, total)
        judge(row, total)

    return _over(rows, test)


def grid_test(rows: Sequence[Row]) -> Test:
    """Every small stochastic model on a grid of probabilities."""

    def test(row: Row, record: Recorder) -> None:
        total = run(row, LIBRARY, iter(stochastic_cases()))
        record(row, Means.GRID, total)
        judge(row, total)

    return _over(rows, test)


def sampled_test(rows: Sequence[Row], cases: st.SearchStrategy[Case]) -> Test:
    """Drawn models, for the claims that hold."""

    def test(row: Row, record: Recorder) -> None:
        total = Tally()

        @given(cases)
        @settings(database=None)
        def check(case: Case) -> None:
            nonlocal total
            result = tally(case.weight, row.check(LIBRARY, case))
            total += result
            event("premise met" if result.met else "premise not met")
            target(float(case.horizon.max()), label="H")
            assert not result.violated

        check()
        assert total.met > 0, f"{row.name}: no drawn model meets the premise"
        record(row, Means.SAMPLED, total)

    return _over([row for row in rows if row.holds], test)


def teeth_test(rows: Sequence[Row], cases: Callable[[], Sequence[Case]] = small_cases) -> Test:
    """The check that judges the library rejects every wrong variant of it."""
    pairs = [
        pytest.param(row, name, id=f"{row.name}-{name}") for row in rows for name in row.mutants
    ]
    assert all(row.mutants for row in rows), "every row has a wrong variant"

    def test(row: Row, mutant: str) -> None:
        wrong = row.mutants[mutant]
        violated = any(row.check(wrong, case).violated.any() for case in cases())
        assert violated == row.holds, f"{row.name}: {mutant} is judged like the original"

    return pytest.mark.parametrize(("row", "mutant"), pairs)(test)


def counterexample_test(
    rows: Sequence[Row], cases: Callable[[], Sequence[Case]] = small_cases
) -> Test:
    """The smallest counterexample of each refuted claim is the one that is saved and drawn."""

    def test(row: Row, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]) -> None:
        found = counterexamples.smallest(row, cases())
        model_path, figure_path = counterexamples.paths(row)
        if request.config.getoption("--update-report"):
            counterexamples.save(row, found)
        model = counterexamples.named(found)
        digest = counterexamples.digest(model)
        assert counterexamples.digest(load_npz(model_path)) == digest
        with Image.open(figure_path) as picture:
            assert picture.info["Model"] == digest
        assert row.because
        assert main(["label", str(model_path)]) == 0
        assert f"{model.num_states}" in capsys.readouterr().out

    return _over([row for row in rows if not row.holds], test)
