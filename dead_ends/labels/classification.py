"""The subsets of the state space: S_fail, S_dead, S_safe, and the horizons H and H_b.

Deterministic models (Definition 2 of the paper): a state is dead if it is not fail and every
path from it reaches fail; it survives T(s) steps at most. H = max T over the dead states
(Assumption 1 holds in every finite model). H_b = max T(next(s, a)) over the safe states s and
the actions a that lead to an unsafe state: gamma**H_b is the largest threshold that works.

Stochastic models: :mod:`dead_ends.labels.qualitative`. H exists if every dead state fails on all
paths (D = D_sure).

All of this is decided on integers and graphs: no result here depends on rounding. The cost is
linear in the number of transitions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.checks import read_only
from dead_ends.model.memory import require_memory
from dead_ends.model.safe_mdp import SafeMDP, require_type

__all__ = ["INFINITE", "Label", "classify", "safe_actions"]

Graph = tuple[NDArray[np.int32], int, NDArray[np.int32] | NDArray[np.int64] | None]
"""Flat successors, A, and where rows start (None: every A entries), as retrograde takes them."""


def classify(model: SafeMDP) -> Labelling:
    """Label every state FAIL, DEAD, SAFE or AT_RISK, with survival times and horizons.

    Exact: decided on integers. Linear in the transitions, whatever H and the numbering.

    Source: Definition 2 and Assumption 1 of the paper.

    Raises:
        MemoryError: if the model is so large that the work does not fit the memory, before
            it starts.
    """
    require_type(model, SafeMDP, "classify")
    from dead_ends.labels.retrograde import labels_of, survival_times

    require_memory(_bytes_needed(model), f"labelling {model.num_states:,} states")
    time = survival_times(model)
    if model.is_deterministic:
        labels, horizon = labels_of(time)
        return _labelling(model, labels, time, int(horizon))
    from dead_ends.labels.qualitative import qualitative_labels

    labels = qualitative_labels(model)
    return _labelling(model, labels, time, _horizon(labels, time, None))


def safe_actions(model: SafeMDP, labelling: Labelling | None = None) -> NDArray[np.bool_]:
    """The actions that keep a safe state safe, exactly.

    Args:
        model: the model.
        labelling: its ``classify(model)``, if at hand.

    Returns:
        bool (S, A): True where the action is available and every successor is SAFE (in a
        deterministic model: in S_safe). In stochastic models these are the actions that keep
        P_min(F fail) = 0; a state at risk has none. False on fail and dead states; True on
        terminal ones, which stay where they are.

    Raises:
        ValueError: if the labelling has another number of states.
    """
    require_type(model, SafeMDP, "safe_actions")
    if labelling is not None:
        require_type(labelling, Labelling, "safe_actions")
    from dead_ends.labels.retrograde import safe_choices

    if labelling is None:
        labelling = classify(model)
    if len(labelling.labels) != model.num_states:
        raise ValueError(
            f"the labelling has {len(labelling.labels)} states, the model {model.num_states}"
        )
    choices = safe_choices(*_graph(model), model.terminal, labelling.labels)
    return read_only(choices.reshape(model.num_states, model.num_actions))


def _bytes_needed(model: SafeMDP) -> int:
    """What the solver holds at its peak beside the model (see retrograde and qualitative)."""
    if model.is_deterministic:
        return 13 * model.num_states
    choices = model.num_states * model.num_actions
    return 8 * model.transitions().nnz + 30 * model.num_states + 2 * choices


def _graph(model: SafeMDP) -> Graph:
    if model.next_state is not None:
        return model.next_state.reshape(-1), model.num_actions, None
    kernel = model.transitions()
    return kernel.indices, model.num_actions, kernel.indptr


def _labelling(
    model: SafeMDP,
    labels: NDArray[np.uint8],
    time: NDArray[np.int32],
    horizon: int | None,
) -> Labelling:
    reached = _reached(model)
    reachable_horizon = None if reached is None else _horizon(labels, time, reached)
    return Labelling(
        labels=read_only(labels),
        survival_time=read_only(time),
        horizon=horizon,
        boundary_horizon=None if horizon is None else _boundary(model, labels, time, None),
        reachable_horizon=reachable_horizon,
        reachable_boundary_horizon=(
            None if reachable_horizon is None else _boundary(model, labels, time, reached)
        ),
    )


def _reached(model: SafeMDP) -> NDArray[np.bool_] | None:
    """The states reachable from the initial ones; None if the model has none."""
    if model.initial is None:
        return None
    from dead_ends.labels.retrograde import reachable

    return reachable(*_graph(model), model.fail, model.terminal, np.flatnonzero(model.initial))


def _horizon(
    labels: NDArray[np.uint8], time: NDArray[np.int32], reached: NDArray[np.bool_] | None
) -> int | None:
    """H over the dead states (those reached): None if one may survive any number of steps."""
    dead = np.equal(labels, Label.DEAD)
    if reached is not None:
        dead &= reached
    longest = int(time[dead].max(initial=0))
    return None if longest == INFINITE else longest


def _boundary(
    model: SafeMDP,
    labels: NDArray[np.uint8],
    time: NDArray[np.int32],
    reached: NDArray[np.bool_] | None,
) -> int | None:
    """H_b over the safe states (those reached): None if no action leads to an unsafe one."""
    from dead_ends.labels.retrograde import boundary_horizon

    longest = int(boundary_horizon(*_graph(model), model.terminal, labels, time, reached))
    return None if longest < 0 else longest
