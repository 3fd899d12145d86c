"""Collecting offline data: random actions, given policies, and their mixture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deep.data.transitions import Transitions, concatenate, keep_before_violation
from deep.tasks.task import Floats, Observations, Task

__all__ = [
    "Policy",
    "Source",
    "check_shares",
    "collect",
    "collect_mix",
    "corner_policy",
    "kept",
    "random_policy",
    "sb3_policy",
    "towards_obstacle_policy",
    "uniform_starts",
]

Actions: TypeAlias = NDArray[np.floating[Any]]
Policy: TypeAlias = Callable[[Observations, Floats, np.random.Generator], Actions]
"""(observations (n, o), states (n, s), rng) -> actions (n, a) in [-1, 1]."""
Starts: TypeAlias = Callable[[np.random.Generator, int], Floats]
Draw: TypeAlias = Callable[[int], dict[str, NDArray[Any]]]
"""A number of transitions -> at least so many, as columns."""
COPIES = 64


class _Predictor(Protocol):
    def predict(self, observation: Any, *, deterministic: bool = ...) -> tuple[Any, Any]: ...


def random_policy(task: Task) -> Policy:
    """Uniform actions."""

    def act(_: Observations, state: Floats, rng: np.random.Generator) -> Actions:
        return rng.uniform(-1, 1, (len(state), task.action_dim))

    return act


def corner_policy(task: Task) -> Policy:
    """Every coordinate at one end of its range: full braking and full turns are in the data."""

    def act(_: Observations, state: Floats, rng: np.random.Generator) -> Actions:
        return rng.choice((-1.0, 1.0), size=(len(state), task.action_dim))

    return act


def towards_obstacle_policy(task: Task) -> Policy:
    """The task's adversary: it heads for the nearest obstacle."""

    def act(_: Observations, state: Floats, rng: np.random.Generator) -> Actions:  # noqa: ARG001  (every Policy's arguments)
        return task.towards_obstacle(state)

    return act


def sb3_policy(model: _Predictor, deterministic: bool = False) -> Policy:
    """A Stable-Baselines3 model (anything with its ``predict``) as a policy."""

    def act(observation: Observations, _: Floats, rng: np.random.Generator) -> Actions:  # noqa: ARG001  (every Policy's arguments)
        actions: Actions = model.predict(observation, deterministic=deterministic)[0]
        return actions

    return act


def uniform_starts(task: Task) -> Starts:
    """First states from everywhere but violations; dead ones are not left out: labels enter
    no data.
    """
    return task.anywhere


def collect(
    task: Task,
    policy: Policy,
    rng: np.random.Generator,
    transitions: int,
    *,
    copies: int = COPIES,
    starts: Starts | None = None,
    max_steps: int | None = None,
) -> Transitions:
    """At least ``transitions`` transitions from ``copies`` parallel runs of the task.

    Args:
        policy: who acts.
        starts: first states; the task's own by default.
        max_steps: cut episodes off there, before the task's time limit.

    Raises:
        ValueError: if the data hold no violation, or a number is not positive.
    """
    return Transitions(**_draw(task, policy, rng, transitions, copies, starts, max_steps))


def _draw(
    task: Task,
    policy: Policy,
    rng: np.random.Generator,
    transitions: int,
    copies: int,
    starts: Starts | None,
    max_steps: int | None,
) -> dict[str, NDArray[Any]]:
    """The columns of :func:`collect`, where violations may be missing."""
    if transitions < 1 or copies < 1 or (max_steps is not None and max_steps < 1):
        raise ValueError("transitions, copies and max_steps must be at least 1")
    begin = task.reset if starts is None else starts
    limit = task.time_limit if max_steps is None else min(max_steps, task.time_limit)
    rows = -(-transitions // copies)
    state, age = begin(rng, copies), np.zeros(copies, dtype=np.int64)
    columns = {
        name: np.empty((copies, rows, *shape), dtype=kind)
        for name, (shape, kind) in _columns(task).items()
    }
    for row in range(rows):
        observation = task.observe(state)
        action = np.clip(policy(observation, state, rng), -1, 1)
        step = task.step(state, action, rng)
        age += 1
        terminal = step.violation | step.success
        timeout = ((age >= limit) | (row == rows - 1)) & ~terminal
        following = task.observe(step.next_state)
        values: tuple[NDArray[Any], ...] = (
            observation,
            action,
            following,
            step.reward,
            step.violation,
            terminal,
            timeout,
        )
        for column, value in zip(columns.values(), values, strict=True):
            column[:, row] = value
        done = terminal | timeout
        state = step.next_state
        state[done] = begin(rng, int(done.sum()))
        age[done] = 0
    for name, column in columns.items():  # one copy's episodes after another's
        columns[name] = column.reshape(-1, *column.shape[2:])
        columns[name].flags.writeable = False
    return columns


def _columns(task: Task) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
    """Shape of a row and type of each column."""
    observation, action = (task.observation_dim,), (task.action_dim,)
    return {
        "observations": (observation, np.float32),
        "actions": (action, np.float32),
        "next_observations": (observation, np.float32),
        "rewards": ((), np.float32),
        "costs": ((), np.float32),
        "terminals": ((), np.bool_),
        "timeouts": ((), np.bool_),
    }


@dataclass(frozen=True)
class Source:
    """One part of a mixture.

    Attributes:
        policy: who acts.
        share: the part of the transitions that it gives, in (0, 1].
        starts: first states; None: the task's own.
        keep: only so many steps before each violation; None: all.
        max_steps: cut episodes off there.
    """

    policy: Policy
    share: float
    starts: Starts | None = None
    keep: int | None = 100
    max_steps: int | None = None


def collect_mix(
    task: Task, sources: list[Source], rng: np.random.Generator, transitions: int
) -> Transitions:
    """``transitions`` transitions, each source giving its share after its filter.

    Raises:
        ValueError: if the shares do not sum to 1, or a source gives too few transitions
            before violations.
    """
    counts = check_shares([source.share for source in sources], transitions)
    return concatenate(
        [_kept(task, s, rng, n) for s, n in zip(sources, counts, strict=True) if n >= 1]
    )


def check_shares(shares: Sequence[float], transitions: int) -> list[int]:
    """How many of the transitions each share is.

    Raises:
        ValueError: if the shares are not positive or do not sum to 1.
    """
    total = sum(shares)
    if abs(total - 1) > 1e-9 or any(share <= 0 for share in shares):
        raise ValueError(f"shares must be positive and sum to 1, not to {total:g}")
    return [int(n) for n in np.diff(np.round(np.cumsum([0.0, *shares]) * transitions))]


LARGEST = 1 << 20
"""The most transitions that are drawn, and held, at once."""
PATIENCE = 300
"""Transitions that are drawn for one that is wanted before a source is given up."""


def _kept(task: Task, source: Source, rng: np.random.Generator, wanted: int) -> Transitions:
    """Exactly ``wanted`` transitions that pass the source's filter."""

    def draw(transitions: int) -> dict[str, NDArray[Any]]:
        return _draw(task, source.policy, rng, transitions, COPIES, source.starts, source.max_steps)

    return kept(task.name, draw, source.keep, wanted)


def kept(name: str, draw: Draw, keep: int | None, wanted: int) -> Transitions:
    """Exactly ``wanted`` transitions, at most ``keep`` steps before violations.

    A draw that gives too few is thrown away for one twice as large; the largest add up.

    Args:
        name: the task's.
        draw: at least so many transitions, as columns, where violations may be missing.
        keep: None: everything.
        wanted: how many.

    Raises:
        ValueError: if there are too few, or no violation.
    """
    if keep is None:
        return Transitions(**draw(wanted)).take(np.arange(wanted))
    drawn, total = wanted, 0
    parts: list[Transitions] = []
    while total < PATIENCE * wanted:
        columns = draw(drawn)
        total += drawn
        parts = parts if drawn >= LARGEST else []
        if columns["costs"].any():
            parts.append(keep_before_violation(Transitions(**columns), keep))
        found = sum(len(part) for part in parts)
        if found >= wanted:
            return concatenate(parts).take(np.arange(wanted))
        drawn = max(min(2 * drawn, LARGEST), wanted)
    raise ValueError(
        f"{name}: of {total:,} transitions too few lie within {keep} steps before "
        f"a violation; {wanted:,} are wanted"
    )
