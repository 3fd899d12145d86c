"""The published study: its tables are what the report makes of its runs, and so are the page's."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from deep.study.report import report
from deep.study.saved_runs import METHODS, Run, read_study
from deep.study.statistics import estimate
from deep.train.config import train_config_from_json

ROOT = Path(__file__).parents[3]
STUDY, REPORT = ROOT / "results" / "study", ROOT / "results" / "report"
PAGE = ROOT / "docs" / "results.md"
PAPER = r"(?: \([\d.,]+\))?"
RUNS = sorted(path.parent for path in STUDY.glob("*/*/*/result.json"))


def test_the_tables_are_those_of_the_runs(tmp_path: Path) -> None:
    report(STUDY, tmp_path)
    published = sorted(path.name for path in REPORT.iterdir() if path.suffix in (".md", ".csv"))
    assert published == sorted(
        path.name for path in tmp_path.iterdir() if path.suffix in (".md", ".csv")
    )
    for name in published:
        assert (tmp_path / name).read_text() == (REPORT / name).read_text(), name
    made, listed = (
        json.loads((folder / "report.json").read_text()) for folder in (tmp_path, REPORT)
    )
    del made["report made with"], listed["report made with"]  # who made it, and not of what
    assert made == listed


@pytest.mark.parametrize("run", RUNS, ids=lambda run: str(run.relative_to(STUDY)))
def test_every_run_says_what_it_was(run: Path) -> None:
    result = json.loads((run / "result.json").read_text())
    assert len(result["made with"]["git"].rstrip("+")) == 40
    seeds = [entry["seed"] for entry in result["seeds"]]
    if run.parent.name == "plug":
        return
    content = json.loads((run / "config.json").read_text())
    assert content["run"]["seeds"] == seeds
    assert content["run"]["task"] == result["task"]
    if result["method"] != "iql":
        config = train_config_from_json(content["run"])
        assert config.steps == result["budget"]["env_steps"]
        assert config.episodes == result["budget"]["evaluation_episodes"]


def cells(run: Run, *fields: tuple[str, int]) -> str:
    """A row's numbers as the page has them, some with the paper's in parentheses."""
    shown = []
    for field, digits in fields:
        numbers = [getattr(seed, field) for seed in run.seeds]
        value = 0.0 if None in numbers else estimate(numbers).value
        shown.append(re.escape(f"{value:,.{digits}f}") + PAPER)
    return r" \| ".join(shown)


def quoted() -> Iterator[tuple[str, str]]:
    """Each run's folder, and what its row looks like."""
    for run in read_study(STUDY).runs:
        policy, plus, safety = run.method.partition("+")
        name = re.escape(f"with {METHODS[safety]}" if plus else METHODS[policy])
        outcome = ("acr", 2), ("avr", 3)
        match run.section:
            case "train" | "ablation":
                yield run.folder, rf"\| {name} \| {cells(run, *outcome, ('tv', 0))} \|"
            case "plug":
                yield run.folder, rf"\| {name} \| {cells(run, *outcome, ('arr', 3))} \|"


@pytest.mark.parametrize(("folder", "row"), list(quoted()))
def test_the_page_has_every_run(folder: str, row: str) -> None:
    assert re.search(row, PAGE.read_text()), folder
