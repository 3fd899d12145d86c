"""The rule that chooses epsilon, and the files that it reads and writes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deep.study.threshold_choice import Choice, choose_threshold, pick, read_threshold, write_choice
from tests.deep import studies


@pytest.mark.parametrize(
    ("candidates", "allowed", "threshold", "met"),
    [
        (((0.1, 3), (0.3, 5), (0.5, 9)), 5.0, 0.3, True),
        (((0.1, 3), (0.3, 5), (0.5, 9)), 4.9, 0.1, True),
        (((0.1, 3), (0.3, 7), (0.5, 4)), 4.0, 0.5, True),  # not monotone: the largest counts
        (((0.1, 3), (0.3, 5), (0.5, 9)), 2.0, 0.1, False),
        (((0.1, 3), (0.3, 3), (0.5, 9)), 2.0, 0.3, False),  # equally unsafe: the freer one
        (((0.1, 0), (0.3, 0)), 0.0, 0.3, True),
    ],
)
def test_the_largest_threshold_that_is_safe_enough(
    candidates: tuple[tuple[float, int], ...], allowed: float, threshold: float, met: bool
) -> None:
    assert pick(candidates, allowed) == Choice(threshold, allowed, candidates, met)


def runs(folder: Path, thresholds: list[float | None], violations: list[int]) -> tuple[Path, Path]:
    """A selection run of 200 steps, and a baseline of two seeds with 40 and 60 violations."""
    select, baseline = folder / "select", folder / "baseline"
    select.mkdir()
    baseline.mkdir()
    seeds = [
        studies.seed_result(100 + k, threshold=threshold, tv=tv)
        for k, (threshold, tv) in enumerate(zip(thresholds, violations, strict=True))
    ]
    budget = {"env_steps": 200, "updates": 20, "wall_seconds": 1, "evaluation_episodes": 5}
    content = {"budget": budget, "seeds": seeds}
    (select / "result.json").write_text(json.dumps(content))
    rows = ["step,seed,violations", "100,0,10", "100,1,20", "200,0,40", "200,1,60", "300,0,99"]
    (baseline / "progress.csv").write_text("\n".join(rows) + "\n")
    return select, baseline


def test_violations_are_allowed_as_a_share_of_the_baselines_in_as_many_steps(
    tmp_path: Path,
) -> None:
    select, baseline = runs(tmp_path, [0.1, 0.3, 0.5], [2, 5, 6])
    assert choose_threshold(select, baseline, 0.1) == Choice(
        0.3, 5.0, ((0.1, 2), (0.3, 5), (0.5, 6)), met=True
    )


def test_a_choice_is_read_as_it_was_written(tmp_path: Path) -> None:
    choice = Choice(0.3, 5.0, ((0.1, 2), (0.3, 5)), met=True)
    write_choice(choice, tmp_path / "threshold.json")
    assert read_threshold(tmp_path / "threshold.json") == 0.3
    content = json.loads((tmp_path / "threshold.json").read_text())
    assert content["candidates"] == [
        {"threshold": 0.1, "violations": 2},
        {"threshold": 0.3, "violations": 5},
    ]
    assert (content["threshold"], content["allowed violations"]) == (0.3, 5.0)
    assert content["met"] is True


def test_runs_that_cannot_be_compared_are_refused(tmp_path: Path) -> None:
    select, baseline = runs(tmp_path, [0.1, None], [2, 5])
    for share in (-0.1, 5.0):
        with pytest.raises(ValueError, match=rf"^share must lie in \[0, 1\], not {share}$"):
            choose_threshold(select, baseline, share)
    with pytest.raises(ValueError, match="select: without correction or cost limit there is n"):
        choose_threshold(select, baseline, 0.1)
    with pytest.raises(ValueError, match=r"baseline: not a finished run \(no result.json\)"):
        choose_threshold(baseline, baseline, 0.1)
    content = json.loads((select / "result.json").read_text())
    content["seeds"].pop()
    (select / "result.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"there is no run here \(no progress.csv\)"):
        choose_threshold(select, select, 0.1)
    content["seeds"][0]["tv"] = None  # as an evaluation leaves it
    (select / "result.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="select: nothing was trained there, so no violations"):
        choose_threshold(select, baseline, 0.1)
    content["seeds"][0]["tv"] = 2
    content["budget"]["env_steps"] = 250
    (select / "result.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="there is no row for step 250"):
        choose_threshold(select, baseline, 0.1)
    (baseline / "progress.csv").write_text("update,seed,critic_loss\n200,0,2.0\n")
    with pytest.raises(ValueError, match="progress.csv: no violations are counted there"):
        choose_threshold(select, baseline, 0.1)
    for text in ("{}", "no", '{"threshold": null}'):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(ValueError, match="x.json: there is no threshold in it"):
            read_threshold(tmp_path / "x.json")
