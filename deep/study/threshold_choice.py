"""epsilon, or WCSAC's cost limit, chosen on other seeds so that methods are comparably safe.

The paper adapts each method's epsilon until the methods are about equally safe and then
compares what they return. Here: short training runs, one candidate a seed, and

    epsilon = the largest candidate with at most a given share of SAC's violations,

SAC's in as many environment steps. If no candidate is as safe as that, the safest one,
the largest of those that are equal.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

from dead_ends.io.atomic import atomic_path
from deep.runs.record import Record
from deep.runs.seed_result import Budget, read_seeds

__all__ = ["Choice", "choose_threshold", "pick", "read_threshold", "write_choice"]


@dataclass(frozen=True)
class Choice:
    """A threshold, and why.

    Attributes:
        threshold: epsilon, or a cost limit.
        allowed: violations that were allowed.
        candidates: (threshold, violations) pairs that were tried.
        met: whether the choice stays within ``allowed``.
    """

    threshold: float
    allowed: float
    candidates: tuple[tuple[float, int], ...]
    met: bool


def choose_threshold(run: Path, baseline: Path, share: float) -> Choice:
    """Choose among the seeds of ``run``, each trained with its own threshold.

    Args:
        run: a finished training run, one candidate a seed.
        baseline: a run of SAC on the same task, at least as long; its seeds are averaged.
        share: of the baseline's violations in as many steps.

    Raises:
        ValueError: if a run is missing or unfinished, or has no thresholds, or for a share
            that is none.
    """
    if not 0 <= share <= 1:
        raise ValueError(f"share must lie in [0, 1], not {share}")
    result = run / "result.json"
    if not result.is_file():
        raise ValueError(f"{run}: not a finished run (no result.json)")
    record = Record.read(result)
    seeds, budget = read_seeds(record), Budget.from_record(record.record("budget"))
    tried = [(s.threshold, s.tv) for s in seeds if s.threshold is not None and s.tv is not None]
    if any(seed.threshold is None for seed in seeds):
        raise ValueError(f"{run}: without correction or cost limit there is nothing to choose")
    if any(seed.tv is None for seed in seeds):
        raise ValueError(f"{run}: nothing was trained there, so no violations were counted")
    allowed = share * _violations(baseline, budget.env_steps)
    return pick(tuple(tried), allowed)


def pick(candidates: tuple[tuple[float, int], ...], allowed: float) -> Choice:
    """The rule above, on (threshold, violations) pairs."""
    good = [t for t, violations in candidates if violations <= allowed]
    if good:
        return Choice(max(good), allowed, candidates, met=True)
    least = min(violations for _, violations in candidates)
    safest = max(t for t, violations in candidates if violations == least)
    return Choice(safest, allowed, candidates, met=False)


def _violations(baseline: Path, step: int | None) -> float:
    """Violations of a run up to a logged step, averaged over its seeds."""
    path = baseline / "progress.csv"
    if not path.is_file():
        raise ValueError(f"{baseline}: there is no run here (no progress.csv)")
    with path.open(newline="") as file:
        rows = csv.DictReader(file)
        if not {"step", "violations"} <= set(rows.fieldnames or ()):
            raise ValueError(f"{path}: no violations are counted there, as in a run of train")
        counts = [int(row["violations"]) for row in rows if row["step"] == str(step)]
    if not counts:
        raise ValueError(f"{path}: there is no row for step {step}")
    return sum(counts) / len(counts)


def write_choice(choice: Choice, path: Path) -> None:
    """As JSON."""
    content = {
        "threshold": choice.threshold,
        "allowed violations": choice.allowed,
        "met": choice.met,
        "candidates": [
            {"threshold": threshold, "violations": violations}
            for threshold, violations in choice.candidates
        ],
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")


def read_threshold(path: Path) -> float:
    """The number that :func:`write_choice` wrote.

    Raises:
        ValueError: if there is none.
    """
    try:
        return float(json.loads(path.read_text())["threshold"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: there is no threshold in it ({error})") from error
