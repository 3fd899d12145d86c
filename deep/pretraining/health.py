"""Is a filter of use? What it does with logged actions, at its threshold, says so.

A filter is to block what led to violations and to let pass what ended well:

    all     the share of all logged actions that it blocks
    well    of those in episodes that ended without a violation: false alarms
    before  of those in the last H steps before violations

The numbers are those of a log, in which the agent acted and not the filter: one that looks
well here may still fail in the closed loop. One that looks of no use here is of no use.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from deep.data.transitions import Transitions
from deep.filter.safety_filter import UNSEEN, SafetyFilter
from deep.pretraining.learner import Learner, Losses
from deep.runs.folder import from_plain, read_object
from deep.tasks.bounds import Bounds

__all__ = ["Fault", "FilterHealth", "check_filter", "check_losses", "read_health", "write_health"]

NEARLY = 0.05
"""At most this share is nearly nothing, all but this share nearly everything."""
ROWS = 1 << 14
FILE = "health.json"

Bools = NDArray[np.bool_]


class Fault(StrEnum):
    """Why a filter is of no use."""

    BLOCKS_ALL = "it blocks nearly every action"
    BLOCKS_NONE = "it lets nearly every action pass, also in the last steps before violations"
    BLOCKS_ALIKE = "it blocks hardly more actions before violations than elsewhere"
    ELSEWHERE = "these observations lie far outside of those that it was trained on"


@dataclass(frozen=True)
class FilterHealth:
    """One seed's filter on a log. Shares in [0, 1]; None of nothing.

    Attributes:
        seed: the seed.
        threshold: epsilon.
        transitions: logged actions.
        steps: how many before each violation count as the last: H, at least 1.
        blocked: share of the logged actions that the filter would replace.
        blocked_well: of those in episodes that ended without a violation.
        blocked_before: of those in the last ``steps`` steps before violations.
        blocked_elsewhere: of the others.
        out_of_range: share of the observations far outside of those it was trained on; on
            its own log there are none.

    >>> health = pretrain(log, horizon=3, updates=3, quiet=True).health[0]
    >>> health.transitions, health.steps, health.out_of_range
    (5, 3, 0.0)
    """

    seed: int
    threshold: float
    transitions: int
    steps: int
    blocked: float
    blocked_well: float | None
    blocked_before: float | None
    blocked_elsewhere: float | None
    out_of_range: float

    @property
    def fault(self) -> Fault | None:
        """Why the filter is of no use, or None if the log does not show that."""
        harmless = self.blocked_elsewhere if self.blocked_well is None else self.blocked_well
        before = self.blocked_before
        if max(self.blocked, self.blocked_well or 0) >= 1 - NEARLY:
            return Fault.BLOCKS_ALL
        if (self.blocked if before is None else before) <= NEARLY:
            return Fault.BLOCKS_NONE
        if before is not None and harmless is not None and before <= harmless + NEARLY:
            return Fault.BLOCKS_ALIKE
        return Fault.ELSEWHERE if self.out_of_range > NEARLY else None

    def __str__(self) -> str:
        well, before = _percent(self.blocked_well), _percent(self.blocked_before)
        last = "last step" if self.steps == 1 else f"last {self.steps} steps"
        fault = "" if self.fault is None else f"; warning: of no use, {self.fault}"
        return (
            f"seed {self.seed}: at epsilon {self.threshold:.3g} it blocks "
            f"{_percent(self.blocked)} of {self.transitions:,} logged actions, {well} of those in "
            f"episodes that ended well, {before} of those in the {last} before violations; "
            f"{_percent(self.out_of_range)} of the observations are out of range{fault}"
        )


def _percent(share: float | None) -> str:
    return "none (there are none)" if share is None else f"{100 * share:.1f}%"


def check_filter(safety: SafetyFilter, log: Transitions, horizon: int | None) -> FilterHealth:
    """What the filter does with a log, its own or another, in the environment's units.

    Args:
        safety: the filter.
        log: its actions are those of an agent, not corrected.
        horizon: H, the most steps from a dead-end to the violation; None, where it is not
            known, counts as 1: the step that violates.

    Raises:
        ValueError: if the log has observations or actions of other dimensions, or actions
            further outside of the filter's bounds than an environment's may lie.

    >>> result = pretrain(log, horizon=3, updates=3, quiet=True)
    >>> check_filter(result.filters[0], log, horizon=3) == result.health[0]
    True
    """
    found = (log.observations.shape[1], log.actions.shape[1])
    if found != (safety.observation_dim, safety.action_dim):
        raise ValueError(
            f"the log has observations in R^{found[0]} and actions in R^{found[1]}, the filter "
            f"takes R^{safety.observation_dim} and R^{safety.action_dim}"
        )
    if horizon is not None and horizon < 0:
        raise ValueError(f"horizon must not be negative, not {horizon}")
    low, high = safety.actions.widened(UNSEEN)
    covered = Bounds.covered(log.actions)
    if (np.array(covered.low) < low).any() or (np.array(covered.high) > high).any():
        raise ValueError(
            f"the log has actions in {covered}, the filter was trained on {safety.actions}"
        )
    steps = max(horizon or 1, 1)
    blocks = [slice(first, first + ROWS) for first in range(0, len(log), ROWS)]
    done = [safety.correct(log.observations[rows], log.actions[rows]) for rows in blocks]
    blocked = np.concatenate([part.intervened for part in done])
    well, before = _groups(log, steps)
    return FilterHealth(
        seed=safety.seed,
        threshold=safety.threshold,
        transitions=len(log),
        steps=steps,
        blocked=float(blocked.mean()),
        blocked_well=_share(blocked[well]),
        blocked_before=_share(blocked[before]),
        blocked_elsewhere=_share(blocked[~before]),
        out_of_range=float(np.concatenate([part.out_of_range for part in done]).mean()),
    )


def _groups(log: Transitions, steps: int) -> tuple[Bools, Bools]:
    """Rows of episodes that ended without a violation; the last rows before violations.

    An episode that the log breaks off belongs to neither.
    """
    rows, ends = np.arange(len(log)), np.flatnonzero(log.ends)
    last = np.append(ends, len(log) - 1)[np.searchsorted(ends, rows)]
    violated = log.costs[last] == 1
    return log.ends[last] & ~violated, violated & (last - rows < steps)


def _share(blocked: Bools) -> float | None:
    return float(blocked.mean()) if len(blocked) else None


def write_health(health: Sequence[FilterHealth], folder: Path) -> None:
    """Keep it with the run, for :func:`read_health`."""
    seeds: list[dict[str, Any]] = [asdict(h) | {"fault": h.fault} for h in health]
    with atomic_path(folder / FILE) as temporary:
        temporary.write_text(json.dumps({"seeds": seeds}, indent=2) + "\n")


def read_health(folder: Path) -> tuple[FilterHealth, ...]:
    """The health of a finished run's filters, one a seed.

    Raises:
        ValueError: if the run is not finished, or the file is broken.
    """
    path = folder / FILE
    if not path.is_file():
        raise ValueError(f"{folder}: not a finished pretraining run (no {FILE})")
    try:
        return tuple(
            from_plain(FilterHealth, {k: v for k, v in plain.items() if k != "fault"})
            for plain in read_object(path, "seeds")["seeds"]
        )
    except (TypeError, AttributeError) as error:
        raise ValueError(f"{path}: not the health of filters ({error})") from error


def check_losses(learner: Learner, losses: Losses, update: int) -> None:
    """Stop at a loss that is not a number.

    Raises:
        FloatingPointError: naming the update, the loss and the seed.
    """
    for name, loss in zip(Losses._fields, losses, strict=True):
        bad = ~torch.isfinite(loss)
        if bad.any():
            seed = learner.seeds[int(bad.int().argmax())]
            raise FloatingPointError(
                f"update {update}: the {name} loss of seed {seed} is {float(loss[bad][0])}; "
                "try a smaller learning rate, and look at the data's range"
            )
