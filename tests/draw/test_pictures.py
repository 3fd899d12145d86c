"""Pictures show what the results say, cell by cell."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from dead_ends import SafeMDP, classify
from dead_ends.draw.animation import Episode, animate_episodes
from dead_ends.draw.pictures import Blocked, Boundary, plot_boundaries, plot_map
from dead_ends.envs.brake import BrakeLattice, brake
from dead_ends.labels.labelling import Label
from dead_ends.model.safe_mdp import Geometry


def row_of_cells(cells: list[tuple[int, int]] | None = None) -> SafeMDP:
    """Three states: safe, dead, fail; drawn from left to right."""
    geometry = Geometry(
        cell=np.array(cells or [(0, 0), (1, 0), (2, 0)]),
        walls=((3, 0),),
        arrows=((-1.0, 0.0), (1.0, 0.0)),
        y_down=True,
    )
    table = np.array([[0, 1], [2, 2], [2, 2]])
    return SafeMDP.deterministic(table, np.array([False, False, True]), geometry=geometry)


def test_each_cell_has_the_color_of_its_label() -> None:
    model = row_of_cells()
    figure = plot_map(model, classify(model), title="three cells")
    (image,) = figure.axes[0].get_images()
    wall = len(Label)
    assert image.get_array().tolist() == [[Label.SAFE, Label.DEAD, Label.FAIL, wall]]


def test_dead_cells_carry_their_survival_time() -> None:
    model = row_of_cells()
    axes = plot_map(model, classify(model)).axes[0]
    assert [(text.get_text(), text.get_position()) for text in axes.texts] == [("1", (1.0, 0.0))]


def test_an_arrow_for_each_safe_action_of_a_safe_state() -> None:
    model = row_of_cells()
    actions = np.array([[True, False], [True, True], [False, False]])
    axes = plot_map(model, classify(model), actions=actions).axes[0]
    arrows = [c for c in axes.collections if type(c).__name__ == "Quiver"]
    assert [(arrow.N, np.sign(arrow.U).tolist()) for arrow in arrows] == [(1, [-1]), (0, [])]


def test_goals_and_starts_are_marked_and_goals_have_no_arrows() -> None:
    geometry = Geometry(cell=np.array([(0, 0), (1, 0), (2, 0)]), arrows=((1.0, 0.0),))
    model = SafeMDP.deterministic(
        [[2], [0], [2]],
        np.array([False, True, False]),
        terminal=np.array([False, False, True]),
        initial=0,
        geometry=geometry,
    )
    figure = plot_map(model, classify(model), actions=model.available)
    axes = figure.axes[0]
    marks = {text.get_text(): text.get_position() for text in axes.texts}
    assert marks["S"] == pytest.approx((-0.36, 0.34))  # the corner leaves room for arrows
    assert marks["G"] == (2.0, 0.0)
    arrows = [c for c in axes.collections if type(c).__name__ == "Quiver"]
    assert [arrow.N for arrow in arrows] == [1]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "start" in names
    assert "goal: the episode ends" in names


def test_y_upward_puts_row_0_at_the_bottom() -> None:
    lattice = BrakeLattice(max_distance=4, max_speed=2, obstacle_depth=1)
    model = brake(lattice)
    figure = plot_map(model, classify(model))
    assert not figure.axes[0].yaxis_inverted()
    (image,) = figure.axes[0].get_images()
    expected = classify(model).labels.reshape(lattice.shape).T
    assert np.array_equal(image.get_array(), expected)


@pytest.mark.parametrize("seed", range(5))
def test_the_outline_is_every_edge_between_inside_and_outside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, rows = 7, 5
    cell = np.array([(c, r) for r in range(rows) for c in range(columns)])
    inside = rng.random(len(cell)) < 0.5
    table = np.zeros((len(cell), 1), dtype=np.int32)
    model = SafeMDP.deterministic(
        table, np.zeros(len(cell), dtype=bool), geometry=Geometry(cell=cell)
    )
    axes = plot_boundaries(model, classify(model), [Boundary("random", inside)]).axes[0]
    (lines,) = [c for c in axes.collections if type(c).__name__ == "LineCollection"]
    drawn = set()
    for chain in lines.get_segments():
        for (x0, y0), (x1, y1) in pairwise(chain):
            edge = tuple(sorted([(x0, y0), (x1, y1)]))
            assert edge not in drawn
            drawn.add(edge)
    raster = inside.reshape(rows, columns)
    expected = {
        ((c + 0.5, r - 0.5), (c + 0.5, r + 0.5))
        for r in range(rows)
        for c in range(columns - 1)
        if raster[r, c] != raster[r, c + 1]
    } | {
        ((c - 0.5, r + 0.5), (c + 0.5, r + 0.5))
        for r in range(rows - 1)
        for c in range(columns)
        if raster[r, c] != raster[r + 1, c]
    }
    assert drawn == expected


def test_blocked_shares_are_drawn_in_percent() -> None:
    model = row_of_cells()
    labelling = classify(model)
    figure = plot_boundaries(
        model,
        labelling,
        [Boundary("best", ~labelling.safe)],
        blocked=[Blocked("best", (0.0, 0.25)), Blocked("random", (0.5, 1.0))],
        thresholds=["low", "high"],
    )
    series = {line.get_label(): list(line.get_xdata()) for line in figure.axes[1].lines}
    assert series == {"low": [0.0, 50.0], "high": [25.0, 100.0]}


def test_an_animation_has_a_frame_a_step_and_only_the_agent_moves() -> None:
    model = row_of_cells()
    alone = Episode("alone", np.array([0, 1, 2]), np.array([False, False]))
    waits = Episode("corrected", np.array([0, 0]), np.array([True]))
    frames = [np.array(frame) for frame in animate_episodes(model, classify(model), [alone, waits])]
    assert len(frames) == 3
    half = frames[0].shape[1] // 2
    left = [frame[:, :half] for frame in frames]
    right = [frame[:, half:] for frame in frames]
    assert not np.array_equal(left[0], left[1])
    assert not np.array_equal(left[1], left[2])
    assert not np.array_equal(right[0], right[1])  # its title says that it has ended
    assert np.array_equal(right[1], right[2])


def test_a_model_without_a_geometry_is_refused() -> None:
    model = SafeMDP.deterministic([[0]], [False])
    with pytest.raises(ValueError, match="the model has no geometry"):
        plot_map(model, classify(model))


def test_two_states_in_one_cell_are_refused() -> None:
    model = row_of_cells([(0, 0), (1, 0), (0, 0)])
    with pytest.raises(ValueError, match="geometry: states 0 and 2 share a cell"):
        plot_map(model, classify(model))
