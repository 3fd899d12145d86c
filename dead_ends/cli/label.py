"""``label FILE``: which states are lost, and how long they survive."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING, Any

from dead_ends.cli.source import (
    add_discount_argument,
    add_source_arguments,
    print_rows,
    read_source,
)

if TYPE_CHECKING:
    from dead_ends.model import SafeMDP
    from dead_ends.results import Labelling

SUMMARY = "label every state: fail, dead, safe or at risk"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    parser.add_argument(
        "--out", metavar="PATH", help="write labels and survival times (.npz, .csv or .json)"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    add_discount_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.labels import classify

    model = read_source(arguments)
    labelling = classify(model)
    summary = summarize(model, labelling, arguments.gamma_safe)
    if arguments.out:
        from dead_ends.io.labelling import save_labelling

        save_labelling(arguments.out, model, labelling, summary)
    if arguments.json:
        print(json.dumps(summary, indent=2))
    else:
        print(f"{arguments.file}: {summary['kind']}, {model.num_actions} actions")
        print_rows(_rows(summary))
        if arguments.out:
            print(f"wrote {arguments.out}")
    return 0


def summarize(model: SafeMDP, labelling: Labelling, gamma_safe: Any) -> dict[str, Any]:
    """The numbers of a labelled model, ready for JSON."""
    from dead_ends.results import Label
    from dead_ends.thresholds import threshold_interval

    interval = threshold_interval(model, gamma_safe)
    bounded = not interval.empty and not math.isinf(interval.upper)
    return {
        "kind": "deterministic" if model.is_deterministic else "stochastic",
        "states": model.num_states,
        "actions": model.num_actions,
        **{label.name.lower(): labelling.count(label) for label in sorted(Label)},
        "terminal": int(model.terminal.sum()),
        **({} if model.normalised is None else {"rows_normalised": model.normalised}),
        "horizon": labelling.horizon,
        "boundary_horizon": labelling.boundary_horizon,
        "reachable_horizon": labelling.reachable_horizon,
        "reachable_boundary_horizon": labelling.reachable_boundary_horizon,
        "gamma_safe": float(gamma_safe),
        "threshold": {
            "empty": interval.empty,
            "at_most": float(interval.upper) if bounded else None,
            "exponent": interval.exponent,
            "recommended": interval.recommended,
        },
    }


def _rows(summary: dict[str, Any]) -> list[tuple[str, Any]]:
    rows = [
        ("states", summary["states"]),
        ("fail", summary["fail"]),
        ("dead", summary["dead"]),
        ("safe", summary["safe"]),
    ]
    if summary["kind"] == "stochastic":
        rows.append(("at risk", summary["at_risk"]))
    if summary.get("rows_normalised"):
        rows.append(("rows normalised", summary["rows_normalised"]))
    rows.append(("horizon H", _known(summary["horizon"])))
    rows.append(("boundary horizon H_b", _known(summary["boundary_horizon"])))
    if summary["reachable_horizon"] is not None:
        rows.append(("H, reachable", summary["reachable_horizon"]))
        rows.append(("H_b, reachable", _known(summary["reachable_boundary_horizon"])))
    rows.append((f"threshold at gamma_safe {summary['gamma_safe']:g}", _threshold(summary)))
    return rows


def _known(horizon: int | None) -> int | str:
    return "none" if horizon is None else horizon


def _threshold(summary: dict[str, Any]) -> str:
    threshold = summary["threshold"]
    if threshold["empty"]:
        return "none separates safe from unsafe actions"
    if threshold["at_most"] is None:
        return "any, for no action leaves the safe states"
    power = "" if threshold["exponent"] is None else f"gamma_safe**{threshold['exponent']} = "
    example = threshold["recommended"]
    between = "" if example is None else f", for example {example:.12g}"
    return f"0 < epsilon_safe <= {power}{threshold['at_most']!r}{between}"
