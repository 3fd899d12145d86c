"""Offline data: transitions in the order they happened, episode after episode.

The keys are those of DSRL's flat layout. An episode ends where ``terminals`` (a violation
or a goal) or ``timeouts`` (the clock, or the end of the recording) is set; the next row
begins another. Costs are 1 at a violation, else 0, and a violation ends its episode.
Nothing is repaired silently: what is no number, or no flag, is refused by column and row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep.tasks.violation import violations

__all__ = [
    "Summary",
    "Transitions",
    "check_episodes",
    "check_shapes",
    "checked",
    "concatenate",
    "cut_at_violation",
    "keep_before_violation",
    "numbers",
    "summarise",
]

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

    A car before a wall, in two episodes, the first of which ends in it:

    >>> gap = np.array([[3.0], [2.0], [1.0], [3.0], [2.5]])
    >>> log = Transitions(
    ...     observations=gap, actions=[[1.0], [1.0], [1.0], [0.5], [-1.0]],
    ...     next_observations=gap - 1, rewards=np.zeros(5), costs=[0, 0, 1, 0, 0],
    ...     terminals=[0, 0, 1, 0, 0], timeouts=[0, 0, 0, 0, 1])
    >>> len(log), log.ends.tolist()
    (5, [False, False, True, False, True])
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
            object.__setattr__(self, field.name, checked(field.name, getattr(self, field.name)))
        check_shapes(vars(self))
        violations(self.costs, None)
        check_episodes(self.costs, self.terminals)
        if not self.costs.any():
            raise ValueError("costs: there is no violation in the data, so nothing to learn from")

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


def checked(name: str, given: Any) -> NDArray[Any]:
    """A column as it is kept: read-only, float32 or bool, every number finite, every flag 0 or 1.

    An array that is that already is not copied.

    Args:
        name: the column's, which decides on the type.
        given: its values.

    Raises:
        ValueError: naming column and row of the first value that will not do.
    """
    kind = np.bool_ if name in ("terminals", "timeouts") else np.float32
    ready = type(given) is np.ndarray and given.dtype == kind and not given.flags.writeable
    array = given if ready else numbers(name, given)
    if kind is np.bool_:
        _check_each(name, array, (array == 0) | (array == 1), "1 where an episode ends, else 0")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, and is refused
        kept: NDArray[Any] = array if ready else np.array(array, dtype=kind)
    _check_each(name, array, np.isfinite(kept), "a finite number of float32's range")
    kept.flags.writeable = False
    return kept


def numbers(name: str, given: Any) -> NDArray[Any]:
    """An array of real numbers, nothing masked.

    Raises:
        ValueError: naming the column, if it is none.
    """
    if np.ma.is_masked(given):
        raise ValueError(
            f"{name}: row {int(np.argwhere(np.ma.getmaskarray(given))[0][0])} is masked"
        )
    try:
        array = np.asarray(given)
    except ValueError as error:
        raise ValueError(f"{name}: rows differ in length ({error})") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{name}: the values are of type {array.dtype}, not real numbers")
    return array


def _check_each(name: str, array: NDArray[Any], good: Bools, meant: str) -> None:
    if good.all():
        return
    place = tuple(map(int, np.argwhere(~good)[0]))
    row = f"row {place[0]}" if place else "the value"
    column = f", column {', '.join(map(str, place[1:]))}" if place[1:] else ""
    raise ValueError(f"{name}: {row}{column} is {array[place]}, not {meant}")


def check_shapes(columns: Mapping[str, NDArray[Any]]) -> None:
    """All columns of :class:`Transitions` have one row a transition, of the shape meant.

    Raises:
        ValueError: naming the first one that has not.
    """
    observations, actions = columns["observations"], columns["actions"]
    if observations.ndim != 2 or actions.ndim != 2 or not observations.shape[1] * actions.shape[1]:
        raise ValueError(
            "observations and actions must have shapes (N, dim), dim at least 1, not "
            f"{observations.shape} and {actions.shape}"
        )
    n = len(observations)
    if n == 0:
        raise ValueError("the data hold no transition")
    following, costs = columns["next_observations"], columns["costs"]
    if following.shape != observations.shape:
        raise ValueError(
            f"next_observations have shape {following.shape}, observations {observations.shape}"
        )
    if costs.ndim == 2 and costs.shape[1] > 1:
        violations(costs, None)  # says how one of several constraints is chosen
    for name in ("actions", "rewards", "costs", "terminals", "timeouts"):
        shape = columns[name].shape
        wanted = (n, *shape[1:]) if name == "actions" else (n,)
        if shape != wanted:
            raise ValueError(f"{name} has shape {shape}, expected {wanted}")


def check_episodes(costs: NDArray[Any], terminals: Bools) -> None:
    """Refuse violations that end no episode.

    Raises:
        ValueError: naming the first one, and how many there are.
    """
    goes_on = (costs != 0) & ~terminals
    if goes_on.any():
        row, count = int(np.argmax(goes_on)), int(goes_on.sum())
        raise ValueError(
            f"costs: row {row} is a violation but its episode goes on (terminals is not set), as "
            f"after {count:,} of {int((costs != 0).sum()):,} violations; --cut (cut=True, or "
            "cut_at_violation) ends an episode at each of them and begins another after it"
        )


def cut_at_violation(raw: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Raw columns where each violation ends an episode, and the recording goes on in another.

    For recordings that go on after violations, as DSRL's do: every violation is kept, as a row
    marked in ``terminals``. Dropped are only the rows that lead out of a violating state: it has
    failed, whatever comes after it. The rows further on count as they are, so the system must be
    the same after a violation as before it; cut the recording of a wreck at its first one.
    """
    ends = checked("terminals", raw["terminals"]) | checked("timeouts", raw["timeouts"])
    violation = checked("costs", raw["costs"]) > 0
    failed_before = np.append(False, (violation & ~ends)[:-1])
    keep: Bools = violation | ~failed_before
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
    """Counts and ranges; an unfinished last episode counts as one.

    >>> print(summarise(log))
    5 transitions in 2 episodes (2.5 steps each), 1 violations, 1 timeouts; observations in R^1, ...
    """
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
