"""Offline data: transitions in the order they happened, episode after episode.

The keys are those of DSRL's flat layout. An episode ends where ``terminals`` (a violation
or a goal) or ``timeouts`` (the clock, or the end of the recording) is set; the next row
begins another. Costs are 1 at a violation, else 0, and a violation ends its episode.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Summary", "Transitions", "concatenate", "keep_before_violation", "summarise"]

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Transitions:
    """N checked transitions; read-only. Arrays are copied unless they are read-only already.

    Attributes:
        observations, next_observations: float32 (N, observation dim).
        actions: float32 (N, action dim).
        rewards: float32 (N,).
        costs: float32 (N,), 1 at a violation, else 0.
        terminals: bool (N,), the episode ended here by itself (violations included).
        timeouts: bool (N,), the episode was cut off here: bootstrap through it.
    """

    observations: Floats
    actions: Floats
    next_observations: Floats
    rewards: Floats
    costs: Floats
    terminals: Bools
    timeouts: Bools

    def __post_init__(self) -> None:
        for field in fields(self):
            kind = np.bool_ if field.name in ("terminals", "timeouts") else np.float32
            object.__setattr__(self, field.name, _frozen(getattr(self, field.name), kind))
        _check_shapes(self)
        _check_numbers(self)
        _check_episodes(self)

    def __len__(self) -> int:
        return len(self.costs)

    @property
    def ends(self) -> Bools:
        """bool (N,): the last row of each episode."""
        return self.terminals | self.timeouts

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Transitions:
        """The rows, by index or mask; keep whole tails of episodes."""
        return Transitions(
            **{field.name: getattr(self, field.name)[rows] for field in fields(self)}
        )


def _frozen(given: Any, kind: type[np.generic]) -> NDArray[Any]:
    """A read-only copy; an array that is read-only already is kept as it is."""
    if isinstance(given, np.ndarray) and given.dtype == kind and not given.flags.writeable:
        return given
    array: NDArray[Any] = np.array(given, dtype=kind)
    array.flags.writeable = False
    return array


def _check_shapes(data: Transitions) -> None:
    if data.observations.ndim != 2 or data.actions.ndim != 2:
        raise ValueError(
            "observations and actions must have shapes (N, dim), not "
            f"{data.observations.shape} and {data.actions.shape}"
        )
    n = len(data.observations)
    if n == 0:
        raise ValueError("the data hold no transition")
    if data.next_observations.shape != data.observations.shape:
        raise ValueError(
            f"next_observations have shape {data.next_observations.shape}, "
            f"observations {data.observations.shape}"
        )
    for name in ("actions", "rewards", "costs", "terminals", "timeouts"):
        shape = getattr(data, name).shape
        wanted = (n, *shape[1:]) if name == "actions" else (n,)
        if shape != wanted:
            raise ValueError(f"{name} has shape {shape}, expected {wanted}")


def _check_numbers(data: Transitions) -> None:
    for name in ("observations", "actions", "next_observations", "rewards", "costs"):
        array = getattr(data, name)
        bad = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
        if bad.any():
            raise ValueError(f"{name}: row {int(np.argmax(bad))} holds a NaN or an infinity")
    odd = (data.costs != 0) & (data.costs != 1)
    if odd.any():
        row = int(np.argmax(odd))
        raise ValueError(
            f"costs: row {row} is {data.costs[row]:g}; a cost is 1 at a violation, else 0"
        )


def _check_episodes(data: Transitions) -> None:
    violation = data.costs == 1
    if not violation.any():
        raise ValueError("costs: there is no violation in the data, so nothing to learn from")
    goes_on = violation & ~data.terminals
    if goes_on.any():
        row = int(np.argmax(goes_on))
        raise ValueError(
            f"costs: row {row} is a violation but its episode goes on (terminals is not set); "
            "cut episodes at their first violation, for example with cut_at_violation"
        )


def cut_at_violation(raw: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Raw columns with every episode cut at its first violation, which ends it.

    For recordings that go on after a violation (``python -m deep`` and the readers refuse
    them): rows after the first violation of an episode are dropped, the violation's row
    is marked in ``terminals``.
    """
    ends = np.asarray(raw["terminals"], dtype=np.bool_) | np.asarray(
        raw["timeouts"], dtype=np.bool_
    )
    violation = np.asarray(raw["costs"]) > 0
    episode = np.concatenate([[0], np.cumsum(ends)[:-1]])
    count = np.cumsum(violation)
    before: NDArray[np.int64] = count - violation
    starts = np.flatnonzero(np.diff(episode, prepend=-1))
    keep: Bools = before == before[starts][episode]
    cut = {name: np.asarray(column)[keep].copy() for name, column in raw.items()}
    cut["terminals"] = cut["terminals"].astype(np.bool_) | (cut["costs"] > 0)
    cut["timeouts"] = cut["timeouts"].astype(np.bool_) & ~cut["terminals"]
    return cut


def keep_before_violation(data: Transitions, steps: int | None) -> Transitions:
    """Only the last ``steps`` rows up to and with each violation; None keeps all.

    The paper keeps 100. Rows of episodes without a violation are dropped.

    Raises:
        ValueError: if ``steps`` is not positive.
    """
    if steps is None:
        return data
    if steps < 1:
        raise ValueError(f"keep at least 1 step before a violation, not {steps}")
    rows = np.arange(len(data))
    last = np.flatnonzero(data.ends)
    end = np.append(last, len(data) - 1)[np.searchsorted(last, rows)]
    return data.take((data.costs[end] == 1) & (end - rows < steps))


def concatenate(parts: list[Transitions]) -> Transitions:
    """The parts one after the other; each part's last episode is cut off where it ends.

    Raises:
        ValueError: if there are no parts, or their dimensions differ.
    """
    if not parts:
        raise ValueError("there is nothing to concatenate")
    shapes = {(part.observations.shape[1], part.actions.shape[1]) for part in parts}
    if len(shapes) > 1:
        raise ValueError(f"the parts differ in (observation, action) dimensions: {sorted(shapes)}")
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(Transitions)
    }
    last = np.cumsum([len(part) for part in parts]) - 1
    columns["timeouts"][last] |= ~columns["terminals"][last]
    return Transitions(**columns)


@dataclass(frozen=True)
class Summary:
    """What data hold.

    Attributes:
        transitions, episodes, violations, timeouts: counts.
        observation_dim, action_dim: dimensions.
        mean_length: transitions an episode.
        action_low, action_high: least and greatest action, by coordinate.
        mean_return: mean reward of an episode.
    """

    transitions: int
    episodes: int
    violations: int
    timeouts: int
    observation_dim: int
    action_dim: int
    mean_length: float
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    mean_return: float

    def __str__(self) -> str:
        low = ", ".join(f"{x:.3g}" for x in self.action_low)
        high = ", ".join(f"{x:.3g}" for x in self.action_high)
        return (
            f"{self.transitions:,} transitions in {self.episodes:,} episodes "
            f"({self.mean_length:.1f} steps each), {self.violations:,} violations, "
            f"{self.timeouts:,} timeouts; observations in R^{self.observation_dim}, actions in "
            f"R^{self.action_dim} from ({low}) to ({high}); mean return {self.mean_return:.3g}"
        )


def summarise(data: Transitions) -> Summary:
    """Counts and ranges; an unfinished last episode counts as one."""
    episodes = int(data.ends.sum()) + int(not data.ends[-1])
    return Summary(
        transitions=len(data),
        episodes=episodes,
        violations=int(data.costs.sum()),
        timeouts=int(data.timeouts.sum()),
        observation_dim=data.observations.shape[1],
        action_dim=data.actions.shape[1],
        mean_length=len(data) / episodes,
        action_low=tuple(float(x) for x in data.actions.min(axis=0)),
        action_high=tuple(float(x) for x in data.actions.max(axis=0)),
        mean_return=float(data.rewards.sum()) / episodes,
    )
