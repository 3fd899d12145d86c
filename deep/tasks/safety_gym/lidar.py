"""Safety Gym's lidar: how near objects are, in 16 sectors around the robot.

An object at distance d in sector b, a share f of the sector's width past its beginning, has
the reading v = max(0, 3 - d) / 3. Sector b shows v, sector b + 1 shows f v and sector b - 1
shows (1 - f) v; each sector shows the largest reading of all objects.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["BINS", "MAX_DISTANCE", "add_lidar"]

BINS = 16
MAX_DISTANCE = 3.0


@njit(cache=True)
def add_lidar(x: float, y: float, cosine: float, sine: float, lidar: NDArray[np.float32]) -> None:
    """Enter an object at (x, y) from the robot, whose heading is given, into (16,)."""
    distance = np.hypot(x, y)
    reading = max(0.0, MAX_DISTANCE - distance) / MAX_DISTANCE
    angle = np.arctan2(cosine * y - sine * x, cosine * x + sine * y) % (2 * np.pi)
    position = angle * (BINS / (2 * np.pi))
    sector = int(position) % BINS
    share = position - int(position)
    after, before = (sector + 1) % BINS, (sector - 1) % BINS
    lidar[sector] = max(lidar[sector], np.float32(reading))
    lidar[after] = max(lidar[after], np.float32(share * reading))
    lidar[before] = max(lidar[before], np.float32((1 - share) * reading))
