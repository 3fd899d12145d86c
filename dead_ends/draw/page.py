"""One self-contained page about a model: ``python -m dead_ends page FILE --out page.html``.

The page shows the labels in the model's geometry (or in a layout by survival time, if it has
none), lets one move gamma_safe and epsilon_safe and see what each safety critic blocks, and
answers a click on a state with the witness of its label. It needs no network.

What the page is told: for each critic and each gamma on a grid the discounted time
V(s) = E gamma^T (1 on fail states), so that Q(s, a) = sum of P(s' | s, a) V(s') and the gate
Q < epsilon can be evaluated in the browser at any threshold. In deterministic models these are
the powers of gamma themselves: deciding on gamma * gamma^(T - 1) would let dead-ends through.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.certificates.checker import Certificate
from dead_ends.draw.geometry import COLORS
from dead_ends.draw.palette import BLOCKED, LET_THROUGH, WALL
from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.safe_mdp import Geometry, SafeMDP, require_type
from dead_ends.safety.thresholds import ThresholdInterval
from dead_ends.values.values import Values

__all__ = ["PageAnswers", "draw_page", "layout_by_survival_time"]

COLUMN_HEIGHT = 40


@dataclass(frozen=True, eq=False)
class PageAnswers:
    """What a page tells of its model; :func:`dead_ends.cli.page_answers.page_answers` solves it.

    Attributes:
        labelling: the model's labels.
        certificate: their witnesses.
        gammas: the values of gamma_safe that can be chosen, 0.99 among them.
        intervals: the exact thresholds at each gamma.
        critics: by name, a critic's discounted time at each gamma.
    """

    labelling: Labelling
    certificate: Certificate
    gammas: Sequence[float]
    intervals: Sequence[ThresholdInterval]
    critics: Mapping[str, Sequence[Values]]


def draw_page(model: SafeMDP, answers: PageAnswers, title: str) -> str:
    """The HTML page.

    Args:
        model: the model.
        answers: what is known of it.
        title: the page's heading, the model's name.
    """
    require_type(model, SafeMDP, "draw_page")
    require_type(answers, PageAnswers, "draw_page")
    content = {
        "title": title,
        "kind": "deterministic" if model.is_deterministic else "stochastic",
        "estimate": model.estimate,
        **_states(model, answers.labelling, answers.certificate),
        **_picture(model, answers.labelling),
        "gammas": answers.gammas,
        "intervals": [_upper(interval) for interval in answers.intervals],
        "intervalTexts": [str(interval) for interval in answers.intervals],
        "critics": [_critic(name, critics) for name, critics in answers.critics.items()],
    }
    template = files("dead_ends.draw").joinpath("page.html").read_text(encoding="utf-8")
    # "</" would end the script element that holds the data.
    data = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return template.replace("/*DATA*/null", data)


def layout_by_survival_time(labelling: Labelling) -> Geometry:
    """A place for each state of a model without geometry: failure to the left, safety right.

    From left to right: fail, dead by survival time (those without a bound last), at risk,
    safe. A group with many states takes several columns.
    """
    require_type(labelling, Labelling, "layout_by_survival_time")
    groups = [np.flatnonzero(labelling.fail)]
    times = labelling.survival_time
    groups += [
        np.flatnonzero(labelling.dead & (times == time))
        for time in np.unique(times[labelling.dead])
    ]
    groups += [np.flatnonzero(labelling.at_risk), np.flatnonzero(labelling.safe)]
    largest = max(len(group) for group in groups)
    height = max(COLUMN_HEIGHT, int(np.sqrt(largest)))
    cell = np.zeros((len(times), 2), dtype=np.int32)
    column = 0
    for group in groups:
        place = np.arange(len(group))
        cell[group] = np.stack((column + place // height, place % height), axis=1)
        column += -(-len(group) // height)
    return Geometry(cell=cell, x_label="fail, dead by steps to failure, at risk, safe", y_label="")


def _states(model: SafeMDP, labelling: Labelling, certificate: Certificate) -> dict[str, Any]:
    """Labels, transitions, names and witnesses."""
    transitions = model.transitions()
    time = np.where(labelling.survival_time == INFINITE, -1, labelling.survival_time)
    return {
        "digest": certificate.digest,
        "counts": {label.name: labelling.count(label) for label in Label},
        "horizon": labelling.horizon,
        "boundaryHorizon": labelling.boundary_horizon,
        "numStates": model.num_states,
        "numActions": model.num_actions,
        "labels": labelling.labels.tolist(),
        "time": time.tolist(),
        "rank": certificate.rank.tolist(),
        "escape": certificate.escape.tolist(),
        "action": certificate.action.tolist(),
        "terminal": np.flatnonzero(model.terminal).tolist(),
        "start": np.asarray(transitions.indptr).tolist(),
        "successors": np.asarray(transitions.indices).tolist(),
        "probabilities": None if model.is_deterministic else _packed(transitions.data),
        "stateNames": model.state_names,
        "actionNames": model.action_names,
    }


def _picture(model: SafeMDP, labelling: Labelling) -> dict[str, Any]:
    geometry = model.geometry or layout_by_survival_time(labelling)
    return {
        "cells": geometry.cell.tolist(),
        "walls": geometry.walls,
        "xLabel": geometry.x_label,
        "yLabel": geometry.y_label,
        "origin": geometry.origin,
        "step": geometry.step,
        "yDown": geometry.y_down,
        "hasAxes": model.geometry is not None,
        "colors": [COLORS[label] for label in Label],
        "wall": WALL,
        "blocked": BLOCKED,
        "letThrough": LET_THROUGH,
    }


def _upper(interval: ThresholdInterval) -> float | None:
    """The largest exact threshold; None if there is none, no bound, or no float so small."""
    upper = interval.upper
    return None if not upper or np.isinf(float(upper)) else float(upper)


def _critic(name: str, critics: Sequence[Values]) -> dict[str, Any]:
    """V for each gamma, as the distinct rows over the grid and each state's row."""
    rows, index = np.unique(
        np.stack([values.V for values in critics], axis=1), axis=0, return_inverse=True
    )
    return {"name": name, "values": _packed(rows), "index": index.ravel().tolist()}


def _packed(numbers: NDArray[np.float64]) -> str:
    return base64.b64encode(np.ascontiguousarray(numbers, dtype="<f8").tobytes()).decode()
