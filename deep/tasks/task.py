"""What a task is: pure functions of states, actions and a generator, on whole batches.

A task is a safe MDP with continuous states and actions. Entering a fail state is a
violation (cost 1, the episode ends); reaching a goal may end an episode too, without
harm. A task holds parameters and no state: the same state, action and generator give the
same next state, so environments, data collection and closed-loop tests share one
definition of the dynamics.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deep.tasks.shapes import Shape, inside_any

__all__ = ["Bools", "Floats", "Observations", "Scene", "Step", "Task"]

Floats = NDArray[np.float64]
Observations = NDArray[np.float32]
Bools = NDArray[np.bool_]


class Step(NamedTuple):
    """One step of n copies of a task.

    Attributes:
        next_state: float64 (n, state dim).
        reward: float64 (n,).
        violation: bool (n,), whether ``next_state`` is a fail state.
        success: bool (n,), whether the episode ends there without harm.
    """

    next_state: Floats
    reward: Floats
    violation: Bools
    success: Bools


class Scene(NamedTuple):
    """What is drawn around the agent.

    Attributes:
        obstacles: what must not be hit.
        goals: what is sought.
        others: what does not matter.
    """

    obstacles: tuple[Shape, ...]
    goals: tuple[Shape, ...]
    others: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Task(ABC):
    """A continuous safe MDP.

    Actions are arrays (n, ``action_dim``) in [-1, 1]; what lies outside is clipped.

    Attributes:
        name: the name on the command line.
        state_names: one name a coordinate of the state, with units.
        action_dim: the number of action coordinates.
        observation_dim: the number of coordinates of :meth:`observe`.
        time_limit: the step after which an episode is truncated.
    """

    name: ClassVar[str]
    state_names: ClassVar[tuple[str, ...]]
    action_dim: ClassVar[int]
    observation_dim: ClassVar[int]
    time_limit: ClassVar[int]

    @property
    @abstractmethod
    def low(self) -> Floats:
        """float64 (state dim,): least value of each coordinate of a state."""

    @property
    @abstractmethod
    def high(self) -> Floats:
        """float64 (state dim,): greatest value of each coordinate of a state."""

    @property
    def region(self) -> tuple[Floats, Floats]:
        """Least and greatest corner of where states are drawn to score and to start anywhere."""
        return self.low, self.high

    @abstractmethod
    def reset(self, rng: np.random.Generator, n: int) -> Floats:
        """First states (n, state dim); none of them is a fail state, some may be dead."""

    @abstractmethod
    def step(self, state: Floats, action: NDArray[np.floating], rng: np.random.Generator) -> Step:
        """Apply ``action`` (n, action dim) in ``state`` (n, state dim)."""

    def anywhere(self, rng: np.random.Generator, n: int) -> Floats:
        """States (n, state dim) uniform over :attr:`region` but for violations."""
        state = rng.uniform(*self.region, (n, len(self.low)))
        while (hit := self.violates(state)).any():
            state[hit] = rng.uniform(*self.region, (int(hit.sum()), len(self.low)))
        return state

    def violates(self, state: Floats) -> Bools:
        """bool (n,): which states are fail states."""
        return inside_any(self.obstacles, self.position(state))

    @property
    def observation_low(self) -> Floats:
        """float64 (observation dim,): least value of each coordinate of an observation."""
        return np.full(self.observation_dim, -1.0)

    @property
    def observation_high(self) -> Floats:
        """float64 (observation dim,): greatest value of each coordinate of an observation."""
        return np.ones(self.observation_dim)

    def observe(self, state: Floats) -> Observations:
        """float32 (n, observation dim): the state, scaled to [-1, 1]."""
        centre, half = (self.high + self.low) / 2, (self.high - self.low) / 2
        return np.asarray((state - centre) / half, dtype=np.float32)

    @property
    @abstractmethod
    def view(self) -> tuple[float, float, float, float]:
        """The plane's part that is drawn: x from, x to, y from, y to."""

    @property
    def drawn_state(self) -> Floats:
        """float64 (state dim,): pictures of critics vary the first two coordinates of it."""
        return np.zeros(len(self.low))

    @property
    @abstractmethod
    def obstacles(self) -> tuple[Shape, ...]:
        """What must not be hit in any state, in the plane of :meth:`position`."""

    @property
    def goals(self) -> tuple[Shape, ...]:
        """What is drawn as the goal."""
        return ()

    def scene(self, state: Floats) -> Scene:  # noqa: ARG002  (the same around every state here)
        """What is drawn around one state (state dim,)."""
        return Scene(self.obstacles, self.goals)

    @abstractmethod
    def position(self, state: Floats) -> Floats:
        """float64 (n, 2): where the agent is drawn."""

    @abstractmethod
    def towards_obstacle(self, state: Floats) -> Floats:
        """Actions (n, action dim) that head for the nearest obstacle: an adversary."""


def clip_action(action: NDArray[np.floating]) -> Floats:
    """``action`` as float64, within [-1, 1]."""
    return np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)


class Sizes(NamedTuple):
    """Dimensions of observations and actions."""

    observation: int
    action: int
