"""The cells of a model's geometry: their colors, their places, the outlines of sets."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dead_ends.draw import palette
from dead_ends.labels.labelling import Label
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = [
    "COLORS",
    "MAX_NUMBERED_CELLS",
    "coordinates",
    "draw_labels",
    "drawn_states",
    "extent_cells",
    "geometry_of",
    "outline",
]

COLORS = {
    Label.FAIL: palette.FAIL,
    Label.DEAD: palette.DEAD,
    Label.SAFE: palette.SAFE,
    Label.AT_RISK: palette.AT_RISK,
}
"""The color of each label."""
MAX_NUMBERED_CELLS = 400


def draw_labels(axes: Axes, geometry: Geometry, labels: NDArray[np.uint8]) -> None:
    """The label of each cell as its colour; walls grey; axes with units."""
    columns, rows = extent_cells(geometry)
    raster = np.full((rows, columns), -1)
    drawn = drawn_states(geometry)
    column, row = geometry.cell[drawn].T
    _refuse_shared_cells(geometry, drawn)
    raster[row, column] = labels[drawn]
    for wall_column, wall_row in geometry.walls:
        raster[wall_row, wall_column] = len(Label)
    (x0, y0), (dx, dy) = geometry.origin, geometry.step
    axes.imshow(
        np.ma.masked_less(raster, 0),
        cmap=ListedColormap([*(COLORS[label] for label in Label), palette.WALL]),
        vmin=-0.5,
        vmax=len(Label) + 0.5,
        origin="lower",
        extent=(x0 - dx / 2, x0 + (columns - 0.5) * dx, y0 - dy / 2, y0 + (rows - 0.5) * dy),
        aspect="equal" if geometry.y_down else "auto",
        interpolation="nearest",
    )
    if geometry.y_down:
        axes.invert_yaxis()
    if geometry.step == (1.0, 1.0):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    if columns * rows <= MAX_NUMBERED_CELLS:
        _draw_grid(axes, geometry, columns, rows)
    axes.set_xlabel(geometry.x_label)
    axes.set_ylabel(geometry.y_label)


def geometry_of(model: SafeMDP) -> Geometry:
    if model.geometry is None:
        raise ValueError("the model has no geometry, so its states have no place in a picture")
    return model.geometry


def drawn_states(geometry: Geometry) -> NDArray[np.bool_]:
    """bool (S,): the states that have a place in the picture."""
    return np.asarray((geometry.cell >= 0).all(axis=1))


def extent_cells(geometry: Geometry) -> tuple[int, int]:
    cells = np.concatenate((geometry.cell, np.array(geometry.walls, dtype=np.int32).reshape(-1, 2)))
    columns, rows = (int(size) + 1 for size in cells.max(axis=0))
    return columns, rows


def _refuse_shared_cells(geometry: Geometry, drawn: NDArray[np.bool_]) -> None:
    order = np.lexsort(geometry.cell[drawn].T)
    ordered = geometry.cell[drawn][order]
    shared = np.flatnonzero((ordered[1:] == ordered[:-1]).all(axis=1))
    if len(shared):
        states = np.flatnonzero(drawn)[order[shared[0] : shared[0] + 2]]
        raise ValueError(f"geometry: states {states.min()} and {states.max()} share a cell")


def coordinates(geometry: Geometry, states: NDArray[np.int_]) -> NDArray[np.float64]:
    cells = geometry.cell[states].astype(np.float64)
    return np.asarray(cells * geometry.step + geometry.origin)


def _draw_grid(axes: Axes, geometry: Geometry, columns: int, rows: int) -> None:
    (x0, y0), (dx, dy) = geometry.origin, geometry.step
    axes.set_xticks(x0 + dx * (np.arange(columns + 1) - 0.5), minor=True)
    axes.set_yticks(y0 + dy * (np.arange(rows + 1) - 0.5), minor=True)
    axes.grid(which="minor", color="white", linewidth=1.0)
    axes.tick_params(which="minor", length=0)


def outline(geometry: Geometry, inside: NDArray[np.bool_]) -> list[Any]:
    """The edges between drawn cells inside and outside a set, as segments."""
    columns, rows = extent_cells(geometry)
    raster = np.full((rows, columns), -1)
    drawn = drawn_states(geometry)
    column, row = geometry.cell[drawn].T
    raster[row, column] = inside[drawn]
    (x0, y0), (dx, dy) = geometry.origin, geometry.step
    segments = []
    for r, c in np.argwhere(_differs(raster[:, 1:], raster[:, :-1])):
        x = x0 + (c + 0.5) * dx
        segments.append([(x, y0 + (r - 0.5) * dy), (x, y0 + (r + 0.5) * dy)])
    for r, c in np.argwhere(_differs(raster[1:], raster[:-1])):
        y = y0 + (r + 0.5) * dy
        segments.append([(x0 + (c - 0.5) * dx, y), (x0 + (c + 0.5) * dx, y)])
    return _join(segments)


def _differs(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((one != other) & (one >= 0) & (other >= 0))


def _join(segments: list[Any]) -> list[Any]:
    """Chains of segments that touch, so that a dashed line stays dashed round a corner."""
    ends: dict[tuple[float, float], list[int]] = {}
    for index, segment in enumerate(segments):
        for x, y in segment:
            ends.setdefault((round(x, 9), round(y, 9)), []).append(index)
    unused = set(range(len(segments)))
    chains = []
    # Chains are begun at loose ends; what is left then are closed loops.
    starts = [i for touching in ends.values() if len(touching) != 2 for i in touching]
    for first in [*starts, *range(len(segments))]:
        if first not in unused:
            continue
        unused.discard(first)
        chain = [(round(x, 9), round(y, 9)) for x, y in segments[first]]
        if len(ends[chain[-1]]) != 2:
            chain.reverse()
        while True:
            following = [i for i in ends[chain[-1]] if i in unused]
            if not following:
                break
            unused.discard(following[0])
            one, two = [(round(x, 9), round(y, 9)) for x, y in segments[following[0]]]
            chain.append(two if one == chain[-1] else one)
        chains.append(chain)
    return chains
