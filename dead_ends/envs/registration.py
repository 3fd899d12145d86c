"""Gymnasium environments whose dead-ends are known exactly.

    import gymnasium
    import dead_ends.envs.registration  # registers them, as Gymnasium's packages do

    env = gymnasium.make("dead_ends/Brake-v0")  # and "dead_ends/IceGrid-v0"

or without the import, ``gymnasium.make("dead_ends.envs.registration:dead_ends/Brake-v0")``.
FrozenLake, CliffWalking and MiniGrid's lava maps have no dead-ends; these two do.

Needs gymnasium, the extra ``gym``.
"""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium
import numpy as np

from dead_ends.draw.palette import CURRENT, FLOOR, ICE, rgb
from dead_ends.envs.brake import BrakeLattice, brake
from dead_ends.envs.gridworld import CURRENTS, DEFAULT_MAP, gridworld, parse_map
from dead_ends.envs.safe_mdp_env import SafeMDPEnv

__all__ = ["BRAKE_LATTICE", "brake_env", "ice_grid_env"]

BRAKE_LATTICE = BrakeLattice(
    max_distance=60,
    max_speed=8,
    max_braking=2,
    max_acceleration=2,
    obstacle_depth=4,
    distance_step=0.5,
    time_step=0.5,
)
"""30 m and 8 m/s: small enough for a table, H = 3."""


def brake_env(lattice: BrakeLattice = BRAKE_LATTICE, render_mode: str | None = None) -> SafeMDPEnv:
    """``dead_ends/Brake-v0``: the braking car of :mod:`dead_ends.envs.brake`."""
    return SafeMDPEnv(brake(lattice), render_mode)


def ice_grid_env(
    text: str | Sequence[str] = DEFAULT_MAP, slip: float = 0.0, render_mode: str | None = None
) -> SafeMDPEnv:
    """``dead_ends/IceGrid-v0``: ice and currents, see :mod:`dead_ends.envs.gridworld`."""
    color = dict.fromkeys(CURRENTS, CURRENT) | {"~": ICE}
    ground = [rgb(color.get(symbol, FLOOR)) for symbol in parse_map(text).values() if symbol != "#"]
    return SafeMDPEnv(gridworld(text, slip), render_mode, np.array(ground, dtype=np.uint8))


for name, builder in (("Brake", "brake_env"), ("IceGrid", "ice_grid_env")):
    gymnasium.register(
        id=f"dead_ends/{name}-v0",
        entry_point=f"{__name__}:{builder}",
        max_episode_steps=100,
    )
