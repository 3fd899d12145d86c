"""Behavior correction on a real environment, from a table.

    a_executed = a_task           if the table allows a_task in the present state,
                 recovery(state)  otherwise                       (the paper's correction)

as a Gymnasium wrapper around any environment whose observations and actions are Discrete and
numbered as in the table:

    env = TabularCorrection(gymnasium.make("FrozenLake-v1"), load_filter("lake.npz"))

Needs gymnasium, the extra ``gym``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from dead_ends.io.filter_table import FilterTable

__all__ = ["TabularCorrection"]


class TabularCorrection(gymnasium.Wrapper[int, int, int, int]):
    """Replaces each action that a table blocks by the table's recovery action.

    ``info`` of a step says ``intervened`` (bool), ``task_action``, ``executed_action`` and
    ``interventions`` (how many steps of this episode so far).

    Attributes:
        table: the allowed actions and the recovery policy.
        steps, interventions: counts over all episodes.

    Raises:
        ValueError: if the environment's spaces are not those of the table.
    """

    def __init__(self, env: gymnasium.Env[int, int], table: FilterTable) -> None:
        super().__init__(env)
        _check_space("observations", env.observation_space, table.allowed.shape[0])
        _check_space("actions", env.action_space, table.allowed.shape[1])
        self.table = table
        self.steps = 0
        self.interventions = 0
        self._in_episode = 0
        self._state: int | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Start an episode; its count of interventions is 0 again."""
        self._state, info = self.env.reset(seed=seed, options=options)
        self._in_episode = 0
        return self._state, info

    def step(self, action: int) -> tuple[int, Any, bool, bool, dict[str, Any]]:
        """Execute the action if it is allowed, else the recovery action."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        intervened = not self.table.allowed[self._state, action]
        executed = int(self.table.recovery[self._state]) if intervened else int(action)
        self.steps += 1
        self.interventions += intervened
        self._in_episode += intervened
        self._state, reward, terminated, truncated, info = self.env.step(executed)
        info |= {
            "intervened": intervened,
            "task_action": int(action),
            "executed_action": executed,
            "interventions": self._in_episode,
        }
        return self._state, reward, terminated, truncated, info


def _check_space(what: str, space: spaces.Space[Any], count: int) -> None:
    if not isinstance(space, spaces.Discrete):
        raise ValueError(f"the environment's {what} must be Discrete, not {space}")
    if space.start != 0 or space.n != np.int64(count):
        raise ValueError(f"the environment's {what} are {space}, but the table has {count}")
