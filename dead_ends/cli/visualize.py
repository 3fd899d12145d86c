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
from pathlib import Path
from typing import TYPE_CHECKING, cast

from dead_ends.cli.scenes import (
    TaskScene,
    brake_critics,
    brake_scene,
    bridge_scene,
    episodes,
    gridworld_scene,
    lifegate_scene,
    map_actions,
    threshold,
)
from dead_ends.draw.animation import Episode, animate_episodes
from dead_ends.draw.pictures import plot_boundaries, plot_map
from dead_ends.envs.brake import BrakeLattice
from dead_ends.io.atomic import atomic_path, check_target
from dead_ends.labels.classification import classify
from dead_ends.labels.labelling import Label, Labelling
from dead_ends.safety.thresholds import threshold_interval
from dead_ends.values.discount import scientific
from dead_ends.values.precision import UndecidedError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")


def brake_figure(scene: TaskScene, labelling: Labelling, arguments: argparse.Namespace) -> Figure:
    """The paper's first figure from exact values, and what each critic takes away."""
    gamma = arguments.gamma_safe
    power = scientific(gamma, labelling.horizon or 0, digits=3)
    boundaries, blocked = brake_critics(scene, labelling, arguments)
    return plot_boundaries(
        scene.model,
        labelling,
        boundaries,
        blocked=blocked,
        thresholds=[rf"$\gamma^H$ = {power}", "0.7", "0.3"],
        title=rf"What safety critics call unsafe ($\gamma$ = {gamma:g}, $\epsilon = \gamma^H$)",
    )


def map_figure(scene: TaskScene, labelling: Labelling, arguments: argparse.Namespace) -> Figure:
    """Labels, survival times and safe actions; where none is safe, the least risky ones."""
    arrows, name = map_actions(scene, labelling, arguments)
    return plot_map(scene.model, labelling, title=scene.title, actions=arrows, actions_name=name)


def summary(scene: TaskScene, labelling: Labelling, gamma_safe: float, exact: bool = False) -> str:
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


def write_animation(
    scene: TaskScene, labelling: Labelling, episodes: list[Episode], path: Path
) -> None:
    """Save the animated GIF whole or not at all; the end is held for two seconds."""
    frames = animate_episodes(scene.model, labelling, episodes, title=scene.title)
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


SceneBuilder = Callable[[argparse.Namespace], TaskScene]
Drawer = Callable[[TaskScene, Labelling, argparse.Namespace], "Figure"]


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
    scene: TaskScene = arguments.build(arguments)
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
        epsilon = threshold(scene.model, arguments)
        shown = episodes(scene, arguments.gamma_safe, epsilon, arguments.exact)
        write_animation(scene, labelling, shown, arguments.gif)
        print(f"animation  {arguments.gif}")
    if window:
        _show(figure)


if __name__ == "__main__":
    sys.exit(main())
