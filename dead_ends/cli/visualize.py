"""The pictures of the standard tasks: ``python -m dead_ends.visualize brake``.

``brake`` is the paper's first figure, from exact values: distance times speed, the three
subsets, the optimal boundary, and the boundaries that the safety critics of worse policies
draw. ``gridworld``, ``lifegate`` and ``bridge`` draw labels, survival times and safe actions.
``--gif`` adds an animation: the same task policy without and with behavior correction.

With a display a window opens, without one a file is written; ``--out`` always writes one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from dead_ends.draw.animation import Run, animate_runs
from dead_ends.draw.pictures import Blocked, Boundary, plot_boundaries, plot_map
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
from dead_ends.io.atomic import atomic_path, check_target
from dead_ends.io.errors import located
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.labels.labelling import Label, Labelling
from dead_ends.model.policy_table import as_distribution
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.paper.methods import conservatism
from dead_ends.safety.policies import allowed_actions, greedy_actions, recovery_policy
from dead_ends.safety.thresholds import threshold_interval
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.discount import Discount, power, scientific
from dead_ends.values.expectile import expectile_iteration
from dead_ends.values.precision import UndecidedError
from dead_ends.values.values import Values

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")

TIME: Any = {"value": ValueConvention.TIME, "critic": CriticConvention.NEXT_VALUE}
"""V = gamma^T and Q = V(s'): the default Q, and a V that is what Q is on entering a state."""

PAPER_THRESHOLD = 0.7
"""Where no threshold is exact (stochastic tasks), the paper's of its pretraining ablation."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A task to draw: its model, its title and the task policy of the animation."""

    name: str
    title: str
    model: SafeMDP
    task_policy: NDArray[Any]
    start: int
    steps: int
    seed: int = 0


def brake_scene(arguments: argparse.Namespace) -> Scene:
    lattice = _lattice(arguments)
    model = brake(lattice)
    policy = as_distribution(_late(lattice), model.num_actions)
    start = lattice.state(lattice.max_distance, 0)
    return Scene("brake", "Braking car", model, policy, start, steps=90)


def gridworld_scene(arguments: argparse.Namespace) -> Scene:
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


def lifegate_scene(arguments: argparse.Namespace) -> Scene:
    title = f"LifeGate (death drag {arguments.death_drag:g})"
    return _random_walk("lifegate", title, lifegate(arguments.death_drag), seed=0)


def bridge_scene(arguments: argparse.Namespace) -> Scene:
    title = f"Bridge (falls with probability {arguments.fall_probability:g})"
    model = bridge(arguments.length, arguments.fall_probability)
    return _random_walk("bridge", title, model, seed=0)


def _random_walk(name: str, title: str, model: SafeMDP, seed: int) -> Scene:
    """A scene whose task policy takes each action with the same probability."""
    assert model.initial is not None
    policy = np.full((model.num_states, model.num_actions), 1 / model.num_actions)
    start = int(np.flatnonzero(model.initial)[0])
    return Scene(name, title, model, policy, start, steps=80, seed=seed)


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


def brake_figure(scene: Scene, labelling: Labelling, arguments: argparse.Namespace) -> Figure:
    """The paper's first figure from exact values, and what each critic takes away."""
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
    epsilon_text = scientific(gamma, horizon, digits=3)
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

    return plot_boundaries(
        scene.model,
        labelling,
        [Boundary(name, _unsafe(values, labelling, horizon)) for name, values in lines],
        blocked=[Blocked(name, blocked(values)) for name, values in rows],
        thresholds=[rf"$\gamma^H$ = {epsilon_text}", "0.7", "0.3"],
        title=rf"What safety critics call unsafe ($\gamma$ = {gamma:g}, $\epsilon = \gamma^H$)",
    )


def _unsafe(values: Values, labelling: Labelling, horizon: int) -> NDArray[np.bool_]:
    """The states that a deterministic step may not enter: Q = V(s') >= gamma^H (see TIME)."""
    return np.asarray(labelling.fail | (power(values.gamma_safe, horizon) <= values.V), dtype=bool)


def map_figure(scene: Scene, labelling: Labelling, arguments: argparse.Namespace) -> Figure:
    """Labels, survival times and safe actions; where none is safe, the least risky ones."""
    arrows, name = safe_actions(scene.model, labelling), "safe action"
    if labelling.at_risk.any():
        critic = value_iteration(scene.model, 1.0, exact=arguments.exact or None)
        least_risky = greedy_actions(critic.Q)
        arrows = arrows | (least_risky & labelling.at_risk[:, None])
        name = "safe action; at risk: least risky action"
    return plot_map(scene.model, labelling, title=scene.title, actions=arrows, actions_name=name)


def runs(scene: Scene, gamma_safe: float, epsilon_safe: Discount, exact: bool = False) -> list[Run]:
    """The same task policy from the same start, without and with behavior correction."""
    values = value_iteration(scene.model, gamma_safe, exact=exact)
    everything = scene.model.available
    allowed = allowed_actions(values, epsilon_safe)
    recovery = recovery_policy(values.Q)
    return [
        _run(scene, "task policy alone", everything, recovery),
        _run(scene, "with behavior correction", allowed, recovery),
    ]


def _run(scene: Scene, name: str, allowed: NDArray[np.bool_], recovery: NDArray[np.int_]) -> Run:
    """One episode of Algorithm 2's interaction: an action that is not allowed is replaced."""
    rng = np.random.default_rng(scene.seed)
    model, kernel = scene.model, scene.model.transitions()
    states, corrected = [scene.start], []
    for _ in range(scene.steps):
        state = states[-1]
        if model.fail[state] or model.terminal[state]:
            break
        action = int(rng.choice(model.num_actions, p=scene.task_policy[state]))
        corrected.append(not allowed[state, action])
        if corrected[-1]:
            action = int(recovery[state])
        start, stop = kernel.indptr[state * model.num_actions + action :][:2]
        states.append(int(rng.choice(kernel.indices[start:stop], p=kernel.data[start:stop])))
    return Run(name, np.array(states), np.array(corrected, dtype=bool))


def summary(scene: Scene, labelling: Labelling, gamma_safe: float, exact: bool = False) -> str:
    """The numbers that belong to the picture, a line each."""
    interval = threshold_interval(scene.model, gamma_safe, exact=exact)
    rows = [
        ("states", f"{scene.model.num_states:,}"),
        ("|S_fail|", f"{labelling.count(Label.FAIL):,}"),
        ("|S_dead|", f"{labelling.count(Label.DEAD):,}"),
        ("|S_safe|", f"{labelling.count(Label.SAFE):,}"),
    ]
    if labelling.count(Label.AT_RISK):
        rows.append(("at risk", f"{labelling.count(Label.AT_RISK):,}"))
    rows += [
        (
            "H",
            str(labelling.horizon)
            if labelling.horizon is not None
            else "none (Assumption 1 fails)",
        ),
        (
            "H_b",
            str(labelling.boundary_horizon) if labelling.boundary_horizon is not None else "none",
        ),
        ("threshold", str(interval)),
    ]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)


def write_figure(figure: Figure, path: Path) -> None:
    """Save a figure whole or not at all; the suffix is the format."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def write_animation(scene: Scene, labelling: Labelling, episodes: list[Run], path: Path) -> None:
    """Save the animated GIF whole or not at all; the end is held for two seconds."""
    frames = animate_runs(scene.model, labelling, episodes, title=scene.title)
    durations = [125] * (len(frames) - 1) + [2000]
    with atomic_path(path) as temporary:
        frames[0].save(
            temporary, save_all=True, append_images=frames[1:], duration=durations, loop=0
        )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m dead_ends.visualize", description="Draw dead-ends, exactly."
    )
    scenes = parser.add_subparsers(dest="scene", required=True, metavar="TASK")

    def add(name: str, text: str, build: SceneBuilder, draw: Drawer) -> argparse.ArgumentParser:
        task = scenes.add_parser(name, help=text, description=text)
        task.set_defaults(build=build, draw=draw)
        task.add_argument("--out", type=Path, help=f"write the picture here ({', '.join(FORMATS)})")
        task.add_argument("--gif", type=Path, help="also write an animation here (.gif)")
        task.add_argument("--gamma-safe", type=float, default=0.99, help="discount of the cost")
        task.add_argument("--epsilon-safe", type=float, help="threshold of the animation")
        task.add_argument(
            "--exact",
            action="store_true",
            help="solve in fractions, decimals as they are written (0.1 is 1/10); critics of "
            "policies that act at random stay floats within bounds",
        )
        return task

    default = BrakeLattice()
    task = add("brake", "a car brakes before an obstacle", brake_scene, brake_figure)
    for option, value, text in (
        ("distance", default.max_distance, "greatest distance"),
        ("speed", default.max_speed, "greatest speed"),
        ("braking", default.max_braking, "hardest braking a step"),
        ("acceleration", default.max_acceleration, "hardest acceleration a step"),
    ):
        task.add_argument(f"--{option}", type=int, default=value, help=f"{text}, lattice units")
    task.add_argument("--dynamics", choices=("semi-implicit", "explicit"), default="semi-implicit")
    task = add("gridworld", "a map with lava, ice and currents", gridworld_scene, map_figure)
    task.add_argument("--map", type=Path, help="a text map instead of the default one")
    task.add_argument("--slip", type=float, default=0.0, help="probability of slipping sideways")
    task = add("lifegate", "LifeGate, a grid that drifts towards death", lifegate_scene, map_figure)
    task.add_argument("--death-drag", type=float, default=0.4, help="probability of drifting")
    task = add("bridge", "Bridge, with a fall that takes time", bridge_scene, map_figure)
    task.add_argument("--length", type=int, default=9, help="cells of the bridge")
    task.add_argument("--fall-probability", type=float, default=0.01, help="falls going forward")
    return parser


SceneBuilder = Callable[[argparse.Namespace], Scene]
Drawer = Callable[[Scene, Labelling, argparse.Namespace], "Figure"]


def _check(arguments: argparse.Namespace) -> None:
    if not 0 < arguments.gamma_safe <= 1:
        raise ValueError(f"--gamma-safe must lie in (0, 1], not {arguments.gamma_safe:g}")
    for option, path, formats in (
        ("--out", arguments.out, FORMATS),
        ("--gif", arguments.gif, (".gif",)),
    ):
        if path is not None and path.suffix.lower() not in formats:
            raise ValueError(f"{option}: {path} must end in {', '.join(formats)}")
    inputs = [arguments.map] if getattr(arguments, "map", None) is not None else []
    for path in (arguments.out or _default_picture(arguments.scene), arguments.gif):
        if path is not None:
            check_target(path, *inputs)


def _default_picture(scene: str) -> Path:
    """Where the picture goes if nothing is said and there is no display."""
    return Path(f"{scene}.png")


def _epsilon(model: SafeMDP, arguments: argparse.Namespace) -> Discount:
    """The threshold of the animation: as given, or the largest one that is exact."""
    if arguments.epsilon_safe is not None:
        return float(arguments.epsilon_safe)
    if not model.is_deterministic:
        return PAPER_THRESHOLD
    interval = threshold_interval(model, arguments.gamma_safe, exact=arguments.exact)
    if interval.upper is None:
        raise UndecidedError(f"the threshold is {interval}", {"exact": "use exact=True"})
    return min(1, interval.upper)


def _has_display() -> bool:
    from matplotlib import get_backend
    from matplotlib.backends.registry import BackendFilter, backend_registry

    # matplotlib leaves this method without annotations.
    interactive = backend_registry.list_builtin(BackendFilter.INTERACTIVE)  # type: ignore[no-untyped-call]
    return get_backend().lower() in interactive


def _show(figure: Figure) -> None:
    """Give the figure a window; ``pyplot.figure(figure)`` does so from matplotlib 3.11 on only."""
    from matplotlib import pyplot

    pyplot.figure(FigureClass=cast("type[Figure]", lambda **_: figure))
    pyplot.show()


def main(argv: Sequence[str] | None = None) -> int:
    """Draw a task; 0 if all went well, 2 for bad input."""
    arguments = _parser().parse_args(argv)
    try:
        _check(arguments)
        _draw(arguments)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(f"{place}{error.strerror or error}")
    except UndecidedError as error:
        return _complain(error.with_options(vars(arguments)))
    except ValueError as error:
        return _complain(str(error))
    return 0


def _complain(message: str) -> int:
    print(f"dead_ends.visualize: {message}", file=sys.stderr)
    return 2


def _draw(arguments: argparse.Namespace) -> None:
    scene: Scene = arguments.build(arguments)
    labelling = classify(scene.model)
    print(summary(scene, labelling, arguments.gamma_safe, arguments.exact))
    figure: Figure = arguments.draw(scene, labelling, arguments)
    window = arguments.out is None and _has_display()
    if window:
        print("picture    in its window")
    else:
        path = arguments.out or _default_picture(scene.name)
        write_figure(figure, path)
        print(f"picture    {path}")
    if arguments.gif is not None:
        epsilon = _epsilon(scene.model, arguments)
        episodes = runs(scene, arguments.gamma_safe, epsilon, arguments.exact)
        write_animation(scene, labelling, episodes, arguments.gif)
        print(f"animation  {arguments.gif}")
    if window:
        _show(figure)


if __name__ == "__main__":
    sys.exit(main())
