"""``label FILE``: which states are lost, and how long they survive."""

from __future__ import annotations

import argparse
import json
import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from dead_ends.cli.output import add_exact_argument, add_output_argument, check_output
from dead_ends.cli.source import (
    add_discount_argument,
    add_source_arguments,
    print_rows,
    read_source,
)
from dead_ends.values.precision import UndecidedError

if TYPE_CHECKING:
    from dead_ends.labels.labelling import Labelling
    from dead_ends.model.safe_mdp import SafeMDP

ESTIMATE = "an estimate from a log: its labels are no guarantee about the task"
SUMMARY = "label every state: fail, dead, safe or at risk"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_output_argument(
        parser, "write labels and survival times (.npz, .csv or .json)", required=False
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    add_discount_argument(parser)
    add_exact_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from dead_ends.labels.classification import classify

    check_output(arguments.out, arguments.file)
    model = read_source(arguments)
    labelling = classify(model)
    summary = summarize(model, labelling, arguments.gamma_safe, arguments.exact)
    if arguments.out:
        from dead_ends.io.labelling import save_labelling

        save_labelling(labelling, arguments.out, model=model, summary=summary)
    if arguments.json:
        print(json.dumps(summary, indent=2))
    else:
        seed = "" if summary["seed"] is None else f", reset with seed {summary['seed']}"
        print(f"{arguments.file}: {summary['kind']}, {model.num_actions} actions{seed}")
        print_rows(_rows(summary))
        if arguments.out:
            print(f"wrote {arguments.out}")
    return 0


def summarize(
    model: SafeMDP, labelling: Labelling, gamma_safe: Any, exact: bool | None
) -> dict[str, Any]:
    """The numbers of a labelled model, ready for JSON."""
    from dead_ends.labels.labelling import Label

    return {
        "kind": "deterministic" if model.is_deterministic else "stochastic",
        "estimate": model.estimate,
        "seed": getattr(model, "seed", None),
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
        "threshold": _threshold(model, gamma_safe, exact),
    }


def _threshold(model: SafeMDP, gamma_safe: Any, exact: bool | None) -> dict[str, Any]:
    """The thresholds; labels are certain even where floats do not tell these."""
    from dead_ends.safety.thresholds import threshold_interval

    try:
        interval = threshold_interval(model, gamma_safe, exact=exact)
    except UndecidedError as error:
        known = dict.fromkeys(("empty", "at_most", "exponent", "recommended"))
        return {**known, "text": f"not known: {error.with_options(('exact', 'gamma_safe'))}"}
    return {
        "empty": interval.empty,
        "at_most": _float_below(interval.upper),
        "exponent": interval.exponent,
        "recommended": interval.recommended,
        "text": str(interval),
    }


def _float_below(upper: float | Fraction | None) -> float | None:
    """The greatest positive float that is at most ``upper``; None if there is none, or no end."""
    if not upper or math.isinf(upper):
        return None
    nearest = float(upper)
    return (nearest if nearest <= upper else math.nextafter(nearest, 0.0)) or None


def _rows(summary: dict[str, Any]) -> list[tuple[str, Any]]:
    rows = [
        *([("model", ESTIMATE)] if summary["estimate"] else []),
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
    rows.append(
        (f"threshold at gamma_safe {summary['gamma_safe']:g}", _with_example(summary["threshold"]))
    )
    return rows


def _known(horizon: int | None) -> int | str:
    return "none" if horizon is None else horizon


def _with_example(threshold: dict[str, Any]) -> str:
    text, example = threshold["text"], threshold["recommended"]
    return text if example is None else f"{text}, for example {example:.12g}"
