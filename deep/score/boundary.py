"""Scores of a safety filter against the exact answer: its boundary, and its closed loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deep.data.collect import Policy
from deep.filter.equation import blocks, corrected
from deep.filter.safety_filter import SafetyFilter
from deep.score.exact_answers import ExactAnswer, ExactTask, oracle_allows, oracle_blocks
from deep.tasks import Task
from deep.tasks.bounds import Bounds
from deep.tasks.shapes import inside_any
from deep.tasks.task import Bools, Floats

__all__ = [
    "BoundaryScore",
    "ClosedLoop",
    "LearnedFilter",
    "OracleFilter",
    "Points",
    "ScoredFilter",
    "action_grid",
    "box_points",
    "closed_loop",
    "critic_table",
    "safe_starts",
    "score_boundary",
]

Actions: TypeAlias = NDArray[np.floating]


class ScoredFilter(Protocol):
    """A filter as it is scored: critic and correction in terms of true states."""

    def critic(self, state: Floats, action: Actions) -> NDArray[np.floating]:
        """Q_c, (n,)."""

    def correct(self, state: Floats, action: Actions) -> tuple[Actions, Bools]:
        """The executed actions (n, a), and where they are not the agent's (n,)."""


@dataclass(frozen=True)
class LearnedFilter:
    """A safety filter, which sees observations only.

    Raises:
        ValueError: if it was trained on other actions than a task's, which fill [-1, 1].
    """

    task: Task
    safety: SafetyFilter

    def __post_init__(self) -> None:
        self.safety.for_actions(Bounds.unit(self.task.action_dim), self.task.name)

    def critic(self, state: Floats, action: Actions) -> NDArray[np.floating]:
        """Q_c by the networks."""
        return self.safety.q(self.task.observe(state), action.astype(np.float32))

    def correct(self, state: Floats, action: Actions) -> tuple[Actions, Bools]:
        """Equation (behavior_correction)."""
        correction = self.safety.correct(self.task.observe(state), action.astype(np.float32))
        return correction.executed, correction.intervened


@dataclass(frozen=True)
class OracleFilter:
    """The limit of every filter: it knows the exact labels. Its critic is 0 or 1."""

    answer: ExactAnswer
    task: ExactTask

    def critic(self, state: Floats, action: Actions) -> NDArray[np.floating]:
        """1 for actions that may leave the safe set."""
        return (~oracle_allows(self.answer, state, action)).astype(np.float32)

    def correct(self, state: Floats, action: Actions) -> tuple[Actions, Bools]:
        """Replace exactly the actions that may leave the safe set, by the safest one."""
        critic = self.critic(state, action)
        return corrected(action, critic, 1.0, lambda: self.task.safest_action(state))


@dataclass(frozen=True, eq=False)
class Points:
    """States to score on, and what is true of them; fixed before anything is trained.

    Attributes:
        state: float (N, d), uniform over the task's region; violations, and states of which
            nothing is certain, are left out.
        gap: the share of the latter among the states that are no violations.
        dead: bool (N,); the others are safe.
        near: bool (N,), within the stated distance of the boundary; none where there is no
            such distance.
        action: float (A, a), the grid of actions.
        unsafe, fine: bool (N, A), whether the action certainly leads to a dead state or a
            violation; whether it certainly leads to a safe state.
    """

    state: Floats
    gap: float
    dead: Bools
    near: Bools
    action: Floats
    unsafe: Bools
    fine: Bools


def action_grid(action_dim: int, count: int) -> Floats:
    """float (count ** a, a): a dense grid over [-1, 1]^a with its ends."""
    axis = np.linspace(-1, 1, count)
    axes = np.meshgrid(*(axis,) * action_dim, indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, action_dim)


def box_points(
    answer: ExactAnswer, count: int, actions: int, near: float, rng: np.random.Generator
) -> Points:
    """Uniform points of the task's region; ``near`` is a share of its first side."""
    task = answer.task
    low, high = task.region
    state = rng.uniform(low, high, (count, len(low)))
    state = state[~inside_any(task.obstacles, task.position(state))]
    certain = answer.dead(state) | answer.safe(state)
    gap, state = float(1 - certain.mean()), state[certain]
    action = action_grid(task.action_dim, actions)
    repeated = [np.broadcast_to(a, (len(state), len(a))) for a in action]
    width = near * (high[0] - low[0])
    distance = answer.boundary_distance
    return Points(
        state,
        gap,
        answer.dead(state),
        np.zeros(len(state), dtype=np.bool_) if distance is None else distance(state) <= width,
        action,
        np.stack([oracle_blocks(answer, state, a) for a in repeated], axis=1),
        np.stack([oracle_allows(answer, state, a) for a in repeated], axis=1),
    )


def critic_table(scored: ScoredFilter, points: Points) -> NDArray[np.float32]:
    """float32 (N, A): Q_c of every point and action of the grid."""
    columns = [
        scored.critic(points.state, np.broadcast_to(a, (len(points.state), len(a))))
        for a in points.action
    ]
    return np.stack(columns, axis=1).astype(np.float32)


@dataclass(frozen=True)
class BoundaryScore:
    """Shares in [0, 1], NaN of nothing; dead is called what has no Q_c below the threshold.

    Attributes:
        dead_called_safe, safe_called_dead: over the box.
        near_dead_called_safe, near_safe_called_dead: near the boundary.
        safe_actions_blocked: of the actions that lead from safe states to safe states.
        unsafe_actions_allowed: of the actions that lead out of safe states.
    """

    dead_called_safe: float
    safe_called_dead: float
    near_dead_called_safe: float
    near_safe_called_dead: float
    safe_actions_blocked: float
    unsafe_actions_allowed: float


def score_boundary(table: NDArray[np.float32], threshold: float, points: Points) -> BoundaryScore:
    """The scores of a critic's table (N, A) at a threshold."""
    over = blocks(table, threshold)
    called: Bools = np.all(over, axis=1, keepdims=True)[:, 0]
    dead, near = points.dead, points.near
    blocked, unsafe, fine = over[~dead], points.unsafe[~dead], points.fine[~dead]
    return BoundaryScore(
        dead_called_safe=_share(~called[dead]),
        safe_called_dead=_share(called[~dead]),
        near_dead_called_safe=_share(~called[dead & near]),
        near_safe_called_dead=_share(called[~dead & near]),
        safe_actions_blocked=_share(blocked[fine]),
        unsafe_actions_allowed=_share(~blocked[unsafe]),
    )


def _share(mask: Bools) -> float:
    return float(mask.mean()) if mask.size else float("nan")


def safe_starts(answer: ExactAnswer, count: int, rng: np.random.Generator) -> Floats:
    """``count`` of the task's own starts that are safe."""
    found: list[Floats] = []
    while sum(map(len, found)) < count:
        state = answer.task.reset(rng, count)
        found.append(state[answer.safe(state)])
    return np.concatenate(found)[:count]


@dataclass(frozen=True)
class ClosedLoop:
    """Whole episodes of a task policy behind a filter.

    Attributes:
        episodes: how many.
        failures: how many ended in a violation.
        interventions: share of the steps at which the action was replaced.
        mean_return: of the episodes' rewards, undiscounted.
    """

    episodes: int
    failures: int
    interventions: float
    mean_return: float


def closed_loop(
    task: Task,
    scored: ScoredFilter | None,
    policy: Policy,
    starts: Floats,
    rng: np.random.Generator,
) -> ClosedLoop:
    """One episode from each start, to its end; without a filter the policy acts freely."""
    state = starts.copy()
    steps = interventions = failures = 0
    total = 0.0
    for _ in range(task.time_limit):
        action = np.clip(policy(task.observe(state), state, rng), -1, 1)
        if scored is not None:
            action, intervened = scored.correct(state, action)
            interventions += int(intervened.sum())
        step = task.step(state, action, rng)
        steps += len(state)
        total += float(step.reward.sum())
        failures += int(step.violation.sum())
        state = step.next_state[~(step.violation | step.success)]
        if not len(state):
            break
    return ClosedLoop(len(starts), failures, interventions / steps, total / len(starts))
