"""Runs -> Markdown tables and rows of CSV files; nothing here reads or writes files.

A number of ours is an IQM over seeds with its 95% interval (see ``deep.study.statistics``); the
paper's stand beside it, and so does what it cost. What was not run is called missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from deep.runs.forms import FORM_ROWS
from deep.runs.seed_result import SeedResult
from deep.study.paper_results import PaperScore, paper_score
from deep.study.saved_runs import METHODS, Run, Study
from deep.study.statistics import Estimate, estimate

__all__ = [
    "EPSILON_FORMS",
    "ablation_forms",
    "ablation_table",
    "epsilon_table",
    "label",
    "main_table",
    "plug_table",
    "seed_rows",
]

MISSING = "missing"
NONE = "–"
PLUG_POLICIES = ("sac", "iql")
PLUG_FILTERS = tuple(name for name, form in FORM_ROWS.items() if form.plugged)
EPSILON_FORMS = tuple(sorted(FORM_ROWS, key=lambda name: FORM_ROWS[name].proposed))
"""WCSAC's limit is no epsilon: it has rows in the table, and no place on the axis."""
ABLATION_FORMS = tuple(name for name in EPSILON_FORMS if not FORM_ROWS[name].from_horizon)
"""The forms with one gamma_safe, to which one epsilon means the same."""

DIGITS = {"acr": 2, "avr": 3, "tv": 0, "arr": 3, "training_arr": 3, "length": 0}
"""The fields of a seed's result that tables show, with their decimals."""

BUDGET = ("seeds", "env steps", "updates", "evaluation episodes", "wall time")


def label(method: str) -> str:
    """A method's name in print; of a pair: the policy's, behind the filter's."""
    policy, plus, safety = method.partition("+")
    name = METHODS.get(policy, policy)
    return f"{name} with {METHODS.get(safety, safety)}" if plus else name


def _markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _text(value: Estimate, digits: int) -> str:
    text = f"{value.value:,.{digits}f}"
    if value.low is None or value.high is None or value.low == value.high:
        return text
    return f"{text} [{value.low:,.{digits}f}, {value.high:,.{digits}f}]"


def _cell(seeds: Sequence[SeedResult], field: str) -> str:
    """The estimate of what every seed has; a dash where the method has no such number."""
    numbers = [getattr(seed, field) for seed in seeds]
    return NONE if None in numbers else _text(estimate(numbers), DIGITS[field])


def _thresholds(seeds: Sequence[SeedResult]) -> str:
    values = sorted({seed.threshold for seed in seeds if seed.threshold is not None})
    return ", ".join(f"{value:.3g}" for value in values) or NONE


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


def _count(value: int | None) -> str:
    return NONE if value is None else f"{value:,}"


def _budget(run: Run) -> list[str]:
    budget = run.budget
    return [
        str(len(run.seeds)),
        _count(budget.env_steps),
        _count(budget.updates),
        _count(budget.evaluation_episodes),
        _duration(budget.wall_seconds),
    ]


def _paper(score: PaperScore | None) -> tuple[str, str, str, str]:
    """ACR, AVR, TV and ARR of the paper, to its own digits."""
    if score is None:
        return NONE, NONE, NONE, NONE
    arr = NONE if score.arr is None else f"{score.arr:.3f}"
    return f"{score.acr:.3f}", f"{score.avr:.3f}", _count(score.tv), arr


def main_table(study: Study) -> str:
    """A table a task: each method's ACR, AVR, TV and ARR beside the paper's, with the budget."""
    header = ["method", "ACR", "paper ACR", "AVR", "paper AVR", "TV", "paper TV"]
    header += ["ARR, evaluation", "ARR, training", "ε or d", *BUDGET]
    runs = study.section("train")
    methods = tuple(dict.fromkeys((*METHODS, *study.methods("train"))))
    parts = []
    for task in study.tasks():
        rows = [_main_row(runs.get((task, method)), task, method) for method in methods]
        parts.append(f"### {task}\n\n{_markdown(header, rows)}")
    together = _all_tasks(study, methods)
    return "\n".join([*parts, *together])


def _main_row(run: Run | None, task: str, method: str) -> list[str]:
    acr, avr, tv, _ = _paper(paper_score(task, method))
    if run is None:
        ours = [MISSING, acr, MISSING, avr, MISSING, tv, MISSING, MISSING, NONE]
        return [label(method), *ours, *[NONE] * len(BUDGET)]
    seeds = run.seeds
    return [
        label(method),
        *(_cell(seeds, "acr"), acr),
        *(_cell(seeds, "avr"), avr),
        *(_cell(seeds, "tv"), tv),
        *(_cell(seeds, "arr"), _cell(seeds, "training_arr")),
        _thresholds(seeds),
        *_budget(run),
    ]


def _all_tasks(study: Study, methods: Sequence[str]) -> list[str]:
    """IQMs over tasks and seeds, where SAC is there as the unit; no task twice.

    What ran on MuJoCo too (``real:``) counts once, by its vectorised runs.
    """
    runs = study.section("train")
    tasks = [
        task for task in study.tasks() if (task, "sac") in runs and not task.startswith("real:")
    ]
    if len(tasks) < 2:
        return []
    scales = [_sac_scale(runs[task, "sac"]) for task in tasks]
    rows = []
    for method in methods:
        found = [runs[task, method] for task in tasks if (task, method) in runs]
        if len(found) < len(tasks):
            rows.append([label(method), *[MISSING] * 5, NONE])
            continue
        seeds = str(sum(len(run.seeds) for run in found))
        rows.append(
            [
                label(method),
                _strata(found, "acr", 2, [acr for acr, _ in scales]),
                _strata(found, "avr", 3),
                _strata(found, "tv", 3, [tv for _, tv in scales]),
                _strata(found, "arr", 3),
                _strata(found, "training_arr", 3),
                seeds,
            ]
        )
    header = ["method", "ACR / SAC's", "AVR", "TV / SAC's", "ARR, evaluation", "ARR, training"]
    table = _markdown([*header, "seeds"], rows)
    return [f"### All tasks together\n\nOver {', '.join(tasks)}.\n\n{table}"]


def _sac_scale(run: Run) -> tuple[float, float]:
    """SAC's ACR and TV on a task, the units of the others' there."""
    acr = estimate([seed.acr for seed in run.seeds]).value
    tv = estimate([seed.tv or 0 for seed in run.seeds]).value
    return acr, tv


def _strata(
    runs: Sequence[Run], field: str, digits: int, units: Sequence[float] | None = None
) -> str:
    """The estimate over tasks and seeds, each task's numbers in its unit."""
    strata = [[getattr(seed, field) for seed in run.seeds] for run in runs]
    if any(None in stratum for stratum in strata):
        return NONE
    if units is None:
        return _text(estimate(*strata), digits)
    if min(units) <= 0:
        return NONE  # no share of nothing
    scaled = [np.array(stratum) / unit for stratum, unit in zip(strata, units, strict=True)]
    return _text(estimate(*(stratum.tolist() for stratum in scaled)), digits)


def plug_table(study: Study) -> str:
    """A table a task: trained SAC and IQL alone, and behind each pretrained filter."""
    header = ["task policy", "ACR", "paper ACR", "AVR", "paper AVR", "ARR", "paper ARR"]
    header += ["steps an episode", "ε", "seeds", "evaluation episodes"]
    alone, behind = study.section("train"), study.section("plug")
    pairs = [f"{policy}+{safety}" for safety in PLUG_FILTERS for policy in PLUG_POLICIES]
    pairs += [method for method in study.methods("plug") if method not in pairs]
    parts = []
    for task in study.tasks():
        rows = [_plug_row(alone.get((task, name)), task, name) for name in PLUG_POLICIES]
        rows += [_plug_row(behind.get((task, name)), task, name) for name in pairs]
        parts.append(f"### {task}\n\n{_markdown(header, rows)}")
    return "\n".join(parts)


def _plug_row(run: Run | None, task: str, method: str) -> list[str]:
    acr, avr, _, arr = _paper(paper_score(task, method))
    name = label(method) if "+" in method else f"{label(method)} alone"
    if run is None:
        ours = [MISSING, acr, MISSING, avr, MISSING, arr, MISSING]
        return [name, *ours, NONE, NONE, NONE]
    seeds = run.seeds
    return [
        name,
        *(_cell(seeds, "acr"), acr),
        *(_cell(seeds, "avr"), avr),
        *(_cell(seeds, "arr"), arr),
        _cell(seeds, "length"),
        _thresholds(seeds),
        str(len(seeds)),
        _count(run.budget.evaluation_episodes),
    ]


OUTCOMES = {
    "ACR": "acr",
    "AVR": "avr",
    "TV": "tv",
    "ARR, evaluation": "arr",
    "ARR, training": "training_arr",
}


def _outcomes(seeds: Sequence[SeedResult]) -> list[str]:
    return [_cell(seeds, field) for field in OUTCOMES.values()]


def ablation_forms(study: Study) -> tuple[str, ...]:
    """Those that belong there, and what else was run."""
    return tuple(dict.fromkeys((*ABLATION_FORMS, *study.methods("ablation"))))


def ablation_table(study: Study) -> str:
    """A table a task: the forms of pretraining at one threshold."""
    runs = study.section("ablation")
    parts = []
    for task in study.tasks():
        rows = []
        for form in ablation_forms(study):
            run = runs.get((task, form))
            if run is None:
                numbers = [*[MISSING] * len(OUTCOMES), *[NONE] * (1 + len(BUDGET))]
            else:
                numbers = [*_outcomes(run.seeds), _thresholds(run.seeds), *_budget(run)]
            rows.append([label(form), *numbers])
        table = _markdown(["form", *OUTCOMES, "ε", *BUDGET], rows)
        parts.append(f"### {task}\n\n{table}")
    return "\n".join(parts)


def epsilon_table(study: Study) -> str:
    """A table a task: a row a form and threshold; ``chosen`` is what the training runs used."""
    runs, trained = study.section("select"), study.section("train")
    header = ["method", "ε or d", *OUTCOMES, *BUDGET, "chosen"]
    forms = tuple(dict.fromkeys((*EPSILON_FORMS, *study.methods("select"))))
    parts = []
    for task in study.tasks():
        rows = []
        for form in forms:
            run = runs.get((task, form))
            if run is None:
                rows.append([label(form), NONE, *[MISSING] * len(OUTCOMES), *[NONE] * 6])
                continue
            final = trained.get((task, form))
            chosen = [threshold for threshold, _ in final.by_threshold()] if final else []
            for threshold, seeds in run.by_threshold():
                cost = [str(len(seeds)), *_budget(run)[1:]]
                mark = "yes" if threshold in chosen else ""
                rows.append([label(form), f"{threshold:.3g}", *_outcomes(seeds), *cost, mark])
        parts.append(f"### {task}\n\n{_markdown(header, rows)}")
    return "\n".join(parts)


SEED_COLUMNS = (
    *("task", "method", "seed", "acr", "avr", "arr", "length", "tv", "episodes", "training_arr"),
    *("threshold", "env_steps", "updates", "evaluation_episodes", "wall_seconds", "run", "git"),
)


def seed_rows(study: Study, section: str) -> list[tuple[str | int | float | None, ...]]:
    """The rows of a CSV file, its header first: a row a seed, with the run it comes from."""
    rows: list[tuple[str | int | float | None, ...]] = [SEED_COLUMNS]
    runs = study.section(section)
    for task in study.tasks():
        for method in study.methods(section):
            if (task, method) in runs:
                rows += [_seed_row(runs[task, method], seed) for seed in runs[task, method].seeds]
    return rows


def _seed_row(run: Run, seed: SeedResult) -> tuple[str | int | float | None, ...]:
    budget = run.budget
    return (
        *(run.task, run.method, seed.seed, seed.acr, seed.avr, seed.arr, seed.length, seed.tv),
        *(seed.episodes, seed.training_arr, seed.threshold, budget.env_steps, budget.updates),
        *(budget.evaluation_episodes, budget.wall_seconds, run.folder),
        run.made_with.get("git", ""),
    )
