"""Behavior correction on a real environment, from a table.

    a_executed = a_task           if the table allows a_task in the present state,
                 recovery(state)  otherwise                       (the paper's correction)

as a Gymnasium wrapper around any environment with Discrete actions whose present state can be
told: by its Discrete observation,

    env = TabularCorrection(gymnasium.make("FrozenLake-v1"), load_filter("lake.npz"))

or by the key with which the environment was explored,

    env = TabularCorrection(gymnasium.make("MiniGrid-LavaGapS5-v0"), table, key=minigrid_key)

An environment in a state that the table does not have, such as that of another layout, is an
error; so is one with another transition table than the filter was made from. Where a reset
draws the layout, give in place of the table a function that makes it: it is called after each
reset that leads to such a layout.

Needs gymnasium, the extra ``gym``.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from dead_ends.io.environment_model import canonical_key, key_text, short
from dead_ends.io.gymnasium_table import table_digest, transition_table
from dead_ends.io.trial import discrete_range
from dead_ends.safety.correction import corrected_actions
from dead_ends.safety.filter_table import FilterTable, load_filter

__all__ = ["TabularCorrection"]

Env = gymnasium.Env[Any, int]

OTHER_TABLE = (
    "the filter was made from another transition table than the environment's, of another layout "
    "or with other arguments"
)


class TabularCorrection(gymnasium.Wrapper[Any, int, Any, int], RecordConstructorArgs):
    """Replaces each action that a table blocks by the table's recovery action.

    The environment's actions k to k + n - 1 are the table's 0 to n - 1. ``info`` says
    ``intervened`` (bool), ``task_action`` and ``executed_action`` (as the environment counts) and
    ``interventions`` (how many steps of this episode so far). After a reset, when there was no
    action, it says so by k - 1. ``env.spec`` makes the wrapper again.

    Args:
        env: the environment.
        table: a filter; a file that :func:`dead_ends.load_filter` reads (then ``env.spec`` can
            be written as JSON); or a function that makes a filter from the environment after its
            reset, such as ``lambda env: safety_filter(explore_minigrid(env, seed=None))``.
        key: from the unwrapped environment to the key of its state; None: its observation.

    Attributes:
        table: the filter in use; None until the first reset makes it.
        steps, interventions: counts over all episodes.

    Raises:
        ValueError: if the environment's spaces are not those of the table.
    """

    def __init__(
        self,
        env: Env,
        table: FilterTable | str | os.PathLike[str] | Callable[[Env], FilterTable],
        key: Callable[[Any], Any] | None = None,
    ) -> None:
        # Recorded as they are: tables are not written to, and functions cannot be copied.
        RecordConstructorArgs.__init__(self, table=table, key=key, _disable_deepcopy=True)
        super().__init__(env)
        self.actions = discrete_range(env.action_space, "actions")
        self.key = key
        self.table: FilterTable | None = None
        self._read: tuple[Any, str | None] | None = None
        self._make = table if callable(table) else None
        if isinstance(table, FilterTable):
            self._use(table)
        elif isinstance(table, str | os.PathLike):
            self._use(load_filter(table))
        elif not callable(table):
            self._use(table)
        elif key is None and transition_table(env) is None:
            raise ValueError("a table that is made at resets needs a key to tell layouts apart")
        self.steps = 0
        self.interventions = 0
        self._in_episode = 0
        self._state: int | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode; its count of interventions is 0 again.

        Raises:
            ValueError: if the table does not have the state in which the episode starts, or is of
                another layout.
        """
        self._state = None
        observation, info = self.env.reset(seed=seed, options=options)
        stale = self.table is None or not self._fits(self.table)
        if self._make is not None and (stale or self._find(observation) is None):
            self._use(self._make(self.env))
        elif stale:
            raise ValueError(OTHER_TABLE)
        self._state = self._state_of(observation)
        self._in_episode = 0
        none = self.actions.start - 1
        return observation, self._info(info, False, none, none)

    def step(self, action: int) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Execute the action if it is allowed, else the recovery action.

        Raises:
            ValueError: for an action that the environment does not have; if the environment
                comes into a state that the table does not have.
        """
        if self._state is None or self.table is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        task = self._checked(action)
        proposed = task - self.actions.start
        intervened = not self.table.allowed[self._state, proposed]
        passes, recovery = self.table.allowed, self.table.recovery
        executed = int(corrected_actions(passes, recovery, self._state, proposed))
        executed += self.actions.start
        self.steps += 1
        self.interventions += intervened
        self._in_episode += intervened
        self._state = None
        observation, reward, terminated, truncated, info = self.env.step(executed)
        if not terminated:
            self._state = self._state_of(observation)
        info = self._info(info, intervened, task, executed)
        return observation, reward, terminated, truncated, info

    def _info(
        self, info: dict[str, Any], intervened: bool, task: int, executed: int
    ) -> dict[str, Any]:
        return info | {
            "intervened": intervened,
            "task_action": task,
            "executed_action": executed,
            "interventions": self._in_episode,
        }

    def _checked(self, action: Any) -> int:
        try:
            number = operator.index(action)
        except TypeError:
            number = self.actions.stop
        if number not in self.actions:
            raise ValueError(
                f"the task action {action!r} is none of the environment's actions, "
                f"{self.actions[0]} to {self.actions[-1]}"
            )
        return number

    def _use(self, table: FilterTable) -> None:
        """Take the table, if it is one of this environment."""
        if not isinstance(table, FilterTable):
            raise ValueError(
                f"a filter is needed, as safety_filter makes of a model, not {type(table).__name__}"
            )
        num_states, num_actions = table.allowed.shape
        if num_actions != len(self.actions):
            raise ValueError(
                f"the environment's actions are {self.action_space}, "
                f"but the table has {num_actions}"
            )
        if self.key is None:
            self._check_observations(table, num_states)
        elif table.keys is None:
            raise ValueError("the table has no keys: make it of what explore returns")
        if table.keys is not None:
            self._check_wrappers()
        if not self._fits(table):
            raise ValueError(OTHER_TABLE)
        self.table = table

    def _check_wrappers(self) -> None:
        """A table with keys is that of the unwrapped environment, whose actions these must be."""
        env: Any = self.env
        while isinstance(env, gymnasium.Wrapper):
            other = isinstance(env, gymnasium.ObservationWrapper) and self.key is None
            if other or isinstance(env, gymnasium.ActionWrapper):
                raise ValueError(
                    f"{type(env).__name__} changes what the table was made for: put it around "
                    "TabularCorrection, not beneath it"
                )
            env = env.env

    def _fits(self, table: FilterTable) -> bool:
        """Whether the environment's P, if the filter was made from one, is the same."""
        made_from = table.metadata.get("table")
        return made_from is None or made_from == self._digest()

    def _digest(self) -> str | None:
        """Of the environment's table, which is read again only if it was replaced."""
        present = transition_table(self.env)
        if self._read is None or self._read[0] is not present:
            self._read = (present, table_digest(self.env))
        return self._read[1]

    def _check_observations(self, table: FilterTable, num_states: int) -> None:
        space = self.observation_space
        numbers = discrete_range(space, "observations")
        known = num_states if table.keys is None else len(table.keys)
        if known != len(numbers):
            raise ValueError(
                f"the environment's observations are {space}, but the table has {known}"
            )
        if table.keys is not None and set(table.keys) != {key_text(number) for number in numbers}:
            raise ValueError(
                f"the keys of the table are not the environment's observations, {space}"
            )

    def _find(self, observation: Any) -> int | None:
        """The table's number of the present state, if it has it."""
        if self.table is None:
            return None
        if self.key is not None:
            return self.table.find(self.key(self.env.unwrapped))
        if self.table.keys is not None:
            return self.table.find(int(observation))
        return int(observation) - discrete_range(self.observation_space, "observations").start

    def _state_of(self, observation: Any) -> int:
        state = self._find(observation)
        if state is None:
            assert self.table is not None
            place = observation if self.key is None else self.key(self.env.unwrapped)
            made = self.table.metadata
            of = f" ({made['model']}, seed {made.get('seed')})" if "model" in made else ""
            raise ValueError(
                f"the environment is in a state that the table{of} does not have, with the key "
                f"{short(canonical_key(place))}: its layout or its start is another"
            )
        return state
