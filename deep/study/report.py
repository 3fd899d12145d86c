"""A study's saved runs -> its tables and pictures, joined on one page.

``report.md`` holds everything; each part is a file of its own too, the tables also as CSV with a
row a seed, and ``report.json`` lists the runs behind them. Runs are only read, nothing is
trained, so the report of an unfinished study shows what there is and names what is missing.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from dead_ends.io.atomic import atomic_path
from deep.runs.folder import versions
from deep.study.figures import ablation_figure, epsilon_figure, training_figure
from deep.study.saved_runs import Study, read_study
from deep.study.tables import ablation_table, epsilon_table, main_table, plug_table, seed_rows

__all__ = ["report"]

HOW_TO_READ = """\
A number is the interquartile mean (IQM) over seeds, in brackets its 95% interval by the
stratified bootstrap. With 4 seeds the IQM is the mean of the middle two; with one seed, or if all
agree, there is no interval. ACR: return of an episode. AVR: share of the episodes that end in a
violation. ARR: share of the steps in which the task policy's action was replaced. All three are
over whole evaluation episodes unless "training" is said. TV: violations of a seed during
training. ε: the threshold; d: WCSAC's cost limit. Steps, updates and episodes are those of one
seed; the wall time is that of the run, all its seeds together. "paper": its tables, averages over
500 episodes in the MuJoCo-based Safety Gym; the paper states neither the number of its seeds nor
its steps.
"""


@dataclass(frozen=True)
class Part:
    """A part of the report: its files' name, its heading, and what makes it."""

    name: str
    title: str
    section: str
    text: str
    table: Callable[[Study], str] | None
    figure: Callable[[Study], Figure] | None


PARTS = (
    Part(
        "main",
        "Methods beside each other",
        "train",
        'In "All tasks together" the IQM is over tasks and seeds; ACR and TV are in units of '
        "SAC's IQM on the same task.",
        main_table,
        None,
    ),
    Part(
        "training",
        "Training",
        "train",
        "Lines: IQM over seeds; bands: its 95% interval. IQL trains offline and has no curve; "
        "without a filter there are no corrections. Shares are those within a twentieth of the "
        "training. Returns have a scale of their own on each task.",
        None,
        training_figure,
    ),
    Part(
        "plug_and_play",
        "Trained task policies behind pretrained filters",
        "plug",
        "Nothing is trained here: the filter is put before the finished task policy.",
        plug_table,
        None,
    ),
    Part(
        "ablation_pretraining",
        "Forms of pretraining at one threshold",
        "ablation",
        "The forms differ in how the critic and the recovery policy were learned.",
        ablation_table,
        ablation_figure,
    ),
    Part(
        "ablation_epsilon",
        "The threshold",
        "select",
        "Short runs on seeds of their own, from which the thresholds were chosen. Dots: seeds; "
        "lines: their IQM; ringed: the threshold that the training runs used.",
        epsilon_table,
        epsilon_figure,
    ),
)


def report(study_folder: Path, out: Path) -> Study:
    """Write the report of a study into ``out``; a part without a finished run says so.

    Raises:
        ValueError: if the study holds no finished run, or a broken file; if ``out`` is in the
            study, or holds something else than an earlier report.
    """
    if out.resolve().is_relative_to(study_folder.resolve()):
        raise ValueError(f"{out} is in the study {study_folder}, which is only read: give another")
    study = read_study(study_folder)
    if out.is_dir() and any(out.iterdir()) and not (out / "report.json").is_file():
        raise ValueError(f"{out} holds something else than a report: give a new folder")
    out.mkdir(parents=True, exist_ok=True)
    _write_text(out / "report.json", json.dumps(_inventory(study), indent=2) + "\n")
    pages = [f"# Report: {study.name}\n", HOW_TO_READ]
    if study.unfinished:
        names = ", ".join(f"`{name}`" for name in study.unfinished)
        pages.append(f"Not finished, and so not in here: {names}.\n")
    for part in PARTS:
        pages.append(f"## {part.title}\n")
        pages.append(_write_part(part, study, out))
    _write_text(out / "report.md", "\n".join(pages))
    return study


def _write_part(part: Part, study: Study, out: Path) -> str:
    """The part's files; its text for the page that joins them."""
    page = out / f"{part.name}.md"
    rows, picture = page.with_suffix(".csv"), page.with_suffix(".png")
    if not study.section(part.section):
        for path in (page, rows, picture):
            path.unlink(missing_ok=True)  # of an earlier report
        return f"Missing: no finished run in `<task>/{part.section}/`.\n"
    content = [f"{part.text}\n"]
    if part.figure is not None:
        with atomic_path(picture) as temporary:
            part.figure(study).savefig(temporary, dpi=150)
        content.append(f"![{part.title}]({picture.name})\n")
    if part.table is not None:
        content.append(part.table(study))
        _write_text(page, "\n".join([f"# {part.title}\n", HOW_TO_READ, *content]))
        with atomic_path(rows) as temporary, temporary.open("w", newline="") as file:
            csv.writer(file).writerows(seed_rows(study, part.section))
        content.append(f"A row a seed: [{rows.name}]({rows.name}).\n")
    return "\n".join(content)


def _inventory(study: Study) -> dict[str, Any]:
    """Which runs are in the report, and what made them."""
    runs = [
        {
            "folder": run.folder,
            "task": run.task,
            "method": run.method,
            "seeds": [seed.seed for seed in run.seeds],
            "budget": asdict(run.budget),
            "made with": dict(run.made_with),
        }
        for run in study.runs
    ]
    drawn_with = {name: metadata.version(name) for name in ("matplotlib", "scipy")}
    return {
        "study": study.name,
        "runs": runs,
        "unfinished": list(study.unfinished),
        "report made with": versions() | drawn_with,
    }


def _write_text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text)
