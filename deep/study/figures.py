"""Runs -> figures; nothing here reads or saves. A colour belongs to a method, in every figure.

The colours are those of Okabe and Ito, which the colour-blind can tell apart, and a line's style
says the method too. Lines are IQMs over seeds, bands their 95% bootstrap intervals (see
``deep.study.statistics``).
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MaxNLocator, NullLocator

from deep.runs.forms import FORM_ROWS, LineStyle
from deep.runs.seed_result import SeedResult
from deep.study.saved_runs import Run, Study
from deep.study.statistics import Floats, band, estimate
from deep.study.tables import EPSILON_FORMS, ablation_forms, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["COLORS", "STYLES", "Curve", "ablation_figure", "epsilon_figure", "training_figure"]

COLORS = {
    "sac": "#000000",
    "wcsac": "#E69F00",
    **{name: form.color for name, form in FORM_ROWS.items()},
    "iql": "#F0E442",
}
OTHER = "#777777"
STYLES: dict[str, LineStyle] = {
    "wcsac": (0, (1, 1)),
    **{name: form.line for name, form in FORM_ROWS.items() if form.line != "-"},
}
"""Of the methods whose line is not solid: with the colours, no two look the same in grey."""
UNCORRECTED = ("sac", "wcsac", "iql")
"""Methods without a filter; a run of WCSAC has a threshold all the same, its cost limit."""
WIDEST = 11.0
"""Inches, so that letters stay legible where a page shows the picture 900 pixels wide."""
NOTE_SIZE, NOTE_LETTER = 8, 0.062
"""Points, and inches a letter of that size takes."""
BINS = 20
POINTS = 200


@dataclass(frozen=True, eq=False)
class Curve:
    """Numbers over environment steps: steps (n,), values (k, n), a row a seed."""

    steps: Floats
    values: Floats


class Scale(Enum):
    """Of a row of panels: returns of any sign, shares from 0, counts from 0 over decades."""

    RETURN = auto()
    SHARE = auto()
    COUNT = auto()


@dataclass(frozen=True)
class Row:
    """A row of panels, one a task: what stands on its axis, and on which scale."""

    name: str
    scale: Scale


@dataclass(frozen=True)
class CurveRow(Row):
    """A row of panels over environment steps."""

    curve: Callable[[Run], Curve | None]


def _ends(steps: Floats, bins: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """The last row of each of at most so many bins, equally long in environment steps."""
    return np.unique(np.searchsorted(steps, np.linspace(0, steps[-1], bins + 1)[1:]))


def _growth(total: Floats, ends: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Floats:
    """By how much a running total (..., n) grows within each bin; it starts at 0."""
    return np.diff(total[..., ends], axis=-1, prepend=0.0)


def evaluation_returns(run: Run) -> Curve | None:
    """ACR of each evaluation during training."""
    if run.evaluations is None:
        return None
    return Curve(run.evaluations.steps, run.evaluations.columns["acr"])


def violation_share(run: Run) -> Curve | None:
    """Violations of each bin over the episodes that ended in it, while training."""
    if run.progress is None:
        return None
    ends = _ends(run.progress.steps, BINS)
    violations, episodes = (
        _growth(run.progress.columns[name], ends) for name in ("violations", "episodes")
    )
    share = np.full(violations.shape, np.nan)
    np.divide(violations, episodes, out=share, where=episodes > 0)
    return Curve(run.progress.steps[ends], share)


def total_violations(run: Run) -> Curve | None:
    """Violations since training began; the last one is TV."""
    if run.progress is None:
        return None
    ends = _ends(run.progress.steps, POINTS)
    return Curve(run.progress.steps[ends], run.progress.columns["violations"][:, ends])


def interventions(run: Run) -> Curve | None:
    """Share of each bin's training steps that were corrected; None for a run without a filter."""
    if run.progress is None or run.method in UNCORRECTED:
        return None
    steps = run.progress.steps
    ends = _ends(steps, BINS)
    corrected = run.progress.columns["interventions"] * np.diff(steps, prepend=0.0)
    share = _growth(np.cumsum(corrected, axis=-1), ends) / _growth(steps, ends)
    return Curve(steps[ends], share)


CURVE_ROWS = (
    CurveRow("return in evaluation (ACR)", Scale.RETURN, evaluation_returns),
    CurveRow("episodes that end in\na violation, training", Scale.SHARE, violation_share),
    CurveRow("violations in training\nso far (TV)", Scale.COUNT, total_violations),
    CurveRow("steps corrected,\ntraining (ARR)", Scale.SHARE, interventions),
)


def training_figure(study: Study) -> Figure:
    """A column a task; the methods' curves over environment steps."""
    return _curves(study, "train", study.methods("train"))


def ablation_figure(study: Study) -> Figure:
    """The forms of pretraining behind SAC, all at one threshold."""
    return _curves(study, "ablation", ablation_forms(study))


def _grid(
    study: Study,
    section: str,
    methods: Sequence[str],
    rows: Sequence[Row],
) -> tuple[Figure, list[str], list[list[Axes]]]:
    """A figure with a column a task of the section and its panels[row][column].

    Which of the methods have no run on a task stands above its first panel. Returns have a
    scale of their own on each task, everything else one for all.
    """
    runs = study.section(section)
    tasks = [task for task in study.tasks() if any(found == task for found, _ in runs)]
    width = min(max(3.3 * len(tasks) + 0.6, 6.5), WIDEST)
    figure = Figure(figsize=(width, 2.1 * len(rows) + 1.3), layout="constrained")
    grid = _panels(figure, rows, len(tasks))
    for panels, row in zip(grid, rows, strict=True):
        panels[0].set_ylabel(row.name)
        if row.scale is Scale.COUNT:
            panels[0].set_yscale("symlog", linthresh=1)  # a count may be 0
            panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    letters = int((width - 0.8) / len(tasks) / NOTE_LETTER) - 4
    missing = [[label(m) for m in methods if (task, m) not in runs] for task in tasks]
    _titles(grid[0], tasks, [_missing_note(names, letters) for names in missing])
    for axes in figure.axes:
        axes.grid(color="#e4e4e4", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, tasks, grid


def _panels(figure: Figure, rows: Sequence[Row], columns: int) -> list[list[Axes]]:
    """Empty panels[row][column]: x shared in a column, y in a row unless it holds returns."""
    places = figure.add_gridspec(len(rows), columns)
    grid: list[list[Axes]] = []
    for r, row in enumerate(rows):
        panels: list[Axes] = []
        for c in range(columns):
            shared = panels[0] if panels and row.scale is not Scale.RETURN else None
            axes = figure.add_subplot(
                places[r, c], sharex=grid[0][c] if grid else None, sharey=shared
            )
            axes.tick_params(labelbottom=r == len(rows) - 1, labelleft=shared is None)
            panels.append(axes)
        grid.append(panels)
    return grid


def _missing_note(names: Sequence[str], letters: int) -> str:
    """The names, none of them broken, in lines of about so many letters; empty without names."""
    whole = [name.replace(" ", "\N{NO-BREAK SPACE}") for name in names]
    note = textwrap.fill(f"missing: {', '.join(whole)}", letters, break_on_hyphens=False)
    return note if names else ""


def _titles(panels: Sequence[Axes], tasks: Sequence[str], notes: Sequence[str]) -> None:
    """Each task's name, and below it, still outside the panel, its note."""
    lines = max(len(note.splitlines()) for note in notes)
    for axes, task, note in zip(panels, tasks, notes, strict=True):
        axes.set_title(task, pad=6 + 1.3 * NOTE_SIZE * lines)
        if note:
            axes.annotate(
                note, (0.5, 1), xytext=(0, 4), xycoords="axes fraction",
                textcoords="offset points", ha="center", va="bottom", fontsize=NOTE_SIZE,
            )  # fmt: skip


def _legend(figure: Figure, methods: Sequence[str], marker: str = "") -> None:
    lines = [Line2D([], [], marker=marker, linewidth=2, **_look(method)) for method in methods]
    names = [label(method) for method in methods]
    columns = max(1, len(methods) if len(methods) <= 4 else -(-len(methods) // 2))
    figure.legend(
        lines, names, loc="outside lower center", ncols=columns, frameon=False, handlelength=3
    )


def _look(method: str) -> dict[str, Any]:
    """Colour and style of a method's line, in every figure."""
    return {"color": COLORS.get(method, OTHER), "linestyle": STYLES.get(method, "-")}


def _curves(study: Study, section: str, methods: Sequence[str]) -> Figure:
    runs = study.section(section)
    figure, tasks, grid = _grid(study, section, methods, CURVE_ROWS)
    drawn = set()
    for row, panels in zip(CURVE_ROWS, grid, strict=True):
        for axes, task in zip(panels, tasks, strict=True):
            for method in methods:
                run = runs.get((task, method))
                curve = row.curve(run) if run else None
                if curve is not None:
                    _curve(axes, curve, method)
                    drawn.add(method)
    _from_zero(CURVE_ROWS, grid)
    for axes in grid[-1]:
        axes.set_xlabel("steps of a seed")
        axes.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set_xlim(left=0)
    _legend(figure, [method for method in methods if method in drawn])
    return figure


def _curve(axes: Axes, curve: Curve, method: str) -> None:
    """The line and its band; a lone point, which makes no line, is a dot."""
    look, across = _look(method), band(curve.values)
    marker = "o" if len(curve.steps) == 1 else ""
    axes.plot(curve.steps, across.value, linewidth=1.6, marker=marker, label=method, **look)
    axes.fill_between(
        curve.steps, across.low, across.high, color=look["color"], alpha=0.15, linewidth=0
    )


def _from_zero(rows: Sequence[Row], grid: Sequence[Sequence[Axes]]) -> None:
    """Shares and counts begin at 0; to be called when all is drawn, as it fixes the limits."""
    for row, panels in zip(rows, grid, strict=True):
        if row.scale is not Scale.RETURN:
            panels[0].set_ylim(bottom=0)


@dataclass(frozen=True)
class EpsilonRow(Row):
    """A row of panels over thresholds."""

    value: Callable[[SeedResult], float | None]


EPSILON_ROWS = (
    EpsilonRow("return (ACR)", Scale.RETURN, lambda seed: seed.acr),
    EpsilonRow("episodes that end in\na violation (AVR)", Scale.SHARE, lambda seed: seed.avr),
    EpsilonRow("violations in training\n(TV)", Scale.COUNT, lambda seed: seed.tv),
    EpsilonRow("steps corrected,\ntraining (ARR)", Scale.SHARE, lambda seed: seed.training_arr),
)


def epsilon_figure(study: Study) -> Figure:
    """Outcomes over the threshold: dots are seeds, lines IQMs, rings what was chosen."""
    runs, trained = study.section("select"), study.section("train")
    figure, tasks, grid = _grid(study, "select", EPSILON_FORMS, EPSILON_ROWS)
    for row, panels in zip(EPSILON_ROWS, grid, strict=True):
        for axes, task in zip(panels, tasks, strict=True):
            for form in EPSILON_FORMS:
                if (task, form) in runs:
                    final = trained.get((task, form))
                    chosen = [threshold for threshold, _ in final.by_threshold()] if final else []
                    _thresholds(axes, runs[task, form], row, form, chosen)
    _from_zero(EPSILON_ROWS, grid)
    for axes in grid[-1]:
        axes.set_xlabel("threshold ε")
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
    found = study.methods("select")
    _legend(figure, [form for form in EPSILON_FORMS if form in found], marker="o")
    return figure


def _thresholds(axes: Axes, run: Run, row: EpsilonRow, form: str, chosen: Sequence[float]) -> None:
    """A form's dots, and the line through the IQMs with their intervals where there are some."""
    color = COLORS[form]
    line = []
    for threshold, seeds in run.by_threshold():
        numbers = [number for number in map(row.value, seeds) if number is not None]
        if len(numbers) < len(seeds):
            continue
        axes.scatter([threshold] * len(numbers), numbers, color=color, s=14, alpha=0.6)
        middle = estimate(numbers)
        line.append((threshold, middle.value))
        if middle.low is not None and middle.high is not None:
            axes.vlines(threshold, middle.low, middle.high, color=color, linewidth=1.2)
    axes.plot([x for x, _ in line], [y for _, y in line], linewidth=1.6, label=form, **_look(form))
    ringed = [(x, y) for x, y in line if x in chosen]
    axes.scatter(
        [x for x, _ in ringed], [y for _, y in ringed], s=90, facecolors="none", edgecolors=color
    )
