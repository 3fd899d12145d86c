"""A study's folder -> its finished runs, in frozen dataclasses.

A study is ``STUDY/<task>/<section>/<run>/``; the sections read here are ``train`` (methods beside
each other), ``plug`` (a trained task policy behind a pretrained filter), ``ablation`` (all forms
at one threshold) and ``select`` (short runs, one threshold a seed). A run is finished once its
``result.json`` is there; a study may lack any of them.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from deep.pretrain import FORMS
from deep.study.paper_results import paper_place
from deep.study.statistics import Floats

__all__ = ["METHODS", "SECTIONS", "Budget", "Log", "Run", "SeedResult", "Study", "read_study"]

SECTIONS = ("train", "plug", "ablation", "select")

METHODS: Mapping[str, str] = MappingProxyType(
    {
        "sac": "SAC",
        "wcsac": "WCSAC",
        **{name: form.title for name, form in FORMS.items()},
        "iql": "IQL",
    }
)
"""Names in print, in the order of tables and legends."""

PROGRESS = ("episodes", "violations", "interventions")
EVALUATIONS = ("acr", "avr", "arr")


@dataclass(frozen=True)
class SeedResult:
    """What one seed ended with.

    Attributes:
        seed: the seed.
        acr: average cumulative reward over the evaluation's whole episodes.
        avr: share of them that end in a violation.
        arr: share of their steps that were corrected.
        length: their mean number of steps.
        tv: violations during training; None where nothing was trained.
        episodes: of the training; None where nothing was trained.
        training_arr: share of the training's steps that were corrected, or None.
        threshold: epsilon, or WCSAC's cost limit; None without either.
    """

    seed: int
    acr: float
    avr: float
    arr: float
    length: float
    tv: int | None
    episodes: int | None
    training_arr: float | None
    threshold: float | None


@dataclass(frozen=True)
class Budget:
    """What a run cost: steps, updates and episodes of each seed, seconds of all together."""

    env_steps: int | None
    updates: int | None
    wall_seconds: float
    evaluation_episodes: int


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
    path = folder / "result.json"
    try:
        content = json.loads(path.read_text())
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: not a readable JSON file ({error})") from error
    record = _Record(content, str(path))
    seeds = tuple(_seed_result(seed) for seed in record.records("seeds"))
    numbers = tuple(seed.seed for seed in seeds)
    if not seeds or len(set(numbers)) < len(numbers):
        raise ValueError(f"{path}: seeds must be there, and none twice")
    budget = _budget(record.record("budget"))
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


def _seed_result(record: _Record) -> SeedResult:
    return SeedResult(
        seed=record.count("seed"),
        acr=record.number("acr"),
        avr=record.share("avr"),
        arr=record.share("arr"),
        length=record.number("length"),
        tv=record.count("tv") if record.has("tv") else None,
        episodes=record.count("episodes") if record.has("episodes") else None,
        training_arr=record.share("training_arr") if record.has("training_arr") else None,
        threshold=record.share("threshold") if record.has("threshold") else None,
    )


def _budget(record: _Record) -> Budget:
    return Budget(
        env_steps=record.count("env_steps") if record.has("env_steps") else None,
        updates=record.count("updates") if record.has("updates") else None,
        wall_seconds=record.number("wall_seconds"),
        evaluation_episodes=record.count("evaluation_episodes"),
    )


@dataclass(frozen=True)
class _Record:
    """A JSON object that is asked for values of a type, and names the file if it has none."""

    content: Any
    place: str

    def __post_init__(self) -> None:
        if not isinstance(self.content, dict):
            raise ValueError(f"{self.place}: expected an object, not {self.content!r}")

    def has(self, key: str) -> bool:
        """Whether there is a value, and not null."""
        return self.content.get(key) is not None

    def _get(self, key: str) -> Any:
        if key not in self.content:
            raise ValueError(f"{self.place}: {key!r} is missing")
        return self.content[key]

    def _wrong(self, key: str, expected: str) -> ValueError:
        return ValueError(f"{self.place}: {key!r} must be {expected}, not {self.content[key]!r}")

    def text(self, key: str) -> str:
        """A string."""
        value = self._get(key)
        if not isinstance(value, str):
            raise self._wrong(key, "a string")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        value = self._get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(key, "a number")
        if not math.isfinite(value):
            raise self._wrong(key, "finite")
        return float(value)

    def share(self, key: str) -> float:
        """A number in [0, 1]."""
        value = self.number(key)
        if not 0 <= value <= 1:
            raise self._wrong(key, "in [0, 1]")
        return value

    def count(self, key: str) -> int:
        """A whole number, not negative."""
        value = self.number(key)
        if value < 0 or value != int(value):
            raise self._wrong(key, "a count")
        return int(value)

    def record(self, key: str) -> _Record:
        """An object."""
        return _Record(self._get(key), f"{self.place}, {key!r}")

    def records(self, key: str) -> tuple[_Record, ...]:
        """A list of objects."""
        value = self._get(key)
        if not isinstance(value, list):
            raise self._wrong(key, "a list")
        return tuple(_Record(item, f"{self.place}, {key!r}") for item in value)

    def texts(self, key: str) -> Mapping[str, str]:
        """An object whose values are written out as strings."""
        return {name: str(value) for name, value in self.record(key).content.items()}


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
