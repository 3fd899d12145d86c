"""Deterministic Gymnasium environments, explored breadth first.

An environment that can be copied and stepped is a graph: from each new state every action is
tried on a copy. A *key* tells states apart: a value with all that the future depends on, see
:mod:`dead_ends.io.environment_model`. Ends by a time limit are none of the task's: copies are
made of ``env.unwrapped``, so that wrappers, a TimeLimit too, do not count, and truncation is
ignored. Some hundred steps are made with the wrappers as well: one that changes where actions lead,
or when episodes end, is refused.

What is assumed is tried. Every step is made twice, with other random numbers and with the actions
in another order. Where a key is met again on another path, its successors are compared with the
first ones; so are those of some hundred random steps from the start. What has two different
outcomes is refused with both. Rare chances and rarely hidden differences may still escape.

Violations are transitions that satisfy a condition, by default none is known but for MiniGrid,
where stepping on lava ends the episode without reward. MiniGrid's lava maps have no dead-ends:
turning round is always possible and harmless.

Where ``reset`` draws a layout, the model is that of one seed. Its states are the keys of that
layout, so that a filter made from it refuses another one.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable, Hashable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.environment_model import (
    Ended,
    EnvironmentModel,
    canonical_key,
    model_of_environment,
    short,
)
from dead_ends.io.errors import located, optional_module
from dead_ends.io.gymnasium_table import environment_name
from dead_ends.io.transitions import Condition, Transitions, build_model, violations
from dead_ends.io.trial import (
    copy_of,
    copy_with_wrappers,
    discrete_range,
    global_generators_kept,
    numerals,
    take_step,
    use_randomness,
)
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["MAX_STATES", "explore", "explore_minigrid", "minigrid_key"]

MAX_STATES = 1_000_000

WALK_STEPS = 500
"""How many random steps from the start are compared with the model in the end."""

Key = Callable[[Any], Any]
Name = Callable[[Any], str]


def explore(
    env: Any,
    key: Key,
    *,
    fail_if: Condition | None = None,
    max_states: int = MAX_STATES,
    name: Name | None = None,
    progress: bool = False,
    seed: int | None = 0,
) -> EnvironmentModel:
    """The model of what can be reached from the environment's first state.

    State 0 is the first state after ``env.reset(seed=seed)``. A transition that terminates
    leads to a state of its own, which fails if all transitions into it satisfy ``fail_if``, and
    is terminal otherwise. ``model.state_of(key(env.unwrapped))`` is the number of the state that
    an environment is in. Rewards are those of the first path to a state.

    Args:
        env: a Gymnasium environment with a Discrete action space; not changed. Action i of the
            model is the space's ``start + i``.
        key: from the unwrapped environment to a value, equal for equal states.
        fail_if: a condition on (s, a, r, s') and ``done``, where a is the environment's.
        max_states: the limit.
        name: from a key, in canonical form, to the state's name.
        progress: show a progress bar on standard error (needs tqdm).
        seed: for the reset. None: no reset, the first state is the present one.

    Raises:
        ValueError: if the action space is not Discrete, there are more states than
            ``max_states``, a step or the reset has two different outcomes, one key has
            different successors, or a wrapper changes what steps do.
        MissingDependencyError: if Gymnasium is not installed, or ``progress`` and tqdm is not.
    """
    with located(environment_name(env)), global_generators_kept(), ExitStack() as stack:
        bar = stack.enter_context(_progress_bar()) if progress else None
        exploration = _Exploration(env, key, max_states, name, bar, seed)
        exploration.run()
        return exploration.model(fail_if)


def explore_minigrid(
    env: Any,
    *,
    fail_if: Condition | None = None,
    max_states: int = MAX_STATES,
    progress: bool = False,
    seed: int | None = 0,
) -> EnvironmentModel:
    """A MiniGrid environment; lava fails unless ``fail_if`` says otherwise.

    Many of its layouts are drawn at the reset: the model is that of ``seed``. Parameters and
    errors as in :func:`explore`.
    """
    return explore(
        env,
        minigrid_key,
        fail_if="done and r <= 0" if fail_if is None else fail_if,
        max_states=max_states,
        name=_minigrid_name,
        progress=progress,
        seed=seed,
    )


def minigrid_key(env: Any) -> Hashable:
    """What the future of a MiniGrid environment depends on, but for the count of steps."""
    carrying = None if env.carrying is None else env.carrying.encode()
    column, row = (int(coordinate) for coordinate in env.agent_pos)
    layout = env.grid.encode().tobytes()
    return column, row, int(env.agent_dir), carrying, layout, str(env.mission)


def _minigrid_name(key: Any) -> str:
    return f"column {key[0]}, row {key[1]}, facing {('right', 'down', 'left', 'up')[key[2]]}"


Outcome = tuple[Any, Hashable, float, bool]
"""A copy after the step, its key (``Ended`` if the episode is), the reward, whether it ended."""

Row = tuple[int, int, int, float, bool]
"""State, index of the action, successor, reward, whether the episode ended."""


class _Exploration:
    """The states and transitions found so far; see :func:`explore` for the arguments."""

    def __init__(
        self, env: Any, key: Key, max_states: int, name: Name | None, bar: Any, seed: int | None
    ) -> None:
        self.actions = discrete_range(env.action_space, "actions")
        self.env = env
        self.key = key
        self.max_states = max_states
        self.name = name
        self.bar = bar
        self.seed = seed
        self.rng = np.random.default_rng(seed)
        self.first = self._first(env)
        self.numbers: dict[Hashable, int] = {self._key(self.first): 0}
        self.rows: list[Row] = []
        self.row_of: dict[int, int] = {}
        """Where the rows of a state begin, once its actions were tried."""
        self.again: list[Row] = []
        """Transitions of states that were met again."""

    def run(self) -> None:
        """Try every action in every state, first met first tried."""
        waiting = deque([(0, self.first)])
        met: set[tuple[int, bool]] = set()
        while waiting:
            state, env = waiting.popleft()
            if state in self.row_of:
                self._compare(state, env)
                continue
            self.row_of[state] = len(self.rows)
            for index, (child, place, reward, ended) in enumerate(self._try(state, env)):
                is_new = place not in self.numbers
                target = self._number(place)
                self.rows.append((state, index, target, reward, ended))
                # A known key is compared once where it was left, and once on another path.
                path = (target, target == state)
                if not ended and (is_new or path not in met):
                    waiting.append((target, child))
                    if not is_new:
                        met.add(path)
        self._walk()
        self._walk_with_wrappers()

    def model(self, fail_if: Condition | None) -> EnvironmentModel:
        """The model of what was found."""
        transitions = self._transitions(self.rows)
        if fail_if is not None:
            violates = violations(transitions, fail_if)
            self._check_violations(violates, fail_if)
            harmless = np.zeros(len(self.numbers), dtype=np.bool_)
            harmless[transitions.target[~violates]] = True
            fails = transitions.terminal & ~harmless
            transitions = replace(transitions, fail=fails, terminal=transitions.terminal & ~fails)
        own = getattr(self.env.unwrapped, "model", None)
        estimate = isinstance(own, SafeMDP) and own.estimate
        model = replace(build_model(transitions, fail_if), estimate=estimate)
        return model_of_environment(model, self.numbers, seed=self.seed)

    def _first(self, env: Any) -> Any:
        """A copy in the first state; reset twice, if at all, while the global generators differ."""
        if self.seed is None:
            return copy_of(env)
        firsts = []
        for rng in self.rng.spawn(2):
            first = copy_of(env)
            use_randomness(first, rng)
            first.reset(seed=self.seed)
            firsts.append(first)
        if self._key(firsts[0]) != self._key(firsts[1]):
            raise ValueError(
                f"two resets with seed {self.seed} differ, so that something else draws the "
                "first state; with seed=None the present state is the first"
            )
        return firsts[0]

    def _try(self, state: int, env: Any) -> list[Outcome]:
        """What each action does, tried twice: in order, and in the reverse order."""
        forth, back = self.rng.spawn(2)
        outcomes = [self._step(env, action, forth) for action in self.actions]
        others = [self._step(env, action, back) for action in reversed(self.actions)]
        for action, one, other in zip(self.actions, outcomes, reversed(others), strict=True):
            if one[1:] != other[1:]:
                raise ValueError(
                    f"{self._said(state)}, action {action}: two tries differ; "
                    "the environment is stochastic"
                )
        return outcomes

    def _step(self, env: Any, action: int, rng: np.random.Generator) -> Outcome:
        child = copy.deepcopy(env)
        use_randomness(child, rng)
        _, reward, terminated, _ = take_step(child, action)
        return child, self._place(child, terminated), reward, terminated

    def _compare(self, state: int, env: Any) -> None:
        """Another copy with a known key: its successors are those of the first."""
        for index, action in enumerate(self.actions):
            self._check(state, index, self._step(env, action, self.rng))

    def _walk(self) -> None:
        """Random steps from the start, where the future may depend on how long ago that was."""
        env, state = copy.deepcopy(self.first), 0
        use_randomness(env, self.rng)
        for index in self.rng.integers(len(self.actions), size=WALK_STEPS).tolist():
            _, reward, terminated, truncated = take_step(env, self.actions[index])
            place = self._place(env, terminated)
            self._check(state, index, (env, place, reward, terminated))
            state = self.numbers[place]
            if terminated or truncated:
                env, state = copy.deepcopy(self.first), 0

    def _walk_with_wrappers(self) -> None:
        """Random steps of the environment as it was given: its wrappers must not change them."""
        first = copy_with_wrappers(self.env)
        if first is None:
            return
        use_randomness(first.unwrapped, self.rng)
        if self.seed is not None:
            first.reset(seed=self.seed)
        env, state = copy.deepcopy(first), self.numbers.get(self._key(first.unwrapped))
        for index in self.rng.integers(len(self.actions), size=WALK_STEPS).tolist():
            known = None if state is None else self.rows[self.row_of[state] + index][2]
            _, _, terminated, truncated = take_step(env, self.actions[index])
            place = self._place(env.unwrapped, terminated)
            if known is None or self.numbers.get(place) != known:
                raise ValueError(
                    f"with its wrapper {type(first).__name__} the environment moves otherwise "
                    "than without; a model is of env.unwrapped, and so must be what is corrected"
                )
            state = known
            if terminated or truncated:
                env, state = copy.deepcopy(first), 0

    def _check(self, state: int, index: int, outcome: Outcome) -> None:
        _, place, reward, ended = outcome
        target = self.rows[self.row_of[state] + index][2]
        if self.numbers.get(place) != target:
            raise ValueError(
                f"{self._said(state)}, action {self.actions[index]}: leads to "
                f"{self._said(target)} on one path and to {self._met(place)} on another; the "
                "key does not determine its successors, or the environment is stochastic"
            )
        self.again.append((state, index, target, reward, ended))

    def _check_violations(self, violates: NDArray[np.bool_], fail_if: Condition) -> None:
        if not self.again:
            return
        again = violations(self._transitions(self.again), fail_if)
        first = [self.row_of[state] + index for state, index, *_ in self.again]
        differ = np.flatnonzero(again != violates[first])
        if len(differ):
            state, index, *_ = self.again[differ[0]]
            raise ValueError(
                f"{self._said(state)}, action {self.actions[index]}: a violation on one path and "
                "none on another; the key does not determine what fail_if looks at"
            )

    def _key(self, env: Any) -> Hashable:
        return canonical_key(self.key(env))

    def _place(self, env: Any, terminated: bool) -> Hashable:
        return Ended(self._key(env)) if terminated else self._key(env)

    def _number(self, place: Hashable) -> int:
        if place not in self.numbers:
            if len(self.numbers) >= self.max_states:
                raise ValueError(f"more than {self.max_states} states (max_states)")
            self.numbers[place] = len(self.numbers)
            if self.bar is not None:
                self.bar.update()
        return self.numbers[place]

    def _said(self, state: int) -> str:
        return f"state {state} ({self._text(list(self.numbers)[state])})"

    def _met(self, place: Hashable) -> str:
        known = place in self.numbers
        return self._said(self.numbers[place]) if known else f"a new state ({self._text(place)})"

    def _text(self, place: Hashable) -> str:
        """A state's name, if names are given, or its key."""
        key = place.key if isinstance(place, Ended) else place
        text = short(key) if self.name is None else self.name(key)
        return f"{text}, where the episode ends" if isinstance(place, Ended) else text

    def _transitions(self, rows: list[Row]) -> Transitions:
        source, action, target, reward, done = (
            np.array(column) for column in zip(*rows, strict=True)
        )
        places = list(self.numbers)
        keys = [place.key if isinstance(place, Ended) else place for place in places]
        return Transitions(
            source=source,
            action=action,
            target=target,
            probability=np.ones(len(rows)),
            reward=reward.astype(np.float64),
            done=done,
            fail=np.zeros(len(places), dtype=np.bool_),
            terminal=np.array([isinstance(place, Ended) for place in places]),
            num_actions=len(self.actions),
            first_action=self.actions.start,
            initial=(np.arange(len(places)) == 0).astype(np.float64),
            state_names=None if self.name is None else tuple(self.name(key) for key in keys),
            action_names=numerals(self.actions),
        )


def _progress_bar() -> Any:
    return optional_module("tqdm", "a progress bar", "explore").tqdm(unit=" states")
