"""A study's folder -> its finished runs, in frozen dataclasses.

A study is ``STUDY/<task>/<section>/<run>/``; the sections read here are ``train`` (methods beside
each other), ``plug`` (a trained task policy behind a pretrained filter), ``ablation`` (all forms
at one threshold) and ``select`` (short runs, one threshold a seed). A run is finished once its
``result.json`` is there; a study may lack any of them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from deep.runs.forms import FORM_ROWS
from deep.runs.record import Record
from deep.runs.seed_result import Budget, SeedResult, read_seeds
from deep.study.paper_results import paper_place
from deep.study.statistics import Floats

__all__ = ["METHODS", "SECTIONS", "Log", "Run", "Study", "read_study"]

SECTIONS = ("train", "plug", "ablation", "select")

METHODS: Mapping[str, str] = MappingProxyType(
    {
        "sac": "SAC",
        "wcsac": "WCSAC",
        **{name: form.title for name, form in FORM_ROWS.items()},
        "iql": "IQL",
    }
)
"""Names in print, in the order of tables and legends."""

PROGRESS = ("episodes", "violations", "interventions")
EVALUATIONS = ("acr", "avr", "arr")


@dataclass(frozen=True, eq=False)
class Log:
    """A table of numbers that were written down as a run went on.

    Attributes:
        steps: int (n,), environment steps of a seed, increasing.
        columns: each float (k, n), a row a seed; NaN where there was no number.
    """

    steps: Floats
    columns: Mapping[str, Floats]


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run.

    Attributes:
        folder: within the study, ``<task>/<section>/<name>``.
        section: one of ``SECTIONS``.
        task: the task's name.
        method: as in ``METHODS``, or ``<policy's method>+<filter's method>``.
        seeds: one a seed, at least one.
        budget: what it cost.
        made_with: versions and the git revision, as the run wrote them.
        progress: episodes, violations (both since the start) and interventions (share of the
            steps since the last row); None where the run wrote none, or trained offline.
        evaluations: acr, avr and arr during training; None likewise.
    """

    folder: str
    section: str
    task: str
    method: str
    seeds: tuple[SeedResult, ...]
    budget: Budget
    made_with: Mapping[str, str]
    progress: Log | None
    evaluations: Log | None

    def by_threshold(self) -> list[tuple[float, tuple[SeedResult, ...]]]:
        """The seeds grouped by their threshold, increasing; none where there is none."""
        values = sorted({seed.threshold for seed in self.seeds if seed.threshold is not None})
        return [(v, tuple(seed for seed in self.seeds if seed.threshold == v)) for v in values]


@dataclass(frozen=True, eq=False)
class Study:
    """All that was found in a study's folder.

    Attributes:
        name: the folder's name.
        runs: the finished ones, by task, section and method.
        unfinished: folders of runs without a result.
    """

    name: str
    runs: tuple[Run, ...]
    unfinished: tuple[str, ...]

    def tasks(self) -> tuple[str, ...]:
        """The tasks with a finished run: the paper's first and in its order, real ones last."""
        found = {run.task for run in self.runs}
        return tuple(sorted(found, key=lambda t: (t.startswith("real:"), paper_place(t), t)))

    def section(self, name: str) -> dict[tuple[str, str], Run]:
        """The runs of a section by task and method."""
        return {(run.task, run.method): run for run in self.runs if run.section == name}

    def methods(self, section: str) -> tuple[str, ...]:
        """The methods with a finished run in a section, in the order of ``METHODS``."""
        found = {run.method for run in self.runs if run.section == section}
        return tuple(sorted(found, key=_method_place))


def _method_place(method: str) -> tuple[int, str]:
    order = list(METHODS)
    return (order.index(method) if method in order else len(order)), method


def read_study(folder: Path) -> Study:
    """Read every finished run of a study.

    Raises:
        ValueError: if there is none, a file is broken, or two runs claim the same cell.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: there is no such folder")
    runs: dict[tuple[str, str, str], Run] = {}
    unfinished = []
    for place in _run_folders(folder):
        name = place.relative_to(folder).as_posix()
        if not (place / "result.json").is_file():
            unfinished.append(name)
            continue
        run = _read_run(place, name)
        key = (run.task, run.section, run.method)
        if key in runs:
            raise ValueError(
                f"{folder}: {runs[key].folder} and {name} are both a run of {run.method} "
                f"on {run.task}"
            )
        runs[key] = run
    if not runs:
        raise ValueError(
            f"{folder}: no finished run (no <task>/<{'|'.join(SECTIONS)}>/<run>/result.json)"
        )
    return Study(folder.resolve().name, tuple(runs[key] for key in sorted(runs)), tuple(unfinished))


def _run_folders(study: Path) -> list[Path]:
    sections = (study.glob(f"*/{section}/*/") for section in SECTIONS)
    return sorted(place for found in sections for place in found if place.is_dir())


def _read_run(folder: Path, name: str) -> Run:
    record = Record.read(folder / "result.json")
    seeds, budget = read_seeds(record), Budget.from_record(record.record("budget"))
    numbers = tuple(seed.seed for seed in seeds)
    # What takes no environment steps has no curve over them, whatever it logs.
    online = bool(budget.env_steps)
    return Run(
        folder=name,
        section=folder.parent.name,
        task=record.text("task"),
        method=record.text("method"),
        seeds=seeds,
        budget=budget,
        made_with=record.texts("made with"),
        progress=_read_log(folder / "progress.csv", numbers, PROGRESS) if online else None,
        evaluations=_read_log(folder / "evaluations.csv", numbers, EVALUATIONS) if online else None,
    )


def _read_log(path: Path, seeds: tuple[int, ...], columns: tuple[str, ...]) -> Log | None:
    """The named columns of a CSV file with a row a step and seed; None if it is not there."""
    if not path.is_file():
        return None
    cells: dict[tuple[int, int], list[float]] = {}
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        lacking = {"step", "seed", *columns} - set(reader.fieldnames or ())
        if lacking:
            raise ValueError(f"{path}: no column {', '.join(sorted(lacking))}")
        for row in reader:
            try:
                place = int(row["step"]), int(row["seed"])
                values = [float(row[name]) if row[name] != "" else math.nan for name in columns]
            except (TypeError, ValueError) as error:
                raise ValueError(f"{path}, line {reader.line_num}: not a row of numbers") from error
            if place in cells or place[1] not in seeds:
                raise ValueError(
                    f"{path}, line {reader.line_num}: step {place[0]} of seed {place[1]} is there "
                    "twice or the result has no such seed"
                )
            cells[place] = values
    if not cells:
        return None
    steps = sorted({step for step, _ in cells})
    nothing = [math.nan] * len(columns)
    table = np.array([[cells.get((step, seed), nothing) for step in steps] for seed in seeds])
    table.setflags(write=False)
    by_name = {name: table[:, :, number] for number, name in enumerate(columns)}
    return Log(np.array(steps, dtype=np.float64), MappingProxyType(by_name))
