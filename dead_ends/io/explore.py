"""Deterministic Gymnasium environments, explored breadth first.

An environment that can be copied and stepped is a graph: from each new state every action is
tried on a copy. A *key* tells states apart: a hashable value with all that the future depends
on. Ends by a time limit are none of the task's: copies are made of ``env.unwrapped``, so that
wrappers, a TimeLimit too, do not count, and truncation is ignored.

Violations are transitions that satisfy a condition, by default none is known but for MiniGrid,
where stepping on lava ends the episode without reward. MiniGrid's lava maps have no dead-ends:
turning round is always possible and harmless.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable, Hashable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dead_ends.io.errors import located, optional_module
from dead_ends.io.gymnasium_table import environment_name
from dead_ends.io.transitions import Condition, Transitions, build_model, violations
from dead_ends.model import SafeMDP

__all__ = ["MAX_STATES", "explore", "explore_minigrid", "minigrid_key"]

MAX_STATES = 1_000_000

Key = Callable[[Any], Hashable]


def explore(
    env: Any,
    key: Key,
    *,
    fail_if: Condition | None = None,
    max_states: int = MAX_STATES,
    name: Callable[[Hashable], str] | None = None,
    progress: bool = False,
    seed: int | None = 0,
) -> SafeMDP:
    """The model of what can be reached from the environment's first state.

    State 0 is the first state after ``env.reset(seed=seed)``. A transition that terminates
    leads to a state of its own, which fails if all transitions into it satisfy ``fail_if``, and
    is terminal otherwise. Every step is tried twice with different random numbers: a
    stochastic environment is found out (with high probability, and if it draws from
    ``env.np_random``) and refused.

    Args:
        env: a Gymnasium environment with a discrete action space; not changed.
        key: from the unwrapped environment to a hashable value, equal for equal states.
        fail_if: a condition on (s, a, r, s') and ``done``.
        max_states: the limit.
        name: from a key to the state's name.
        progress: show a progress bar on standard error (needs tqdm).
        seed: for the reset.

    Raises:
        ValueError: if the action space is not discrete, there are more states than
            ``max_states``, or a step has two different outcomes.
        MissingDependencyError: if ``progress`` and tqdm is not installed.
    """
    with located(environment_name(env)):
        return _explore(
            copy.deepcopy(env.unwrapped), key, fail_if, max_states, name, progress, seed
        )


def explore_minigrid(
    env: Any,
    *,
    fail_if: Condition | None = None,
    max_states: int = MAX_STATES,
    progress: bool = False,
    seed: int | None = 0,
) -> SafeMDP:
    """A MiniGrid environment; lava fails unless ``fail_if`` says otherwise.

    Parameters and errors as in :func:`explore`.
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
    return column, row, int(env.agent_dir), carrying, env.grid.encode().tobytes()


def _minigrid_name(key: Any) -> str:
    return f"column {key[0]}, row {key[1]}, facing {('right', 'down', 'left', 'up')[key[2]]}"


@dataclass(frozen=True)
class _Ended:
    """The key of a state in which the episode has ended: not the same place before."""

    key: Hashable


def _explore(
    env: Any,
    key: Key,
    fail_if: Condition | None,
    max_states: int,
    name: Callable[[Hashable], str] | None,
    progress: bool,
    seed: int | None,
) -> SafeMDP:
    num_actions = getattr(env.action_space, "n", None)
    if num_actions is None:
        raise ValueError(f"the action space {env.action_space} is not discrete")
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    numbers: dict[Hashable, int] = {key(env): 0}
    waiting = deque([(0, env)])
    rows: list[tuple[int, int, int, float, bool]] = []
    with ExitStack() as stack:
        bar = stack.enter_context(_progress_bar()) if progress else None
        while waiting:
            source, parent = waiting.popleft()
            for action in range(int(num_actions)):
                child, reward, terminated = _step(parent, action, key, source, rng)
                place = _Ended(key(child)) if terminated else key(child)
                if place not in numbers:
                    if len(numbers) == max_states:
                        raise ValueError(f"more than {max_states} states (max_states)")
                    numbers[place] = len(numbers)
                    if not terminated:
                        waiting.append((numbers[place], child))
                    if bar is not None:
                        bar.update()
                rows.append((source, action, numbers[place], reward, terminated))
    return _build(rows, list(numbers), int(num_actions), fail_if, name)


def _step(
    env: Any, action: int, key: Key, source: int, rng: np.random.Generator
) -> tuple[Any, float, bool]:
    """A copy after the step, its reward and whether the episode ended, tried twice."""
    outcomes = []
    for tries in rng.spawn(2):
        child = copy.deepcopy(env)
        child.np_random = tries
        _, reward, terminated, _, _ = child.step(action)
        outcomes.append((key(child), float(reward), bool(terminated)))
    if outcomes[0] != outcomes[1]:
        raise ValueError(
            f"state {source}, action {action}: two tries differ; the environment is stochastic"
        )
    return child, *outcomes[1][1:]


def _progress_bar() -> Any:
    return optional_module("tqdm", "a progress bar", "explore").tqdm(unit=" states")


def _build(
    rows: list[tuple[int, int, int, float, bool]],
    places: list[Hashable],
    num_actions: int,
    fail_if: Condition | None,
    name: Callable[[Hashable], str] | None,
) -> SafeMDP:
    source, action, target, reward, done = (np.array(column) for column in zip(*rows, strict=True))
    ended = np.array([isinstance(place, _Ended) for place in places])
    keys = [place.key if isinstance(place, _Ended) else place for place in places]
    transitions = Transitions(
        source=source,
        action=action,
        target=target,
        probability=np.ones(len(rows)),
        reward=reward.astype(np.float64),
        done=done,
        fail=np.zeros(len(places), dtype=np.bool_),
        terminal=ended,
        num_actions=num_actions,
        initial=(np.arange(len(places)) == 0).astype(np.float64),
        state_names=None if name is None else tuple(name(key) for key in keys),
    )
    if fail_if is not None:
        harmless = np.zeros(len(places), dtype=np.bool_)
        harmless[target[~violations(transitions, fail_if)]] = True
        fails = ended & ~harmless
        transitions = replace(transitions, fail=fails, terminal=ended & ~fails)
    return build_model(transitions, fail_if)
