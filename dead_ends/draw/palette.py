"""One palette: a color means one thing in every picture, a page's and an environment's too.

Areas and marks have a meaning; lines are told apart by the picture's legend. The colors are
distinguishable with every common color blindness, neighbours in a picture also in grey (most of
them are Okabe and Ito's). The module imports nothing, so that whatever draws can use it.
"""

from __future__ import annotations

__all__ = [
    "AGENT",
    "AT_RISK",
    "BLOCKED",
    "CURRENT",
    "DEAD",
    "FAIL",
    "FLOOR",
    "GOAL",
    "ICE",
    "LET_THROUGH",
    "LINES",
    "OTHER",
    "RECOVERY",
    "SAFE",
    "UNKNOWN",
    "WALL",
    "rgb",
]

FAIL, DEAD, SAFE, AT_RISK = "#404040", "#E69F00", "#CDE6F5", "#F4EDA0"
"""What a state is."""

UNKNOWN = "#D0CBC4"
"""A state that neither bound on the dead-ends decides."""

BLOCKED, LET_THROUGH = "#0B4F8A", "#CC3311"
"""The two errors of a critic: it blocks what is safe; it lets through what is not."""

WALL = "#8C8C8C"
"""A cell in which no state is."""

FLOOR, ICE, CURRENT, GOAL, OTHER = "#EEEEE8", "#DAD4EE", "#9C92CC", "#009E73", "#B8B8B8"
"""Where labels are not shown: ground of three kinds, where to go, what does not matter."""

AGENT, RECOVERY = "#AA3377", "#FFFFFF"
"""The agent and its path; the steps in which the recovery policy acted for it."""

LINES = ("#000000", "#D55E00", "#0072B2", "#882255", "#117733")
"""Lines of a picture, told apart by its legend; the first is the one that is exact."""


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, for arrays of pixels."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue
