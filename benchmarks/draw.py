"""Figures and the README's tables from the result files: ``python -m benchmarks.draw``.

``results/cost-against-size.png``: seconds against the number of states;
``results/cost-against-horizon.png``: seconds against H in corridors of one size.
"""

from __future__ import annotations

import json
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.measure import RESULTS

TOOLS = {
    "dead-ends": ("ours_build", "ours_solve", "#0072b2", "o"),
    "Storm": ("storm_build", "storm_T", "#d55e00", "s"),
    "QuantEcon": ("quantecon_build", "quantecon_V", "#009e73", "^"),
}
"""Per tool: what its total consists of, colour, marker (readable without colours)."""


def curve(axes: Axes, rows: list[dict[str, Any]], against: str) -> None:
    """Seconds from arrays to answer of each tool that has an answer."""
    for tool, (build, solve, colour, marker) in TOOLS.items():
        points = [(row[against], row[build] + row[solve]) for row in rows if solve in row]
        if points:
            axes.loglog(*zip(*points, strict=True), color=colour, marker=marker, label=tool)
    axes.grid(alpha=0.3)


def size_figure(rows: list[dict[str, Any]]) -> Figure:
    """One panel a family and numbering."""
    figure = Figure(figsize=(8, 6.4), layout="constrained")
    families = ("brake", "grid", "brake, random numbers", "grid, random numbers")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, family in zip(panels.flat, families, strict=True):
        curve(axes, [row for row in rows if row["family"] == family], "states")
        axes.set_title(family)
    for axes in panels[-1]:
        axes.set_xlabel("states")
    for axes in panels[:, 0]:
        axes.set_ylabel("seconds, arrays to answer")
    panels[0, 0].legend()
    return figure


def horizon_figure(rows: list[dict[str, Any]]) -> Figure:
    """Corridors: the same number of states and transitions, longer and longer."""
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.subplots()
    corridors = [row for row in rows if row["family"] == "corridor"]
    curve(axes, corridors, "H")
    states = max(row["states"] for row in corridors)
    axes.set(xlabel="horizon H", ylabel="seconds, arrays to answer")
    axes.set_title(f"corridors, {states:,} states")
    axes.legend()
    return figure


def seconds(*parts: float) -> str:
    """Parts of a time, with three significant digits."""
    return " + ".join(f"{part:.3g}" for part in parts)


def labels_table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown: one line a model, times in seconds and ratios of sums."""
    lines = [
        "| model | states | H | dead-ends: check + solve | bytes a state "
        "| Storm: write file + read + T | ratio | without file | QuantEcon: build + V | ratio |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        ours = row["ours_build"] + row["ours_solve"]
        storm = row["storm_build"] + row["storm_T"]
        line = [
            row["family"],
            f"{row['states']:,}",
            f"{row['H']:,}",
            seconds(row["ours_build"], row["ours_solve"]),
            f"{row['ours_bytes_per_state']:.1f}",
            seconds(row["storm_write"], row["storm_build"], row["storm_T"]),
            f"{(row['storm_write'] + storm) / ours:.0f}",
            f"{storm / ours:.0f}",
        ]
        if "quantecon_V" in row:
            theirs = (row["quantecon_build"], row["quantecon_V"])
            line += [seconds(*theirs), f"{sum(theirs) / ours:.0f}"]
        else:
            line += ["", ""]
        lines.append("| " + " | ".join(line) + " |")
    return lines


def stochastic_table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown: one line a model, times in seconds, ratios of the labels alone."""
    lines = [
        "| model | states | transitions | dead / at risk / safe "
        "| dead-ends: check + solve | bytes a state | Storm: read + labels | labels, ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        counts = " / ".join(f"{row['counts'][name]:,}" for name in ("DEAD", "AT_RISK", "SAFE"))
        lines.append(
            f"| {row['family']} | {row['states']:,} | {row['transitions']:,} | {counts} "
            f"| {seconds(row['ours_build'], row['ours_solve'])} "
            f"| {row['ours_bytes_per_state']:.0f} "
            f"| {seconds(row['storm_build'], row['storm_labels'])} "
            f"| {row['labels_ratio']:.1f} |"
        )
    return lines


def scale_table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown: one line a model."""
    lines = [
        "| model | states | actions | seconds | bytes a state | sweeps |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['family']} | {row['states']:,} | {row['actions']} "
        f"| {seconds(*([row['build']] if 'build' in row else []), row['seconds'])} "
        f"| {row['bytes_per_state']:.1f} | {row.get('sweeps', '')} |"
        for row in rows
    ]
    return lines


def rows_of(name: str) -> list[dict[str, Any]]:
    """The rows of a result file."""
    rows: list[dict[str, Any]] = json.loads((RESULTS / f"{name}.json").read_text())["rows"]
    return rows


def main() -> None:
    rows = rows_of("labels")
    for lines in (
        labels_table(rows),
        stochastic_table(rows_of("stochastic")),
        scale_table(rows_of("scale")),
    ):
        print("\n".join(lines) + "\n")
    size_figure(rows).savefig(RESULTS / "cost-against-size.png", dpi=150)
    horizon_figure(rows).savefig(RESULTS / "cost-against-horizon.png", dpi=150)


if __name__ == "__main__":
    main()
