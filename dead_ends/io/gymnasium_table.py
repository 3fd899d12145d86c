"""Gymnasium environments that carry their transition table ``env.unwrapped.P``.

``P[s][a]`` lists (probability, next state, reward, terminated). Which states fail is not in
the table; for the environments whose rules say so it is known here, otherwise the user says
it by states or by a condition on (s, a, r, s').

A table is a claim, and it is tried, see :mod:`dead_ends.io.table_trial`: so Taxi's fickle
passenger is refused, who changes the destination and is not in ``P``.

FrozenLake's holes fail; in CliffWalking stepping into the cliff (reward -100) puts the agent
back to the start, so the failure is a transition and one fail state is added for it. Neither
has any dead-end, slippery or not: from every other state some policy never fails.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.io.environment_model import model_of_environment
from dead_ends.io.errors import located, optional_module
from dead_ends.io.table_trial import check_steps
from dead_ends.io.transitions import Condition, Transitions, build_model, state_mask
from dead_ends.io.trial import discrete_range, numerals
from dead_ends.model.digest import model_digest
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = [
    "environment_name",
    "load_gymnasium",
    "make_environment",
    "table_digest",
    "transition_table",
]

_REGISTERED_BY = {
    "dead_ends/": ("dead_ends.envs.registration", "gym"),
    "MiniGrid-": ("minigrid", "explore"),
}
"""The modules whose import makes ids known, and the extras that bring them."""

_DIRECTIONS = {"left": (-1.0, 0.0), "down": (0.0, -1.0), "right": (1.0, 0.0), "up": (0.0, 1.0)}


def make_environment(environment: Any, arguments: Mapping[str, Any] | None = None) -> Any:
    """The environment of an id such as "FrozenLake-v1"; an environment is returned as it is.

    Raises:
        ValueError: if Gymnasium does not know the id or refuses the arguments.
        MissingDependencyError: if Gymnasium is not installed.
    """
    gymnasium = optional_module("gymnasium", "an environment id", "gym")
    if not isinstance(environment, str):
        return environment
    for prefix, (module, extra) in _REGISTERED_BY.items():
        if environment.startswith(prefix):
            optional_module(module, environment, extra)
    try:
        return gymnasium.make(environment, **(arguments or {}))
    except (gymnasium.error.Error, ModuleNotFoundError, TypeError, KeyError) as error:
        raise ValueError(f"{environment}: {error}") from None


def load_gymnasium(
    environment: Any,
    *,
    fail_states: ArrayLike | None = None,
    fail_if: Condition | None = None,
    arguments: Mapping[str, Any] | None = None,
    normalise: bool = False,
) -> SafeMDP:
    """The model of an environment with a table ``P``.

    Transitions that terminate the episode outside the fail states are harmless ends: their
    target becomes terminal, or they lead to one added terminal state where the episode may
    also pass through the target. The model's rewards are the expected rewards of ``P``. Its
    states are the environment's observations, in their order, and at most two added ones.

    Args:
        environment: an id or an environment, which is not changed; one that steps a safe MDP
            gives that model.
        fail_states: a mask (S,) or numbers of states. Without it and ``fail_if`` the rules
            of a known environment decide.
        fail_if: a condition on (s, a, r, s'), as text or a function; the transitions that
            satisfy it lead to one added fail state.
        arguments: for ``gymnasium.make``.
        normalise: as in :meth:`dead_ends.SafeMDP.stochastic`.

    Raises:
        ValueError: naming the environment, and the state and action at fault; so for a step
            that the table excludes, and for an id whose table is another each time.
        MissingDependencyError: if Gymnasium is not installed.
    """
    env = make_environment(environment, arguments)
    with located(environment_name(environment)):
        unwrapped = env.unwrapped
        own = getattr(unwrapped, "model", None)
        if isinstance(own, SafeMDP) and fail_states is None and fail_if is None:
            return model_of_environment(own, range(own.num_states), table=table_digest(env))
        if not hasattr(unwrapped, "P"):
            raise ValueError("the environment has no transition table P")
        rules = _RULES.get(type(unwrapped).__name__, _Rules())
        if fail_states is None and fail_if is None:
            if rules.fail_states is None and rules.fail_if is None:
                raise ValueError(
                    "which states fail is not known; say it by fail_states (--fail-states) "
                    "or fail_if (--fail-if)"
                )
            fail_if = rules.fail_if
            if rules.fail_states is not None:
                fail_states = rules.fail_states(unwrapped)
        transitions = _describe(_read_table(unwrapped), unwrapped, rules)
        table = table_digest(env)
        if isinstance(environment, str):
            _check_same(table, make_environment(environment, arguments))
        check_steps(unwrapped, transitions)
        if fail_states is not None:
            transitions = replace(transitions, fail=state_mask(fail_states, transitions.num_states))
        estimate = isinstance(own, SafeMDP) and own.estimate
        model = replace(build_model(transitions, fail_if, normalise=normalise), estimate=estimate)
        return model_of_environment(model, range(transitions.num_states), table=table)


def transition_table(env: Any) -> Any:
    """What says how the environment moves: the safe MDP that it steps, or P; None if neither."""
    own = getattr(env.unwrapped, "model", None)
    return own if isinstance(own, SafeMDP) else getattr(env.unwrapped, "P", None)


def table_digest(env: Any) -> str | None:
    """What tells the environment's transition table from another: None if it has none."""
    table = transition_table(env)
    if table is None:
        return None
    return (
        model_digest(table) if isinstance(table, SafeMDP) else _digest(_read_table(env.unwrapped))
    )


def environment_name(environment: Any) -> str:
    """The id, if there is one."""
    if isinstance(environment, str):
        return environment
    spec = getattr(environment, "spec", None)
    return str(environment if spec is None else spec.id)


@dataclass(frozen=True)
class _Rules:
    """What is known of an environment beside its table."""

    fail_states: Callable[[Any], NDArray[np.bool_]] | None = None
    fail_if: str | None = None
    actions: tuple[str, ...] | None = None
    grid: Callable[[Any], tuple[int, int]] | None = None
    """Rows and columns, if state = row * columns + column."""


def _frozen_lake_holes(env: Any) -> NDArray[np.bool_]:
    holes: NDArray[np.bool_] = np.asarray(env.desc).ravel() == b"H"
    return holes


_RULES = {
    "FrozenLakeEnv": _Rules(
        fail_states=_frozen_lake_holes,
        actions=("left", "down", "right", "up"),
        grid=lambda env: np.asarray(env.desc).shape,
    ),
    "CliffWalkingEnv": _Rules(
        fail_if="r <= -100",
        actions=("up", "right", "down", "left"),
        grid=lambda env: env.shape,
    ),
    "TaxiEnv": _Rules(actions=("south", "north", "east", "west", "pick up", "drop off")),
}


def _read_table(env: Any) -> Transitions:
    """``P[s][a]`` as columns. P and its rows may be dictionaries or lists."""
    states = _numbered(env.P, "P")
    space = getattr(env, "action_space", None)
    actions = None if space is None else discrete_range(space, "actions")
    first = 0 if actions is None else actions.start
    rows = [
        (state, action, successor, probability, reward, bool(done))
        for state, row in enumerate(states)
        for action, outcomes in _items(row, state, actions)
        for probability, successor, reward, done in outcomes
    ]
    if not rows:
        raise ValueError("the transition table P is empty")
    source, action, target, probability, reward, done = zip(*rows, strict=True)
    return Transitions(
        source=np.array(source, dtype=np.int64),
        action=np.array(action, dtype=np.int64) - first,
        target=np.array(target, dtype=np.int64),
        probability=np.array(probability, dtype=np.float64),
        reward=np.array(reward, dtype=np.float64),
        done=np.array(done, dtype=np.bool_),
        fail=np.zeros(len(states), dtype=np.bool_),
        terminal=np.zeros(len(states), dtype=np.bool_),
        num_actions=max(action) + 1 if actions is None else len(actions),
        first_action=first,
    )


def _numbered(table: Any, what: str) -> list[Any]:
    if not isinstance(table, Mapping):
        return list(table)
    if sorted(table) != list(range(len(table))):
        raise ValueError(f"the keys of {what} must be 0 to {len(table) - 1}")
    return [table[state] for state in range(len(table))]


def _items(row: Any, state: int, actions: range | None) -> list[tuple[int, Any]]:
    """The environment's actions in a state; a dictionary may leave out those not available."""
    if not isinstance(row, Mapping):
        row = dict(enumerate(row, 0 if actions is None else actions.start))
    if not all(isinstance(action, int | np.integer) for action in row):
        raise ValueError(f"state {state}: the keys of P[{state}] must be numbers of actions")
    for action in row:
        if action < 0 if actions is None else action not in actions:
            known = "0 and more" if actions is None else f"{actions[0]} to {actions[-1]}"
            raise ValueError(f"state {state}: P lists action {action}, but actions are {known}")
    return [(int(action), outcomes) for action, outcomes in row.items()]


def _check_same(table: str | None, again: Any) -> None:
    """An id makes the same table each time, or a model of it would be nobody's."""
    if table_digest(again) != table:
        raise ValueError(
            "the table P is another each time the environment is made, for it is drawn at random; "
            "say what is drawn by arguments (--env-arg), or load an environment that was made"
        )


def _digest(table: Transitions) -> str:
    """SHA-256 of the transitions and of what ends an episode; rewards do not count."""
    content = hashlib.sha256(f"{table.num_states} {table.num_actions}\n".encode())
    for column in (table.source, table.action, table.target, table.probability, table.done):
        content.update(np.ascontiguousarray(column, dtype="<f8").data)
    return content.hexdigest()


def _describe(transitions: Transitions, env: Any, rules: _Rules) -> Transitions:
    """Add the initial distribution, names and geometry."""
    initial = getattr(env, "initial_state_distrib", None)
    first = transitions.first_action
    actions = range(first, first + transitions.num_actions)
    names = rules.actions
    if names is not None and len(names) != transitions.num_actions:
        names = None
    geometry = state_names = None
    if rules.grid is not None:
        rows, columns = rules.grid(env)
        cells = [(column, row) for row, column in product(range(rows), range(columns))]
        geometry = Geometry(
            cell=np.array(cells),
            y_down=True,
            arrows=None if names is None else tuple(_DIRECTIONS[name] for name in names),
        )
        state_names = tuple(f"row {row}, column {column}" for column, row in cells)
    return replace(
        transitions,
        initial=None if initial is None else np.asarray(initial, dtype=np.float64),
        state_names=state_names,
        action_names=names or numerals(actions),
        geometry=geometry,
    )
