"""Hypothesis profiles, the fixture that keeps results, and the report card at the end."""

from __future__ import annotations

import os
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from proofs_check.machinery import report_card as report
from proofs_check.machinery.report_card import Means
from proofs_check.machinery.statement import Row, Tally

settings.register_profile("dev", max_examples=50, deadline=None)
settings.register_profile("ci", max_examples=100, deadline=None, derandomize=True)
settings.register_profile(
    "nightly",
    max_examples=3_000,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


STATEMENT, KERNEL = report.STATEMENT, report.KERNEL


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-report",
        action="store_true",
        help="write what this run found into proofs_check/README.md, counterexamples and figures",
    )


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # one report, not one for each worker of xdist
        config.pluginmanager.register(ReportCard(config), "proofs_check_report")


@pytest.fixture
def record(request: pytest.FixtureRequest) -> report.Recorder:
    """Leave a row's numbers with the test that found them."""

    def leave(row: Row, means: Means, result: Tally) -> None:
        entry = report.properties(row, means, result)
        request.node.user_properties.append((report.STATEMENT, entry))

    return leave


class ReportCard:
    """Gathers the results of all tests, prints them, and compares them with the README."""

    def __init__(self, config: pytest.Config) -> None:
        self.update = bool(config.getoption("--update-report"))
        chosen = config.option.keyword or any("::" in a or a.endswith(".py") for a in config.args)
        self.complete = not chosen and config.option.markexpr in ("", "not slow")
        # Replaced when the tests of the kernel-checked part leave what was proved.
        self.kernel: tuple[frozenset[str] | None, str] = (None, report.kernel_missing())
        self.entries: list[tuple[dict[str, Any], bool]] = []
        self.stale: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when != "call":
            return
        entry: Any
        for key, entry in report.user_properties:
            if key == STATEMENT:
                self.entries.append((entry, report.passed))
            elif key == KERNEL:
                self.kernel = (frozenset(entry["proved"]) if report.passed else frozenset(), "")

    def card(self) -> report.Card:
        return report.Card(report.gather(self.entries), *self.kernel)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if not self.entries:
            return
        if self.update:
            report.write(self.card(), self.complete)
        self.stale = report.stale(self.card(), self.complete)
        if self.stale and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if not self.entries:
            return
        terminalreporter.section("statements of the paper")
        for line in report.terminal_lines(self.card()):
            terminalreporter.write_line(line)
        for line in self.stale:
            terminalreporter.write_line(f"README.md is not current: {line}", red=True)
