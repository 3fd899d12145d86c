"""The tasks that ``visualize`` draws, and what is solved for their pictures."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.draw.animation import Episode
from dead_ends.draw.pictures import Blocked, Boundary
from dead_ends.envs.brake import (
    BrakeLattice,
    brake,
    explicit,
    late_braker,
    semi_implicit,
    uniform_driver,
    weak_braker,
)
from dead_ends.envs.bridge import bridge
from dead_ends.envs.gridworld import DEFAULT_MAP, gridworld, parse_map
from dead_ends.envs.lifegate import lifegate
from dead_ends.io.errors import located
from dead_ends.labels.classification import safe_actions
from dead_ends.labels.labelling import Labelling
from dead_ends.model.policy_table import as_distribution
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.paper.methods import conservatism
from dead_ends.safety.policies import allowed_actions, greedy_actions, recovery_policy
from dead_ends.safety.thresholds import threshold_interval
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.discount import Discount, power
from dead_ends.values.expectile import expectile_iteration
from dead_ends.values.precision import UndecidedError
from dead_ends.values.values import Values

__all__ = [
    "TaskScene",
    "brake_critics",
    "brake_scene",
    "bridge_scene",
    "episodes",
    "gridworld_scene",
    "lifegate_scene",
    "map_actions",
    "threshold",
]

TIME: Any = {"value": ValueConvention.TIME, "critic": CriticConvention.NEXT_VALUE}
"""V = gamma^T and Q = V(s'): the default Q, and a V that is what Q is on entering a state."""

PAPER_THRESHOLD = 0.7
"""Where no threshold is exact (stochastic tasks), the paper's of its pretraining ablation."""


@dataclass(frozen=True, eq=False)
class TaskScene:
    """A task to draw: its model, its title and the task policy of the animation."""

    name: str
    title: str
    model: SafeMDP
    task_policy: NDArray[Any]
    start: int
    steps: int
    seed: int = 0


def brake_scene(arguments: argparse.Namespace) -> TaskScene:
    lattice = _lattice(arguments)
    model = brake(lattice)
    policy = as_distribution(_late(lattice), model.num_actions)
    start = lattice.state(lattice.max_distance, 0)
    return TaskScene("brake", "Braking car", model, policy, start, steps=90)


def gridworld_scene(arguments: argparse.Namespace) -> TaskScene:
    model = gridworld(_map_text(arguments.map), arguments.slip)
    return _random_walk("gridworld", "Gridworld", model, seed=3)


def _map_text(path: Path | None) -> str:
    """The map in a file, checked here so that what is wrong with it is said of the file."""
    if path is None:
        return DEFAULT_MAP
    with located(path):
        text = path.read_text(encoding="utf-8")
        parse_map(text)
    return text


def lifegate_scene(arguments: argparse.Namespace) -> TaskScene:
    title = f"LifeGate (death drag {arguments.death_drag:g})"
    return _random_walk("lifegate", title, lifegate(arguments.death_drag), seed=0)


def bridge_scene(arguments: argparse.Namespace) -> TaskScene:
    title = f"Bridge (falls with probability {arguments.fall_probability:g})"
    model = bridge(arguments.length, arguments.fall_probability)
    return _random_walk("bridge", title, model, seed=0)


def _random_walk(name: str, title: str, model: SafeMDP, seed: int) -> TaskScene:
    """A scene whose task policy takes each action with the same probability."""
    assert model.initial is not None
    policy = np.full((model.num_states, model.num_actions), 1 / model.num_actions)
    start = int(np.flatnonzero(model.initial)[0])
    return TaskScene(name, title, model, policy, start, steps=80, seed=seed)


def _late(lattice: BrakeLattice) -> NDArray[np.int64]:
    return late_braker(lattice, braking_distance=_LATE * lattice.max_distance // 100)


_LATE = 25
"""The late braker brakes within this percentage of the greatest distance."""


def _lattice(arguments: argparse.Namespace) -> BrakeLattice:
    default = BrakeLattice()
    return BrakeLattice(
        max_distance=arguments.distance,
        max_speed=arguments.speed,
        max_braking=arguments.braking,
        max_acceleration=arguments.acceleration,
        obstacle_depth=max(2, default.obstacle_depth * arguments.distance // default.max_distance),
        dynamics={"semi-implicit": semi_implicit, "explicit": explicit}[arguments.dynamics],
    )


def brake_critics(
    scene: TaskScene, labelling: Labelling, arguments: argparse.Namespace
) -> tuple[list[Boundary], list[Blocked]]:
    """What the critics of several drivers call unsafe at gamma^H, and what they block.

    They block at the thresholds gamma^H, 0.7 and 0.3.
    """
    lattice, gamma = _lattice(arguments), arguments.gamma_safe
    random = uniform_driver(lattice)
    exact = arguments.exact or None
    optimal = value_iteration(scene.model, gamma, exact=exact, **TIME)
    braking = weak_braker(lattice, max(1, lattice.max_braking - 1))
    weak = evaluate_policy(scene.model, braking, gamma, exact=exact)
    late = evaluate_policy(scene.model, _late(lattice), gamma, exact=exact, **TIME)
    uniform = evaluate_policy(scene.model, random, gamma, **TIME)
    trained = [(tau, expectile_iteration(scene.model, random, tau, gamma)) for tau in (0.1, 0.3)]
    horizon = labelling.horizon or 0
    metres = _LATE * lattice.max_distance // 100 * lattice.distance_step
    lines = [
        ("best policy, $Q^*$: the optimal boundary", optimal),
        ("weak braker", weak),
        (f"late braker (from {metres:g} m on)", late),
        ("uniformly random driver", uniform),
    ]
    rows = [
        ("best policy, $Q^*$", optimal),
        *((f"DEA-RRL as trained,\nexpectile {tau}", values) for tau, values in trained),
        ("weak braker", weak),
        ("late braker", late),
        ("random driver", uniform),
    ]

    def blocked(values: Values) -> tuple[float, ...]:
        thresholds = (power(values.gamma_safe, horizon), 0.7, 0.3)
        results = (conservatism(scene.model, values, epsilon) for epsilon in thresholds)
        return tuple(result.blocked_safe_actions_share for result in results)

    return (
        [Boundary(name, _unsafe(values, labelling, horizon)) for name, values in lines],
        [Blocked(name, blocked(values)) for name, values in rows],
    )


def _unsafe(values: Values, labelling: Labelling, horizon: int) -> NDArray[np.bool_]:
    """The states that a deterministic step may not enter: Q = V(s') >= gamma^H (see TIME)."""
    return np.asarray(labelling.fail | (power(values.gamma_safe, horizon) <= values.V), dtype=bool)


def map_actions(
    scene: TaskScene, labelling: Labelling, arguments: argparse.Namespace
) -> tuple[NDArray[np.bool_], str]:
    """Safe actions, bool (S, A); where none is safe, the least risky ones; and their name."""
    arrows = safe_actions(scene.model, labelling)
    if not labelling.at_risk.any():
        return arrows, "safe action"
    critic = value_iteration(scene.model, 1.0, exact=arguments.exact or None)
    arrows = arrows | (greedy_actions(critic.Q) & labelling.at_risk[:, None])
    return arrows, "safe action; at risk: least risky action"


def episodes(
    scene: TaskScene, gamma_safe: float, epsilon_safe: Discount, exact: bool = False
) -> list[Episode]:
    """The same task policy from the same start, without and with behavior correction."""
    values = value_iteration(scene.model, gamma_safe, exact=exact)
    everything = scene.model.available
    allowed = allowed_actions(values, epsilon_safe)
    recovery = recovery_policy(values.Q)
    return [
        _episode(scene, "task policy alone", everything, recovery),
        _episode(scene, "with behavior correction", allowed, recovery),
    ]


def _episode(
    scene: TaskScene, name: str, allowed: NDArray[np.bool_], recovery: NDArray[np.int_]
) -> Episode:
    """One episode of Algorithm 2's interaction: an action that is not allowed is replaced."""
    rng = np.random.default_rng(scene.seed)
    model, matrix = scene.model, scene.model.transitions()
    states, corrected = [scene.start], []
    for _ in range(scene.steps):
        state = states[-1]
        if model.fail[state] or model.terminal[state]:
            break
        action = int(rng.choice(model.num_actions, p=scene.task_policy[state]))
        corrected.append(not allowed[state, action])
        if corrected[-1]:
            action = int(recovery[state])
        start, stop = matrix.indptr[state * model.num_actions + action :][:2]
        states.append(int(rng.choice(matrix.indices[start:stop], p=matrix.data[start:stop])))
    return Episode(name, np.array(states), np.array(corrected, dtype=bool))


def threshold(model: SafeMDP, arguments: argparse.Namespace) -> Discount:
    """The threshold of the animation: as given, or the largest one that is exact."""
    if arguments.epsilon_safe is not None:
        return float(arguments.epsilon_safe)
    if not model.is_deterministic:
        return PAPER_THRESHOLD
    interval = threshold_interval(model, arguments.gamma_safe, exact=arguments.exact)
    if interval.upper is None:
        raise UndecidedError(f"the threshold is {interval}", {"exact": "use exact=True"})
    return min(1, interval.upper)
