"""Why a state is what it is: its label with a witness, in a sentence.

    safe       an action that stays safe, and where it leads: to a goal, or round a cycle
    dead       the longest surviving path to failure, of T(s) steps
    at risk    bounds on P_min(F fail), an action that attains it, a path to failure although
               the agent does its best, and a path to the safe states
    fail       the violation itself

Definition 2 of the paper names the subsets; a state at risk, which only stochastic models
have, belongs to the paper's S_safe. A dead state of a stochastic model that may survive any
number of steps has no longest path: its shortest path to failure is shown.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dead_ends.labels.classification import classify, safe_actions
from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.safe_mdp import SafeMDP, require_type
from dead_ends.safety.policies import recovery_policy
from dead_ends.values.bellman import value_iteration

__all__ = ["Explanation", "Path", "explain", "state_index"]

SHOWN = 6
"""A path with more states than this is abbreviated in sentences."""

P_MIN_TOLERANCE = 1e-6
"""How far apart the bounds on P_min may be: about the digits that a sentence shows."""


@dataclass(frozen=True)
class Path:
    """A path through the model, with positive probability.

    Attributes:
        states: the states in order.
        actions: the action taken in each but the last.
        cycle_start: where in ``states`` the last state has been before, if the path ends by
            closing a cycle; else None.
    """

    states: tuple[int, ...]
    actions: tuple[int, ...]
    cycle_start: int | None = None


@dataclass(frozen=True)
class Explanation:
    """Why a state is what it is.

    Attributes:
        state: the state.
        label: what it is.
        survival_time: T, the most steps until failure (0 on fail states); None if there is no
            such number.
        action: safe: an action that stays safe; at risk: one that attains P_min (as far as
            floating point tells); dead: the first of ``path``, if it survives longest; None
            where the episode has ended.
        path: safe: where that action and its like lead, to a terminal state or round a cycle
            (in a stochastic model one of the possible paths); dead: a longest surviving path
            to failure, or the shortest path if there is no longest; at risk: a shortest path
            to failure under best actions; fail: the state alone.
        safe_path: at risk: a shortest path to the safe states; else None.
        p_min: at risk: bounds on the least probability of failing; else None.
        text: all this in one or two sentences; long paths are abbreviated.
    """

    state: int
    label: Label
    survival_time: int | None
    action: int | None
    path: Path
    safe_path: Path | None
    p_min: tuple[float, float] | None
    text: str


def explain(
    model: SafeMDP,
    state: int | str,
    labelling: Labelling | None = None,
    *,
    exact: bool = False,
) -> Explanation:
    """Why a state is safe, dead, at risk or fail.

    Args:
        model: the model.
        state: its index, or its name (or its index as text).
        labelling: ``classify(model)``, if at hand.
        exact: find P_min in Fractions; its bounds are then the floats next to it.

    Raises:
        ValueError: if there is no such state, if the name belongs to several, or if floats do
            not tell P_min.
    """
    require_type(model, SafeMDP, "explain")
    if labelling is not None:
        require_type(labelling, Labelling, "explain")
    index = state_index(model, state)
    if labelling is None:
        labelling = classify(model)
    explanation = _explain(model, index, labelling, exact)
    if not model.estimate:
        return explanation
    caution = "This is said of an estimate from a log; of the task it may not be true."
    return replace(explanation, text=f"{explanation.text} {caution}")


def _explain(model: SafeMDP, index: int, labelling: Labelling, exact: bool) -> Explanation:
    label = Label(int(labelling.labels[index]))
    name = model.state_name(index)
    if label is Label.FAIL:
        text = f"{_capital(name)} is fail: the violation has happened and the episode is over."
        return Explanation(index, label, 0, None, Path((index,), ()), None, None, text)
    if label is Label.DEAD:
        return _explain_dead(model, index, labelling)
    if label is Label.SAFE:
        return _explain_safe(model, index, labelling)
    return _explain_at_risk(model, index, labelling, exact)


def state_index(model: SafeMDP, state: int | str) -> int:
    """The index of a state given by its index, its name, or its index as text.

    Raises:
        ValueError: if there is no such state, or if the name belongs to several.
    """
    if isinstance(state, str) and model.state_names is not None:
        found = [i for i, name in enumerate(model.state_names) if name == state]
        if len(found) > 1:
            raise ValueError(
                f"state {state}: {len(found)} states have that name, such as {found[0]} and "
                f"{found[1]}; give the number"
            )
        if found:
            return found[0]
    is_number = isinstance(state, (int, np.integer)) and not isinstance(state, bool)
    if is_number or (isinstance(state, str) and state.isdecimal()):
        index = int(state)
        if 0 <= index < model.num_states:
            return index
    named = "" if model.state_names is None else " and no state has that name"
    raise ValueError(f"state {state}: states are numbered 0 to {model.num_states - 1}{named}")


def _explain_dead(model: SafeMDP, state: int, labelling: Labelling) -> Explanation:
    time = int(labelling.survival_time[state])
    name = _capital(model.state_name(state))
    if time == INFINITE:
        path = _shortest_path(model, state, model.fail, model.available)
        text = (
            f"{name} is dead: whatever the agent does it fails with probability 1, although "
            f"there is no bound on how long it may survive. The shortest path to failure is "
            f"{_shown(model, path)}."
        )
        return Explanation(state, Label.DEAD, None, None, path, None, None, text)
    path = _longest_path(model, state, labelling.survival_time)
    within = "in the next step" if time == 1 else f"within {time} steps"
    text = (
        f"{name} is dead: whatever the agent does, it fails {within}. "
        f"The longest surviving path is {_shown(model, path)}."
    )
    return Explanation(state, Label.DEAD, time, path.actions[0], path, None, None, text)


def _explain_safe(model: SafeMDP, state: int, labelling: Labelling) -> Explanation:
    name = _capital(model.state_name(state))
    if model.terminal[state]:
        text = f"{name} is safe: it is terminal, the episode ends there without a violation."
        return Explanation(state, Label.SAFE, None, None, Path((state,), ()), None, None, text)
    path = _staying_path(model, state, safe_actions(model, labelling))
    action = path.actions[0]
    text = (
        f"{name} is safe: {model.action_name(action)} keeps it safe. "
        f"{'One possible' if not model.is_deterministic else 'The'} way on is "
        f"{_shown(model, path)}, {_ending(path)}."
    )
    return Explanation(state, Label.SAFE, None, action, path, None, None, text)


def _explain_at_risk(model: SafeMDP, state: int, labelling: Labelling, exact: bool) -> Explanation:
    # undiscounted: the least probability of failing
    values = value_iteration(model, 1.0, exact=exact, tolerance=P_MIN_TOLERANCE)
    p_min = _float_bounds(values.V_lower[state], values.V_upper[state])
    best = recovery_policy(values)
    follows = np.zeros((model.num_states, model.num_actions), dtype=np.bool_)
    follows[np.arange(model.num_states), best] = True
    path = _shortest_path(model, state, model.fail, follows & model.available)
    safe_path = _shortest_path(model, state, labelling.safe, model.available)
    action = int(best[state])
    text = (
        f"{_capital(model.state_name(state))} is at risk: acting best it fails with "
        f"probability {_interval(p_min)}, beginning with {model.action_name(action)}. "
        f"Even so it may fail, by {_shown(model, path)}; "
        f"it may reach safety by {_shown(model, safe_path)}."
    )
    return Explanation(state, Label.AT_RISK, None, action, path, safe_path, p_min, text)


def _longest_path(model: SafeMDP, state: int, time: NDArray[np.int32]) -> Path:
    """From T to 0 one by one: each state has a successor that survives one step less."""
    states, actions = [state], []
    while not model.fail[state]:
        action, state = next(
            (action, successor)
            for action in _actions(model, state)
            for successor in _successors(model, state, action)
            if time[successor] == time[state] - 1
        )
        states.append(state)
        actions.append(action)
    return Path(tuple(states), tuple(actions))


def _staying_path(model: SafeMDP, state: int, stays: NDArray[np.bool_]) -> Path:
    """The first safe action and its first successor, until the path ends or repeats."""
    states, actions, visited = [state], [], {state: 0}
    while not model.terminal[state]:
        action = int(stays[state].argmax())
        state = _successors(model, state, action)[0]
        states.append(state)
        actions.append(action)
        if state in visited:
            return Path(tuple(states), tuple(actions), visited[state])
        visited[state] = len(states) - 1
    return Path(tuple(states), tuple(actions))


def _shortest_path(
    model: SafeMDP, start: int, goal: NDArray[np.bool_], choices: NDArray[np.bool_]
) -> Path:
    """A shortest path that takes only ``choices``, breadth first; there is one."""
    reached: dict[int, tuple[int, int]] = {start: (-1, -1)}
    queue = deque([start])
    while not goal[state := queue.popleft()]:
        for action in np.flatnonzero(choices[state]).tolist():
            for successor in _successors(model, state, action):
                if successor not in reached:
                    reached[successor] = (state, action)
                    queue.append(successor)
    states, actions = [state], []
    while state != start:
        state, action = reached[state]
        states.append(state)
        actions.append(action)
    return Path(tuple(states[::-1]), tuple(actions[::-1]))


def _actions(model: SafeMDP, state: int) -> list[int]:
    return [a for a in range(model.num_actions) if _successors(model, state, a)]


def _successors(model: SafeMDP, state: int, action: int) -> list[int]:
    """The states that may follow, none if the action is not available."""
    if model.fail[state]:
        return []
    if model.next_state is not None:
        successor = state if model.terminal[state] else int(model.next_state[state, action])
        return [successor] if successor >= 0 else []
    assert model.kernel is not None
    row = state * model.num_actions + action
    return [int(s) for s in model.kernel.indices[slice(*model.kernel.indptr[row : row + 2])]]


def _ending(path: Path) -> str:
    if path.cycle_start is None:
        return "where the episode ends without a violation"
    length = len(path.states) - 1 - path.cycle_start
    if length == 1:
        return "where it can stay for ever"
    return f"which closes a cycle of {length} steps"


def _shown(model: SafeMDP, path: Path) -> str:
    """The path for a sentence: names where there are any, the middle of a long one left out."""
    states = [
        str(s) if model.state_names is None else f"({model.state_names[s]})" for s in path.states
    ]
    if len(states) > SHOWN:
        kept = SHOWN // 2
        states[kept:-kept] = [f"... {len(states) - 2 * kept} more ..."]
    return " -> ".join(states)


def _float_bounds(lower: float | Fraction, upper: float | Fraction) -> tuple[float, float]:
    """Floats that enclose two numbers, as closely as floats can."""
    below, above = float(lower), float(upper)
    return (
        below if below <= lower else math.nextafter(below, 0.0),
        above if above >= upper else math.nextafter(above, 1.0),
    )


def _interval(bounds: tuple[float, float]) -> str:
    """Six digits if they agree, else both bounds."""
    lower, upper = (f"{bound:.6g}" for bound in bounds)
    return lower if lower == upper else f"between {bounds[0]:.9g} and {bounds[1]:.9g}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
