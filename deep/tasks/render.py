"""A task's state as a picture: obstacles, goal, and the agent as a dot; numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dead_ends.draw.palette import AGENT, FAIL, FLOOR, GOAL, OTHER, rgb
from deep.tasks.shapes import Disc, inside_any
from deep.tasks.task import Floats, Task

__all__ = ["draw"]

LONG_SIDE = 400
DOT = 6


def draw(task: Task, state: Floats) -> NDArray[np.uint8]:
    """uint8 (height, width, 3): states (n, state dim) as dots in the first one's scene; y up."""
    points = _pixel_positions(task)
    image = np.empty((*points.shape[:2], 3), dtype=np.uint8)
    image[:] = rgb(FLOOR)
    scene = task.scene(state[0])
    image[inside_any(scene.goals, points)] = rgb(GOAL)
    image[inside_any(scene.obstacles, points)] = rgb(FAIL)
    image[inside_any(scene.others, points)] = rgb(OTHER)
    radius = DOT * (task.view[1] - task.view[0]) / points.shape[1]
    dots = tuple(Disc(x, y, radius) for x, y in task.position(state))
    image[inside_any(dots, points)] = rgb(AGENT)
    return image


def _pixel_positions(task: Task) -> Floats:
    """float (height, width, 2): the plane's point at the centre of each pixel."""
    left, right, bottom, top = task.view
    width, height = right - left, top - bottom
    scale = LONG_SIDE / max(width, height)
    columns, rows = max(round(width * scale), 1), max(round(height * scale), 1)
    x = left + (np.arange(columns) + 0.5) * width / columns
    y = top - (np.arange(rows) + 0.5) * height / rows
    return np.stack(np.meshgrid(x, y), axis=-1)
