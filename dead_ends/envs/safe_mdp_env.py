"""A safe MDP as a Gymnasium environment: what is stepped is the model itself.

An episode terminates on entering a fail state, with cost 1, or a terminal one. As in
Gymnasium's toy text environments, ``unwrapped.P[s][a]`` lists (probability, next state,
reward, terminated), and ``info["action_mask"]`` marks the actions that can be taken.

Needs gymnasium, the extra ``gym``.
"""

from __future__ import annotations

import operator
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from dead_ends.draw.palette import AGENT, FAIL, FLOOR, GOAL, WALL, rgb
from dead_ends.model.safe_mdp import Geometry, SafeMDP, require_type

__all__ = ["SafeMDPEnv"]

PICTURE_SIZE = 480
"""About how many pixels wide or high a picture is."""

Outcome = tuple[float, int, float, bool]


class SafeMDPEnv(gymnasium.Env[int, int]):
    """Steps a model that has initial states.

    Observations and actions are the model's state and action numbers; the reward is
    r(s, a), 0 for a model without rewards. ``info`` holds ``cost`` (1.0 on entering fail,
    else 0.0), ``violation`` (the same as a bool) and ``action_mask`` (int8 (A,)).
    ``reset(options={"state": s})`` starts in state s.

    Args:
        model: a model with initial states.
        render_mode: "rgb_array" (needs a geometry), "ansi" or None.
        colors: uint8 (S, 3), the ground in each state's cell; None: all alike.

    Attributes:
        model: the model.
        state: the present state.

    Raises:
        ValueError: if the model has no initial states, or no geometry to draw.
    """

    metadata = {"render_modes": ["rgb_array", "ansi"], "render_fps": 8}  # noqa: RUF012  (Gymnasium's own declaration)

    def __init__(
        self,
        model: SafeMDP,
        render_mode: str | None = None,
        colors: NDArray[np.uint8] | None = None,
    ) -> None:
        require_type(model, SafeMDP, "SafeMDPEnv")
        if model.initial is None:
            raise ValueError("the model has no initial states to start an episode in")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"unknown render mode {render_mode!r}; known are rgb_array and ansi")
        if render_mode == "rgb_array" and model.geometry is None:
            raise ValueError("the model has no geometry to draw; render it as ansi")
        self.model = model
        self.render_mode = render_mode
        floor = np.full((model.num_states, 3), rgb(FLOOR), dtype=np.uint8)
        self._ground = floor if colors is None else colors
        self.observation_space: spaces.Space[Any] = spaces.Discrete(model.num_states)
        self.action_space: spaces.Space[Any] = spaces.Discrete(model.num_actions)
        self.state = int(np.flatnonzero(model.initial)[0])
        self._starts = np.flatnonzero(model.initial)
        self._start_bounds = np.cumsum(model.initial[self._starts])
        self._matrix = model.transitions()
        self._mask = model.available.astype(np.int8)
        self._ended = model.fail | model.terminal

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Draw the first state, or take the one in ``options["state"]``."""
        super().reset(seed=seed)
        if options and "state" in options:
            self.state = _number(options["state"], self.model.num_states, "reset: state")
        else:
            self.state = int(self._starts[self._draw(self._start_bounds)])
        return self.state, self._info(False)

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """One transition of the model.

        Raises:
            ValueError: if there is no such action, or it is not available in the present state.
        """
        before = self.state
        action = _number(action, self.model.num_actions, "action")
        if not self._mask[before, action]:
            name = self.model.action_name(action)
            raise ValueError(f"{self.model.state_name(before)}: {name} is not available")
        start, stop = self._row(before, action)
        chosen = 0
        if stop - start > 1:
            chosen = self._draw(np.cumsum(self._matrix.data[start:stop]))
        self.state = int(self._matrix.indices[start + chosen])
        violation = bool(self.model.fail[self.state])
        terminated = bool(self._ended[self.state])
        return self.state, self._reward(before, action), terminated, False, self._info(violation)

    @cached_property
    def P(self) -> dict[int, dict[int, list[Outcome]]]:
        """P[s][a]: the outcomes of each available action; ended states stay, at reward 0."""
        return {
            state: {
                action: self._outcomes(state, action)
                for action in range(self.model.num_actions)
                if self._ended[state] or self._mask[state, action]
            }
            for state in range(self.model.num_states)
        }

    def render(self) -> NDArray[np.uint8] | str | None:
        """The picture (rgb_array) or the name (ansi) of the present state."""
        if self.render_mode == "rgb_array":
            assert self.model.geometry is not None
            return self._picture(self.model.geometry)
        return self.model.state_name(self.state) if self.render_mode == "ansi" else None

    def _draw(self, bounds: NDArray[np.float64]) -> int:
        """An index with the probabilities whose running sums are ``bounds``."""
        position = self.np_random.random() * bounds[-1]
        return int(np.searchsorted(bounds, position, side="right"))

    def _row(self, state: int, action: int) -> tuple[int, int]:
        row = state * self.model.num_actions + action
        return int(self._matrix.indptr[row]), int(self._matrix.indptr[row + 1])

    def _reward(self, state: int, action: int) -> float:
        return 0.0 if self.model.rewards is None else float(self.model.rewards[state, action])

    def _info(self, violation: bool) -> dict[str, Any]:
        return {
            "cost": float(violation),
            "violation": violation,
            "action_mask": self._mask[self.state].copy(),
        }

    def _outcomes(self, state: int, action: int) -> list[Outcome]:
        if self._ended[state]:
            return [(1.0, state, 0.0, True)]
        reward = self._reward(state, action)
        return [
            (
                float(self._matrix.data[entry]),
                int(self._matrix.indices[entry]),
                reward,
                bool(self._ended[self._matrix.indices[entry]]),
            )
            for entry in range(*self._row(state, action))
        ]

    def _picture(self, geometry: Geometry) -> NDArray[np.uint8]:
        """Each cell as a square: floor, walls, fail, goals, and the agent over them."""
        walls = np.array(geometry.walls, dtype=np.int32).reshape(-1, 2)
        columns, rows = np.concatenate((geometry.cell, walls)).max(axis=0) + 1
        image = np.full((rows, columns, 3), 255, dtype=np.uint8)
        drawn = geometry.cell[:, 0] >= 0
        column, row = geometry.cell[drawn].T
        image[row, column] = self._colors()[drawn]
        image[walls[:, 1], walls[:, 0]] = rgb(WALL)
        if not geometry.y_down:
            image = image[::-1]
        pixels = max(1, PICTURE_SIZE // max(rows, columns))
        return image.repeat(pixels, axis=0).repeat(pixels, axis=1)

    def _colors(self) -> NDArray[np.uint8]:
        """(S, 3), the color of each state's cell."""
        colors = self._ground.copy()
        colors[self.model.fail] = rgb(FAIL)
        colors[self.model.terminal] = rgb(GOAL)
        colors[self.state] = rgb(AGENT)
        return colors


def _number(value: Any, count: int, what: str) -> int:
    """A number from 0 to count - 1, or a sentence that says what else it is."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < count:
        raise ValueError(f"{what} {value!r} is not one of 0 to {count - 1}")
    return number
