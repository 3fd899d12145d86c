"""Enclosing safe sets beside hj_reachability: ``python -m benchmarks.reachability``.

hj_reachability (https://github.com/StanfordASL/hj_reachability) solves, on a grid, the
Hamilton-Jacobi equation of the backward reachable tube: V(s) is the least signed distance to
a violation, over all later times, that the best control can keep; V < 0 is dead. Its nodes
are the centres of our cells.

The two do not answer the same question. There, time is continuous: controls may change at any
moment, and violations count at any moment. Here, controls are held for a step, and violations
count at the ends of steps. So what is reported is where the answers differ, how far V is from
0 there (a distance), and how that shrinks with the time step. Lengths and times are in the
units of the coarsest step. Writes ``results/reachability.json``.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import hj_reachability as hj
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import save
from dead_ends import classify
from dead_ends.envs.bracket import Bracket, Grid
from dead_ends.envs.double_integrator import double_integrator
from dead_ends.envs.dubins import dubins

Floats = NDArray[np.float64]

GAP, MAX_SPEED, MARGIN = 20, 6, 0.5
"""Double integrator: distance of the walls, greatest speed, the nodes' reach behind a wall."""
SIDE, PILLAR, TURN = 8, 1.0, 5 * 2 * np.pi / 32
"""Dubins car: side of the square, radius of the pillar, turn in a unit of time (speed 1)."""
DURATION = 7.0
"""Long enough: to brake from 6 takes 6, half a turn of the car 3.2."""


class Controlled(hj.ControlAndDisturbanceAffineDynamics):
    """drift(s) + input * u, |u| <= greatest; u keeps V as great as it can, nothing disturbs."""

    def __init__(self, drift: Callable[[Any], Any], inputs: list[float], greatest: float) -> None:
        self.drift = drift
        self.inputs = jnp.array(inputs)[:, None]
        control = hj.sets.Box(jnp.array([-greatest]), jnp.array([greatest]))
        nothing = hj.sets.Box(jnp.zeros(1), jnp.zeros(1))
        super().__init__("max", "min", control, nothing)

    def open_loop_dynamics(self, state: Any, time: Any) -> Any:  # noqa: ARG002  (hj_reachability calls it so)
        return self.drift(state)

    def control_jacobian(self, state: Any, time: Any) -> Any:  # noqa: ARG002  (hj_reachability calls it so)
        return self.inputs

    def disturbance_jacobian(self, state: Any, time: Any) -> Any:  # noqa: ARG002  (hj_reachability calls it so)
        return jnp.zeros_like(self.inputs)


def tube(
    dynamics: Controlled, cells: Grid, unit: float, walled: int, distance: Callable[[Any], Any]
) -> Floats:
    """V at the cells' centres after ``DURATION``.

    Args:
        unit: what hj's unit of length is in the cells'.
        walled: so many first coordinates end at walls. The nodes go on behind them: V falls
            below 0 there, and only from there the solver learns of a wall. A third
            coordinate is an angle.
    """
    scale = np.where(np.arange(len(cells.shape)) < walled, unit, 1.0)
    lower, width = cells.lower / scale, cells.width / scale
    behind = np.where(np.arange(len(width)) < walled, np.ceil(MARGIN / width), 0).astype(int)
    shape = np.array(cells.shape) + 2 * behind
    low = lower + width * (0.5 - behind)
    angle = np.arange(len(shape)) == 2
    high = low + width * (shape - np.where(angle, 0, 1))
    grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(jnp.array(low), jnp.array(high)),
        tuple(shape.tolist()),
        periodic_dims=2 if angle.any() else None,
    )
    settings = hj.SolverSettings.with_accuracy(
        "very_high", hamiltonian_postprocessor=hj.solver.backwards_reachable_tube
    )
    first = distance(grid.states)
    value = hj.step(settings, dynamics, grid, 0.0, first, -DURATION, progress_bar=False)
    inside = tuple(slice(b, n - b) for b, n in zip(behind, shape, strict=True))
    return np.asarray(value, dtype=np.float64)[inside].ravel()


def compared(value: Floats, pair: Bracket) -> dict[str, Any]:
    """Shares of the cells that are no violation, and V where the answers differ."""
    cells = slice(0, pair.grid.num_cells)
    free = ~pair.outer.fail[cells] & ~pair.inner.fail[cells]
    inner, outer = classify(pair.inner).safe[cells], classify(pair.outer).safe[cells]
    value, inner, outer = value[free], inner[free], outer[free]
    missed, extra = inner & (value < 0), ~outer & (value >= 0)
    gap = outer & ~inner
    return {
        "cells": int(free.sum()),
        "certainly_safe": float(inner.mean()),
        "certainly_dead": float((~outer).mean()),
        "gap": float(gap.mean()),
        "hj_safe": float((value >= 0).mean()),
        "certainly_safe_hj_dead": float(missed.mean()),
        "least_value_there": float(value[missed].min()) if missed.any() else None,
        "certainly_dead_hj_safe": float(extra.mean()),
        "greatest_value_there": float(value[extra].max()) if extra.any() else None,
        "gap_hj_safe": float((value[gap] >= 0).mean()) if gap.any() else None,
    }


def mass_value(centres: Floats) -> Floats:
    """V in closed form: min(gap - x - v+^2 / 2, x - v-^2 / 2)."""
    x, v = centres.T
    right = GAP - x - np.maximum(v, 0) ** 2 / 2
    return np.asarray(np.minimum(right, x - np.maximum(-v, 0) ** 2 / 2))


def mass(steps: int) -> dict[str, Any]:
    """The double integrator with so many time steps in a unit of time."""
    pair = double_integrator(
        GAP * steps**2, MAX_SPEED * steps, 4 // steps, time_step=1 / steps, acceleration=1.0
    )
    dynamics = Controlled(lambda s: jnp.array([s[1], 0.0]), [0.0, 1.0], 1.0)
    started = perf_counter()
    value = tube(dynamics, pair.grid, 1, 1, lambda s: jnp.minimum(s[..., 0], GAP - s[..., 0]))
    seconds = perf_counter() - started
    exact = mass_value(pair.grid.centres())
    return {
        "model": "double integrator",
        "time_step": 1 / steps,
        **compared(value, pair),
        "closed_form_hj_differ": float(((exact >= 0) != (value >= 0)).mean()),
        "hj_error_near_boundary": float(np.abs(value - exact)[np.abs(exact) < 1].max()),
        "closed_form": compared(exact, pair),
        "hj_seconds": seconds,
    }


def room(state: Any) -> Any:
    """The car's distance from the wall and the pillar, negative behind them."""
    offset = state[..., :2] - SIDE / 2
    wall = SIDE / 2 - jnp.abs(offset).max(axis=-1)
    return jnp.minimum(wall, jnp.linalg.norm(offset, axis=-1) - PILLAR)


def car(steps: int) -> dict[str, Any]:
    """The Dubins car with so many time steps in a unit of time."""
    pair = dubins(SIDE * steps, 10 // steps, 32 * steps, 5, PILLAR * steps)
    dynamics = Controlled(
        lambda s: jnp.array([jnp.cos(s[2]), jnp.sin(s[2]), 0.0]), [0.0, 0.0, 1.0], TURN
    )
    started = perf_counter()
    value = tube(dynamics, pair.grid, steps, 2, room)
    return {
        "model": "Dubins car",
        "time_step": 1 / steps,
        **compared(value, pair),
        "hj_seconds": perf_counter() - started,
    }


def main() -> None:
    """Both models at several time steps."""
    started = perf_counter()
    rows = []
    for call, steps in ((mass, 1), (mass, 2), (mass, 4), (car, 1), (car, 2)):
        rows.append(call(steps))
        print(rows[-1], flush=True)
    config = {"duration": DURATION, "accuracy": "very_high"}
    save("reachability", config, rows, perf_counter() - started)


if __name__ == "__main__":
    main()
