"""The smallest counterexample of a refuted claim: found, simplified, saved and drawn.

Models are searched by size, (n - 1) * m first, so the first violation is a smallest one. Among
the violating models of that size the simplest is taken: the fewest transitions that move.
"""

from __future__ import annotations

import hashlib
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch

from dead_ends.draw.geometry import COLORS
from dead_ends.draw.palette import LINES
from dead_ends.io.atomic import atomic_path
from dead_ends.io.npz import save_npz
from dead_ends.labels.labelling import Label
from dead_ends.model.safe_mdp import SafeMDP
from proofs_check.machinery.cases import FOREVER, Case, exact_table
from proofs_check.machinery.implementation import LIBRARY
from proofs_check.machinery.statement import Row

ROOT = Path(__file__).parents[1]
MODELS = ROOT / "counterexamples"
FIGURES = ROOT.parent / "figures"
ACTION_STYLES: tuple[tuple[str, Literal["-", "--", ":"]], ...] = (
    (LINES[2], "-"),
    (LINES[3], "--"),
    (LINES[4], ":"),
)
RADIUS = 0.2


def smallest(row: Row, cases: Iterable[Case]) -> Case:
    """The simplest violating model of the first case that has one.

    Raises:
        ValueError: if no model of the cases violates the claim.
    """
    for case in sorted(cases, key=size):
        violated = np.flatnonzero(row.check(LIBRARY, case).violated)
        if len(violated):
            models = [case.take(int(index)) for index in violated]
            return min(models, key=lambda single: _moves(single.model))
    raise ValueError(f"{row.name}: no counterexample among these models")


def minimal_sizes(row: Row, cases: Iterable[Case]) -> set[tuple[int, int]]:
    """The sizes (n, m) with a violation, none of which has both n and m smaller or equal."""
    broken = {
        (case.states, case.model.num_actions)
        for case in cases
        if row.check(LIBRARY, case).violated.any()
    }
    return {
        (n, m)
        for n, m in broken
        if not any((i, j) != (n, m) and i <= n and j <= m for i, j in broken)
    }


def size(case: Case) -> tuple[int, int]:
    """What makes a model small: choices to describe, then states."""
    return (case.states - 1) * case.model.num_actions, case.states


def _moves(model: SafeMDP) -> int:
    """The number of pairs s -> s' with s' != s."""
    matrix = model.transitions()
    sources = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)) // model.num_actions
    return len({(int(s), int(t)) for s, t in zip(sources, matrix.indices, strict=True) if s != t})


def named(case: Case) -> SafeMDP:
    """The model of a single case with names that say what its states are."""
    model, names = case.model, []
    for state in range(model.num_states):
        time = int(case.survival[state])
        if model.fail[state]:
            names.append("fail")
        elif case.dead[state]:
            names.append(f"dead {state}" + (f", T = {time}" if time < FOREVER else ""))
        elif case.failing[state] > 0:
            names.append(f"at risk {state}")
        else:
            names.append(f"goal {state}" if model.terminal[state] else f"safe {state}")
    actions = [f"a{action}" for action in range(model.num_actions)]
    if model.is_deterministic:
        table = np.where(model.fail[:, None], -1, model.successors())
        return SafeMDP.deterministic(table, model.fail, state_names=names, action_names=actions)
    return SafeMDP.stochastic(
        exact_table(model),
        model.fail,
        terminal=model.terminal,
        state_names=names,
        action_names=actions,
    )


def digest(model: SafeMDP) -> str:
    """A name of the model's transitions, written into its picture."""
    matrix = model.transitions()
    text = f"{matrix.indptr.tolist()} {matrix.indices.tolist()} {model.exact_probabilities()}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def paths(row: Row) -> tuple[Path, Path]:
    """The model file and the picture of a row."""
    return MODELS / f"{row.name}.npz", FIGURES / f"counterexample-{row.name}.png"


def save(row: Row, case: Case) -> None:
    """Write the model file and the picture."""
    model_path, figure_path = paths(row)
    MODELS.mkdir(exist_ok=True)
    FIGURES.mkdir(exist_ok=True)
    model = named(case)
    save_npz(model, model_path)
    with atomic_path(figure_path) as temporary:
        draw(row, case).savefig(temporary, dpi=110, metadata={"Model": digest(model)})


def draw(row: Row, case: Case) -> Figure:
    """The model as a graph: states coloured by label, one line style an action."""
    model = named(case)
    position = _positions(case)
    width = max(x for x, _ in position) + 2.0
    lowest = min(y for _, y in position)
    height = 1.5 - lowest
    claim = textwrap.wrap(f"Refuted: {row.claim}", 78)
    reason = textwrap.wrap(row.because, 84)
    text_height = 0.22 * (len(claim) + len(reason)) + 0.75
    figure = Figure(figsize=(7.2, 1.25 * height + text_height), facecolor="white")
    top = 1 - (0.22 * len(claim) + 0.1) / figure.get_figheight()
    bottom = (0.22 * len(reason) + 0.5) / figure.get_figheight()
    axes = figure.add_axes((0.02, bottom, 0.96, top - bottom))
    for state, (x, y) in enumerate(position):
        _draw_state(axes, model, case, state, x, y)
    for state, action, successor, label in _edges(model):
        _draw_edge(axes, position, state, action, successor, label)
    axes.set_xlim(-1.0, width - 1.0)
    axes.set_ylim(lowest - 0.55, 0.95)
    axes.set_aspect("equal")
    axes.axis("off")
    figure.text(0.03, 0.985, "\n".join(claim), va="top", fontsize=10.5, weight="bold")
    figure.text(0.03, 0.015, "\n".join(reason), va="bottom", fontsize=9.5)
    handles = [
        Line2D([], [], color=color, linestyle=style, label=f"action a{action}")
        for action, (color, style) in enumerate(ACTION_STYLES[: model.num_actions])
    ]
    figure.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(0.98, (0.22 * len(reason) + 0.05) / figure.get_figheight()),
        ncols=3,
        frameon=False,
        fontsize=9,
    )
    return figure


def _positions(case: Case) -> list[tuple[float, float]]:
    """Columns: safe, at risk, dead by falling T, fail; the states of a column one below another."""
    keys: list[tuple[int, int]] = []
    for state in range(case.model.num_states):
        if case.fail[state]:
            keys.append((3, 0))
        elif case.dead[state]:
            keys.append((2, -int(case.survival[state])))
        else:
            keys.append((int(case.failing[state] > 0), 0))
    columns = {key: i for i, key in enumerate(sorted(set(keys)))}
    used: dict[tuple[int, int], int] = {}
    position = []
    for key in keys:
        row = used.get(key, 0)
        used[key] = row + 1
        position.append((1.9 * columns[key] + 0.35 * (row % 2), -1.35 * row))
    return position


def _edges(model: SafeMDP) -> list[tuple[int, int, int, str]]:
    """(state, action, successor, probability unless 1)."""
    matrix, data = model.transitions(), model.exact_probabilities()
    edges = []
    for row in range(matrix.shape[0]):
        for i in range(int(matrix.indptr[row]), int(matrix.indptr[row + 1])):
            label = "" if data[i] == 1 else str(data[i])
            edges.append(
                (row // model.num_actions, row % model.num_actions, int(matrix.indices[i]), label)
            )
    return edges


def _draw_state(axes: Any, model: SafeMDP, case: Case, state: int, x: float, y: float) -> None:
    label = (
        Label.FAIL
        if case.fail[state]
        else Label.DEAD
        if case.dead[state]
        else Label.AT_RISK
        if case.failing[state] > 0
        else Label.SAFE
    )
    axes.add_patch(Circle((x, y), RADIUS, facecolor=COLORS[label], edgecolor="0.2", zorder=3))
    assert model.state_names is not None
    kind, _, rest = model.state_names[state].partition(" ")
    color = "white" if label is Label.FAIL else "black"
    axes.text(x, y, str(state), ha="center", va="center", fontsize=10, color=color, zorder=4)
    time = rest.partition(", ")[2]
    caption = f"{label.name} {time}".replace("_", " ").strip() if kind else ""
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
    axes.text(
        x, y - RADIUS - 0.07, caption, ha="center", va="top", fontsize=8, zorder=4, bbox=behind
    )


def _draw_edge(
    axes: Any,
    position: list[tuple[float, float]],
    state: int,
    action: int,
    successor: int,
    label: str,
) -> None:
    color, style = ACTION_STYLES[action]
    (x, y), (u, v) = position[state], position[successor]
    common: dict[str, Any] = {
        "arrowstyle": "-|>",
        "mutation_scale": 11,
        "color": color,
        "linestyle": style,
        "linewidth": 1.5,
        "zorder": 2,
    }
    if state == successor:  # a loop above the state, further out for later actions
        reach = 0.1 + 0.09 * action
        start, end = (x - reach, y + RADIUS * 0.9), (x + reach, y + RADIUS * 0.9)
        arc = f"arc3,rad={-1.6 - 0.2 * action}"
        axes.add_patch(FancyArrowPatch(start, end, connectionstyle=arc, **common))
        _label(axes, x, y + RADIUS + 0.25 + 0.22 * action, label, color)
        return
    bend = 0.12 + 0.16 * action
    if abs(u - x) > 2.5 and y == v:  # over the states between, not through them
        bend = -0.38 - 0.08 * action
    axes.add_patch(
        FancyArrowPatch(
            (x, y),
            (u, v),
            connectionstyle=f"arc3,rad={bend}",
            shrinkA=17,
            shrinkB=17,
            **common,
        )
    )
    # The middle of the bent arrow lies off the straight line by half of its bend.
    middle = ((x + u) / 2 + (v - y) * bend / 2, (y + v) / 2 - (u - x) * bend / 2)
    _label(axes, *middle, label, color)


def _label(axes: Any, x: float, y: float, label: str, color: str) -> None:
    """A probability beside its arrow."""
    if label:
        behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
        axes.text(x, y, label, ha="center", va="center", fontsize=9, color=color, bbox=behind)
