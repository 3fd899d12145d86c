"""The published study: its tables are what the report makes of its runs, and pages quote them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deep.online.config import train_config_from_json
from deep.report import report

ROOT = Path(__file__).parents[2]
STUDY, REPORT = ROOT / "results" / "study", ROOT / "results" / "report"
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
