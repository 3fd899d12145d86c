"""The result of labelling: S_fail, S_dead, S_safe, survival times, horizons."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

__all__ = ["INFINITE", "Label", "Labelling"]

INFINITE = int(np.iinfo(np.int32).max)
"""The survival time of a state that need not fail."""


class Label(IntEnum):
    """What a state is (Definition 2 of the paper; at-risk only in stochastic models)."""

    FAIL = 0
    """The violation has happened."""

    DEAD = 1
    """Whatever the agent does, it fails (with probability 1)."""

    SAFE = 2
    """Some policy never fails (with probability 1)."""

    AT_RISK = 3
    """Neither: the least probability of failing lies strictly between 0 and 1."""


@dataclass(frozen=True, eq=False)
class Labelling:
    """The subsets of the state space and the horizons, exact: no number was rounded.

    Attributes:
        labels: uint8 (S,), a :class:`Label` a state.
        survival_time: int32 (S,), T: the most steps until failure. 0 on fail states,
            ``INFINITE`` where the agent need not fail. In stochastic models the longest
            path on the states all of whose paths fail, ``INFINITE`` on all others.
        horizon: H, the greatest T over the dead states (0 if there are none). None where
            it does not exist: a stochastic model with a dead state that may survive any
            number of steps.
        boundary_horizon: H_b, the greatest T(s') over the actions that lead from a safe
            state to an unsafe one (a fail state counts 0). None if there is no such action
            or no horizon. In stochastic models "safe" is here the paper's S_safe.
        reachable_horizon, reachable_boundary_horizon: the same over what is reachable from
            the initial states (H_b: over the safe states reachable inside S_safe); None
            too if the model has no initial states.
    """

    labels: NDArray[np.uint8]
    survival_time: NDArray[np.int32]
    horizon: int | None
    boundary_horizon: int | None
    reachable_horizon: int | None
    reachable_boundary_horizon: int | None

    @property
    def fail(self) -> NDArray[np.bool_]:
        """bool (S,): S_fail."""
        return np.equal(self.labels, Label.FAIL)

    @property
    def dead(self) -> NDArray[np.bool_]:
        """bool (S,): S_dead, P_min(F fail) = 1 and not fail."""
        return np.equal(self.labels, Label.DEAD)

    @property
    def safe(self) -> NDArray[np.bool_]:
        """bool (S,): P_min(F fail) = 0; the paper's S_safe if the model is deterministic."""
        return np.equal(self.labels, Label.SAFE)

    @property
    def at_risk(self) -> NDArray[np.bool_]:
        """bool (S,): 0 < P_min(F fail) < 1; empty if the model is deterministic."""
        return np.equal(self.labels, Label.AT_RISK)

    @property
    def paper_safe(self) -> NDArray[np.bool_]:
        """bool (S,): the paper's S_safe, everything that is neither fail nor dead."""
        return self.labels >= Label.SAFE

    def count(self, label: Label) -> int:
        """The number of states with this label."""
        return int(np.count_nonzero(self.labels == label))
