"""A list of transitions, as the world outside gives it, and the model that it makes.

Every reader ends here: it lists (s, a, s', probability) and says which states fail; this
module turns transitions that violate a condition into transitions to one added fail state
and picks the storage form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.io.condition import evaluate_condition
from dead_ends.io.errors import warn_no_failure
from dead_ends.model.checks import ExactEntries, mend_rows, plain_array
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = ["Condition", "Transitions", "build_model", "state_mask", "violations"]

Condition = str | Callable[[int, int, float, int], bool]
"""Which transitions are violations: text (see :mod:`dead_ends.io.condition`) or f(s, a, r, s')."""

Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Transitions:
    """N transitions between states, and what is known about the states.

    Attributes:
        source, action, target: (N,) numbers of s, a, s'.
        probability: (N,) floats, or Fractions (dtype object); the entries of one (s, a) and
            s' add up.
        fail, terminal: bool (S,).
        num_actions: A.
        first_action: how conditions count: their ``a`` is ``action + first_action``.
        reward: (N,) or None.
        done: bool (N,), whether the episode ends with the transition; None: never.
        initial: float (S,) or None.
        state_names, action_names, geometry: as in :class:`dead_ends.SafeMDP`.
    """

    source: Integers
    action: Integers
    target: Integers
    probability: NDArray[Any]
    fail: NDArray[np.bool_]
    terminal: NDArray[np.bool_]
    num_actions: int
    first_action: int = 0
    reward: NDArray[np.float64] | None = None
    done: NDArray[np.bool_] | None = None
    initial: NDArray[np.float64] | None = None
    state_names: tuple[str, ...] | None = None
    action_names: tuple[str, ...] | None = None
    geometry: Geometry | None = None

    @property
    def num_states(self) -> int:
        """S."""
        return len(self.fail)


def build_model(
    transitions: Transitions, fail_if: Condition | None = None, *, normalise: bool = False
) -> SafeMDP:
    """The safe MDP that the transitions make.

    Transitions that satisfy ``fail_if`` lead to one added fail state, if they do not enter a
    fail state anyway; where none does, that is warned of. Transitions that end the episode
    elsewhere make their target terminal if nothing else tells against it, see
    :func:`_end_episodes`. ``normalise``: as in :meth:`dead_ends.SafeMDP.stochastic`. The model
    is deterministic if every available action has one successor.

    Raises:
        ValueError: naming the state and action at fault.
    """
    _check_ends(transitions)
    possible = transitions.probability != 0
    if not possible.all():
        transitions = _select(transitions, possible)
    mended = 0
    if normalise:
        row = transitions.source * transitions.num_actions + transitions.action
        probability, mended = mend_rows(row, transitions.probability)
        transitions = replace(transitions, probability=probability)
    rewards = _expected_rewards(transitions)
    if fail_if is not None:
        violates = violations(transitions, fail_if)
        if not violates.any():
            warn_no_failure(f"no transition satisfies {_quoted(fail_if)}")
        violates &= ~transitions.fail[transitions.target]
        if transitions.done is not None:
            transitions = replace(transitions, done=transitions.done & ~violates)
        transitions = _redirect(transitions, violates, "fail", fails=True)
    transitions = _end_episodes(transitions)
    if rewards is not None:
        added = transitions.num_states - len(rewards)
        rewards = np.concatenate((rewards, np.zeros((added, transitions.num_actions))))
    model = _compact(transitions, rewards, normalise)
    return replace(model, normalised=mended + (model.normalised or 0)) if normalise else model


def state_mask(states: ArrayLike, num_states: int) -> NDArray[np.bool_]:
    """A bool (S,) mask of the fail states from a mask or from numbers; none is warned of.

    Raises:
        ValueError: if there is no such state.
    """
    array = plain_array("fail_states", states)
    if array.dtype == np.bool_:
        if array.shape != (num_states,):
            raise ValueError(f"fail states: a mask must have shape ({num_states},)")
        mask = array.copy()
        if not mask.any():
            warn_no_failure("no state is marked in fail_states")
        return mask
    mask = np.zeros(num_states, dtype=np.bool_)
    if not array.size:
        warn_no_failure("no state is listed in fail_states")
    for state in array.ravel().tolist():
        if not isinstance(state, int) or not 0 <= state < num_states:
            raise ValueError(f"fail states: {state} is not a state (0 to {num_states - 1})")
        mask[state] = True
    return mask


def violations(transitions: Transitions, condition: Condition) -> NDArray[np.bool_]:
    """bool (N,): which transitions satisfy the condition."""
    source, target = transitions.source, transitions.target
    action = transitions.action + transitions.first_action
    reward = transitions.reward
    if isinstance(condition, str):
        columns: dict[str, NDArray[Any]] = {"s": source, "a": action, "s2": target}
        if reward is not None:
            columns["r"] = reward
        if transitions.done is not None:
            columns["done"] = transitions.done
        return evaluate_condition(condition, columns)
    if reward is None:
        raise ValueError("the condition needs rewards, and these transitions have none")
    rows = zip(source.tolist(), action.tolist(), reward.tolist(), target.tolist(), strict=True)
    return np.array([bool(condition(*row)) for row in rows], dtype=np.bool_)


def _quoted(condition: Condition) -> str:
    return repr(condition) if isinstance(condition, str) else "the condition (fail_if)"


def _check_ends(transitions: Transitions) -> None:
    """Sources, actions and targets exist, for everything below indexes with them; and no
    negative probability can hide in a sum."""
    for name, index, bound in (
        ("state", transitions.source, transitions.num_states),
        ("action", transitions.action, transitions.num_actions),
        ("successor", transitions.target, transitions.num_states),
    ):
        bad = np.flatnonzero((index < 0) | (index >= bound))
        if len(bad):
            at = int(bad[0])
            raise ValueError(
                f"state {transitions.source[at]}, action {transitions.action[at]}: "
                f"{name} {index[at]} does not exist (0 to {bound - 1})"
            )
    negative = np.flatnonzero(transitions.probability < 0)
    if len(negative):
        at = int(negative[0])
        raise ValueError(
            f"state {transitions.source[at]}, action {transitions.action[at]}: "
            f"negative probability {transitions.probability[at]}"
        )


def _select(transitions: Transitions, keep: NDArray[np.bool_]) -> Transitions:
    columns = ("source", "action", "target", "probability", "reward", "done")
    chosen: dict[str, Any] = {
        name: column[keep] for name in columns if (column := getattr(transitions, name)) is not None
    }
    return replace(transitions, **chosen)


def _expected_rewards(transitions: Transitions) -> NDArray[np.float64] | None:
    """r(s, a) = sum over s' of P(s' | s, a) r(s, a, s'); 0 where nothing is listed."""
    if transitions.reward is None:
        return None
    row = transitions.source * transitions.num_actions + transitions.action
    weights = transitions.probability.astype(np.float64) * transitions.reward
    rows = transitions.num_states * transitions.num_actions
    total = np.bincount(row, weights, rows).astype(np.float64)
    return total.reshape(transitions.num_states, transitions.num_actions)


def _end_episodes(transitions: Transitions) -> Transitions:
    """Let the transitions that end an episode end it in the model too.

    The target becomes terminal if the episode never continues there: every transition into
    it from another state ends the episode, and no episode starts there. Otherwise these
    transitions go to one added terminal state "done", for the target's own actions must not
    count after them.
    """
    done = transitions.done
    if done is None:
        return transitions
    # Nothing leaves a state that has ended, and failing ends the episode by itself.
    counts = ~transitions.fail[transitions.source] & ~transitions.terminal[transitions.source]
    ends = counts & done & ~(transitions.fail | transitions.terminal)[transitions.target]
    continues = counts & ~done & (transitions.source != transitions.target)
    entered = np.zeros(transitions.num_states, dtype=np.bool_)
    entered[transitions.target[continues]] = True
    if transitions.initial is not None:
        entered |= transitions.initial > 0
    goal = np.zeros_like(entered)
    goal[transitions.target[ends & (transitions.source != transitions.target)]] = True
    goal &= ~entered
    transitions = replace(transitions, terminal=transitions.terminal | goal)
    return _redirect(transitions, ends & ~goal[transitions.target], "done", fails=False)


def _redirect(
    transitions: Transitions, chosen: NDArray[np.bool_], name: str, *, fails: bool
) -> Transitions:
    """Let the chosen transitions lead to one added state that ends the episode."""
    if not chosen.any():
        return transitions
    added = transitions.num_states
    names = transitions.state_names
    initial, geometry = transitions.initial, transitions.geometry
    if geometry is not None:
        geometry = replace(geometry, cell=np.append(geometry.cell, [[-1, -1]], axis=0))
    return replace(
        transitions,
        target=np.where(chosen, added, transitions.target),
        fail=np.append(transitions.fail, fails),
        terminal=np.append(transitions.terminal, not fails),
        initial=None if initial is None else np.append(initial, 0.0),
        state_names=None if names is None else (*names, name),
        geometry=geometry,
    )


def _compact(
    transitions: Transitions, rewards: NDArray[np.float64] | None, normalise: bool
) -> SafeMDP:
    """The model in the form that suits it: a table if every action has one successor."""
    num_states, num_actions = transitions.num_states, transitions.num_actions
    row = transitions.source * num_actions + transitions.action
    available = np.zeros(num_states * num_actions, dtype=np.bool_)
    available[row] = True
    keywords: dict[str, Any] = {
        "terminal": transitions.terminal,
        "rewards": rewards,
        "initial": transitions.initial,
        "state_names": transitions.state_names,
        "action_names": transitions.action_names,
        "geometry": transitions.geometry,
        "normalise": normalise,
    }
    model = SafeMDP.stochastic(
        _kernel(transitions, row),
        transitions.fail,
        available.reshape(num_states, num_actions),
        **keywords,
    )
    kernel = model.transitions()
    if kernel.nnz != np.count_nonzero(model.available):
        return model
    table = np.full(num_states * num_actions, -1, dtype=np.int32)
    table[np.diff(kernel.indptr) == 1] = kernel.indices
    return SafeMDP.deterministic(
        table.reshape(num_states, num_actions), transitions.fail, **keywords
    )


def _kernel(transitions: Transitions, row: Integers) -> Any:
    rows = transitions.num_states * transitions.num_actions
    if transitions.probability.dtype != object:
        from scipy import sparse

        entries = (transitions.probability, (row, transitions.target))
        return sparse.coo_array(entries, shape=(rows, transitions.num_states))
    return ExactEntries(
        row, transitions.target, transitions.probability, (rows, transitions.num_states)
    )
