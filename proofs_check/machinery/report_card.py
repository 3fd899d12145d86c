"""The report card: what a run found, as verdicts.

Every check leaves its numbers in the properties of its test (which pytest-xdist carries from
the workers to the one process that reports); at the end they are gathered by statement. A
verdict follows from the numbers and from the outcome of the tests alone:

    broken    a test of the statement failed: nothing can be said,
    false     a model in which the claim fails was found,
    proved    no such model, and the proof kernel accepted its theorems in this run,
    holds     no such model among those checked.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from dead_ends.io.atomic import atomic_path
from proofs_check.machinery.statement import Row, Tally

README = Path(__file__).parents[1] / "README.md"
BEGIN, END = "<!-- report: begin -->", "<!-- report: end -->"
GALLERY_BEGIN, GALLERY_END = "<!-- counterexamples: begin -->", "<!-- counterexamples: end -->"
STATEMENT, KERNEL = "statement", "kernel"
"""Keys of the properties that tests leave: a row's numbers, the theorems proved."""


class Means(StrEnum):
    """How a statement was checked."""

    EXHAUSTIVE = "exhaustive"
    SIX_STATES = "n = 6"
    GRID = "grid"
    SAMPLED = "drawn"
    INSTANCE = "instance"


Recorder = Callable[[Row, Means, Tally], None]
"""The fixture ``record``: leaves a row's numbers with its test."""


@dataclass
class Statement:
    """What a run found out about one statement."""

    name: str
    place: str
    claim: str
    rests_on: str
    theorems: tuple[str, ...]
    results: dict[str, Tally] = field(default_factory=dict)
    broken: bool = False

    def proved(self, accepted: frozenset[str]) -> bool:
        """Whether the kernel accepted all theorems of the statement."""
        return bool(self.theorems) and accepted.issuperset(self.theorems)

    def verdict(self, accepted: frozenset[str]) -> str:
        """From the numbers alone."""
        if self.broken:
            return "broken"
        if any(result.violated for result in self.results.values()):
            return "false"
        return "proved" if self.proved(accepted) else "holds"


def properties(row: Row, means: Means, result: Tally) -> dict[str, Any]:
    """What travels with a test: plain data."""
    return {
        "name": row.name,
        "place": row.place,
        "claim": row.claim,
        "rests_on": row.rests_on,
        "theorems": list(row.kernel),
        "means": means.value,
        "tally": asdict(result),
    }


def gather(entries: Iterable[tuple[dict[str, Any], bool]]) -> dict[str, Statement]:
    """Statements by name, in the order met, from (properties, the test passed)."""
    statements: dict[str, Statement] = {}
    for entry, passed in entries:
        statement = statements.setdefault(
            entry["name"],
            Statement(
                entry["name"],
                entry["place"],
                entry["claim"],
                entry["rests_on"],
                tuple(entry["theorems"]),
            ),
        )
        before = statement.results.get(entry["means"], Tally())
        statement.results[entry["means"]] = before + Tally(**entry["tally"])
        statement.broken |= not passed
    return dict(sorted(statements.items()))


@dataclass(frozen=True)
class Card:
    """The statements of a run and the theorems that the kernel accepted in it.

    Attributes:
        statements: by name.
        accepted: names of theorems; None if the kernel did not run.
        missing: why it did not run.
    """

    statements: dict[str, Statement]
    accepted: frozenset[str] | None
    missing: str = ""

    def cells(self, statement: Statement) -> dict[str, str]:
        """What this run says about a statement, by column; only what it looked into."""
        results = statement.results
        cells = {
            "statement": statement.name,
            "paper": statement.place,
            "claim": statement.claim,
            "rests on": statement.rests_on,
        }
        counted = [m for m in (Means.EXHAUSTIVE, Means.GRID, Means.INSTANCE) if m in results]
        if counted:
            cells["checked"] = "; ".join(f"{numbers(results[m])} {UNITS[m]}" for m in counted)
        if Means.SIX_STATES in results:
            cells["n = 6"] = numbers(results[Means.SIX_STATES])
        if Means.SAMPLED in results:
            cells["drawn"] = "yes"
        if not statement.theorems:
            cells["kernel"] = "–"
        elif self.accepted is not None:
            cells["kernel"] = self.kernel_cell(statement)
        if counted and "kernel" in cells:
            cells["verdict"] = statement.verdict(self.accepted or frozenset())
        return cells

    def kernel_cell(self, statement: Statement) -> str:
        """Which theorems the kernel accepted, or why it did not run."""
        if not statement.theorems:
            return "–"
        if self.accepted is None:
            return f"not run: {self.missing}"
        return ", ".join(
            f"{name}" if name in self.accepted else f"{name} NOT PROVED"
            for name in statement.theorems
        )


def kernel_missing() -> str:
    """Why the kernel has not run (yet)."""
    return "not asked for" if shutil.which("coqc") else "coqc not installed"


COLUMNS = (
    "statement",
    "paper",
    "claim",
    "verdict",
    "checked",
    "n = 6",
    "drawn",
    "kernel",
    "rests on",
)
UNITS = {
    Means.EXHAUSTIVE: "models, all",
    Means.GRID: "stochastic models, all of a grid",
    Means.INSTANCE: "instances",
}


def numbers(result: Tally) -> str:
    """How many models, and how many break the claim."""
    if result.violated:
        return f"broken by {result.violated:,} of {result.models:,}"
    if result.met == result.models:
        return f"{result.models:,}"
    return f"{result.models:,} ({result.met:,} meet the premise)"


def terminal_lines(card: Card) -> Iterable[str]:
    """The card for a terminal: a line a statement."""
    accepted = card.accepted or frozenset()
    for statement in card.statements.values():
        yield f"{statement.verdict(accepted):7} {statement.name}: {statement.claim}"
        means = [f"{means}: {numbers(result)}" for means, result in statement.results.items()]
        if statement.theorems:
            means.append(f"kernel: {card.kernel_cell(statement)}")
        yield f"        {statement.place}; {'; '.join(means)}; rests on: {statement.rests_on}"
    count = {
        verdict: sum(s.verdict(accepted) == verdict for s in card.statements.values())
        for verdict in ("proved", "holds", "false", "broken")
    }
    yield ", ".join(f"{number} {verdict}" for verdict, number in count.items())


def parse(text: str) -> dict[str, dict[str, str]]:
    """The rows of the table in the README, by statement."""
    table = text.partition(BEGIN)[2].partition(END)[0]
    rows = {}
    for line in table.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == len(COLUMNS) and cells[0] not in ("statement", "---"):
            row = dict(zip(COLUMNS, cells, strict=True))
            rows[row["statement"]] = row
    return rows


def render(rows: dict[str, dict[str, str]]) -> str:
    """The table as Markdown."""
    lines = [_line(COLUMNS), _line(["---"] * len(COLUMNS))]
    lines += [_line([row.get(column, "") for column in COLUMNS]) for _, row in sorted(rows.items())]
    return "\n".join(lines)


def gallery(rows: dict[str, dict[str, str]]) -> str:
    """The counterexample of each refuted statement: picture, claim, model file."""
    parts = [
        f"**{name}** ([model](counterexamples/{name}.npz))\n\n"
        f"![The smallest counterexample to {name}](../figures/counterexample-{name}.png)\n"
        for name, row in sorted(rows.items())
        if row.get("verdict") == "false"
    ]
    return "\n".join(parts)


def _between(text: str, begin: str, end: str, content: str) -> str:
    """The text with everything between two marks replaced."""
    head, _, rest = text.partition(begin)
    return f"{head}{begin}\n{content}\n{end}{rest.partition(end)[2]}"


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def escaped(cells: dict[str, str]) -> dict[str, str]:
    """Cells that may hold a bar, as |S_dead|."""
    return {column: cell.replace("|", r"\|") for column, cell in cells.items()}


def stale(card: Card, complete: bool) -> list[str]:
    """Where the README's table differs from what this run found."""
    text = README.read_text(encoding="utf-8")
    rows = parse(text)
    differences = []
    if text != _between(text, GALLERY_BEGIN, GALLERY_END, gallery(rows)):
        differences.append("the counterexamples are not those of the table")
    for name, statement in card.statements.items():
        if name not in rows:
            differences.append(f"{name}: no such row")
            continue
        for column, cell in escaped(card.cells(statement)).items():
            if rows[name][column] != cell:
                differences.append(f"{name}, {column}: found {cell!r}, not {rows[name][column]!r}")
    if complete:
        differences += [f"{name}: no such statement" for name in rows.keys() - card.statements]
    return differences


def write(card: Card, complete: bool) -> None:
    """Put what this run found into the README; keep what it did not look into."""
    text = README.read_text(encoding="utf-8")
    rows = parse(text)
    if complete:
        rows = {name: row for name, row in rows.items() if name in card.statements}
    for name, statement in card.statements.items():
        rows[name] = rows.get(name, {}) | escaped(card.cells(statement))
    text = _between(text, BEGIN, END, render(rows))
    text = _between(text, GALLERY_BEGIN, GALLERY_END, gallery(rows))
    with atomic_path(README) as path:
        path.write_text(text, encoding="utf-8")
