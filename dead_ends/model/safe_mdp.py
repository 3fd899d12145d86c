"""Safe Markov decision processes (Definition 1 of the paper, "SMDP").

A safe MDP is a finite MDP in which an episode ends at the first safety violation. The
violation is entering a fail state: the cost of a transition is 1 if it enters ``fail``
and 0 otherwise (the paper's cost function, C(s, a, s') = I(s' in S_fail)).

Two storage forms, one class:

* deterministic: a table ``next_state[s, a]`` (int32, -1 where an action is not available);
* stochastic: a sparse kernel of shape (S*A, S) whose row ``s*A + a`` is P(. | s, a).

Two kinds of states end an episode. ``fail`` states are violations; they have no actions.
``terminal`` states are goals (or deadlocks that do no harm): safe and absorbing, every
action stays there at no cost. What the input says about their rows is ignored.

Models are frozen: every array is read-only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.model.checks import (
    MAX_STATES,
    Names,
    available_mask,
    available_rows,
    check_successors,
    count_actions,
    end_masks,
    initial_distribution,
    named,
    plain_array,
    read_only,
    reward_table,
    successor_table,
    transition_array,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["Geometry", "SafeMDP", "require_type"]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Where a state is drawn: a cell of a picture.

    Attributes:
        cell: int (S, 2), column and row of each state's cell; (-1, -1): not drawn.
        x_label, y_label: names of the axes, with units.
        origin, step: coordinates (x, y) of the centre of cell (0, 0), and a cell's size.
        y_down: row 0 is drawn at the top (grid maps) instead of the bottom (diagrams).
        walls: cells that belong to no state, drawn as walls.
        arrows: one direction (dx, dy) an action in picture units, y upward; (0, 0) draws
            a dot. None where actions have no direction.
    """

    cell: NDArray[np.int32]
    x_label: str = "column"
    y_label: str = "row"
    origin: tuple[float, float] = (0.0, 0.0)
    step: tuple[float, float] = (1.0, 1.0)
    y_down: bool = False
    walls: tuple[tuple[int, int], ...] = ()
    arrows: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        cell = np.array(self.cell, dtype=np.int32)
        if cell.ndim != 2 or cell.shape[1] != 2:
            raise ValueError(f"geometry: cell must have shape (S, 2), not {cell.shape}")
        object.__setattr__(self, "cell", read_only(cell))


@dataclass(frozen=True, eq=False, repr=False)
class SafeMDP:
    """A finite safe MDP; built by :meth:`deterministic` or :meth:`stochastic`.

    Attributes:
        next_state: int32 (S, A), -1 where an action is not available; None if stochastic.
            Rows of fail and terminal states may hold anything: read them through
            ``available`` and ``terminal``.
        kernel: CSR (S*A, S), row s*A + a is P(. | s, a); None if deterministic. Rows of
            unavailable actions and of fail states are empty, those of terminal states
            are self-loops.
        exact: the probabilities as Fractions, aligned with ``kernel.data``, if the model
            was given in Fractions; else None.
        fail: bool (S,), the violations S_fail.
        terminal: bool (S,), goals: safe and absorbing.
        rewards: float (S, A), the task's reward, or None.
        initial: float (S,), the distribution of the first state, or None.
        state_names, action_names: optional names.
        geometry: where states are drawn, or None.
        estimate: whether the probabilities are estimates, as of a model from a log
            (:func:`dead_ends.estimate_model`). What follows from an estimate is no guarantee
            about the task: what would promise one refuses it.
        normalised: how many rows (and the initial distribution) were divided by their sums;
            None if that was not asked for.
    """

    next_state: NDArray[np.int32] | None
    kernel: csr_array[np.float64] | None
    exact: tuple[Fraction, ...] | None
    fail: NDArray[np.bool_]
    terminal: NDArray[np.bool_]
    num_actions: int
    rewards: NDArray[np.float64] | None = None
    initial: NDArray[np.float64] | None = None
    state_names: tuple[str, ...] | None = None
    action_names: tuple[str, ...] | None = None
    geometry: Geometry | None = None
    estimate: bool = False
    normalised: int | None = None
    _available: NDArray[np.bool_] | None = field(default=None)

    @classmethod
    def deterministic(
        cls,
        next_state: ArrayLike,
        fail: ArrayLike,
        *,
        terminal: ArrayLike | None = None,
        rewards: ArrayLike | None = None,
        initial: ArrayLike | None = None,
        state_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        geometry: Geometry | None = None,
        normalise: bool = False,
    ) -> SafeMDP:
        """A deterministic safe MDP from its successor table.

        Args:
            next_state: integers (S, A); -1, or masked, where an action is not available. A
                C-ordered int32 array is adopted without a copy and marked read-only; any
                other is copied once.
            fail: bool (S,). Rows of fail states are ignored: the episode has ended.
            terminal: bool (S,), goals: safe and absorbing, their rows are ignored.
            rewards: finite float (S, A), for :func:`dead_ends.safety.planning.plan`.
            initial: the first state: indices, a bool mask (S,), or a distribution (S,).
            state_names, action_names: S and A names.
            geometry: where states are drawn.
            normalise: divide a distribution ``initial`` by its sum, as for :meth:`stochastic`.

        Raises:
            ValueError: naming the state and action at fault.
        """
        table = successor_table(next_state, fail)
        num_states, num_actions = table.shape
        fail_mask, terminal_mask = end_masks(fail, terminal, num_states)
        names = Names(state_names, action_names, num_states, num_actions)
        check_successors(table, fail_mask | terminal_mask, names)
        if table.dtype == np.int32 and table.flags.c_contiguous:
            adopted = table
        else:
            # Rows of fail and terminal states are not checked: they may not fit int32.
            adopted = np.clip(table, -1, MAX_STATES).astype(np.int32, order="C")
        first, mended = initial_distribution(initial, num_states, normalise)
        return cls(
            kernel=None,
            exact=None,
            fail=fail_mask,
            terminal=terminal_mask,
            num_actions=num_actions,
            rewards=reward_table(rewards, num_states, num_actions, names),
            initial=first,
            state_names=names.states,
            action_names=names.actions,
            geometry=_geometry(geometry, num_states, num_actions),
            normalised=mended if normalise else None,
            # Marked last: where something is refused, the caller's array stays as it was.
            next_state=read_only(adopted),
        )

    @classmethod
    def stochastic(
        cls,
        P: Any,
        fail: ArrayLike,
        available: ArrayLike | None = None,
        *,
        terminal: ArrayLike | None = None,
        rewards: ArrayLike | None = None,
        initial: ArrayLike | None = None,
        state_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        geometry: Geometry | None = None,
        normalise: bool = False,
    ) -> SafeMDP:
        """A stochastic safe MDP from its transition probabilities.

        Args:
            P: dense (S, A, S), of floats or of Fractions (then the model is exact), or
                scipy.sparse (S*A, S) with row s*A + a. Stored zeros are dropped; an action
                whose row is masked is not available.
            fail: bool (S,). Rows of fail states are ignored: the episode has ended.
            available: bool (S, A); without it every row of a state that is neither fail
                nor terminal must be a distribution. Rows of unavailable actions are
                ignored.
            terminal, rewards, initial, state_names, action_names, geometry: as in
                :meth:`deterministic`.
            normalise: divide rows that miss 1 by the rounding of six digits or float32 (by
                1e-6, or 5e-7 an entry if there are more than two) by their sums;
                :attr:`normalised` counts them, and what is left of rounding is divided out
                of :meth:`exact_probabilities`.

        Raises:
            ValueError: naming the state and action at fault: a negative or NaN
                probability, a row that does not sum to 1 within 1e-9 (exactly, for
                Fractions), a state that is neither fail nor terminal without an action.
        """
        from dead_ends.model.transition_matrix import build_kernel

        fail_array = plain_array("fail", fail)
        num_states = fail_array.shape[0] if fail_array.ndim == 1 else -1
        if num_states < 0:
            raise ValueError(f"fail must have shape (S,), not {fail_array.shape}")
        fail_mask, terminal_mask = end_masks(fail, terminal, num_states)
        P = transition_array(P)
        num_actions = count_actions(P, num_states)
        names = Names(state_names, action_names, num_states, num_actions)
        P, available = available_rows(P, available, fail_mask | terminal_mask, names)
        mask = available_mask(available, fail_mask, terminal_mask, num_actions, names)
        kernel, exact, mended = build_kernel(P, mask, terminal_mask, names.pair, normalise)
        first, mended_first = initial_distribution(initial, num_states, normalise)
        return cls(
            next_state=None,
            kernel=kernel,
            exact=exact,
            fail=fail_mask,
            terminal=terminal_mask,
            num_actions=num_actions,
            rewards=reward_table(rewards, num_states, num_actions, names),
            initial=first,
            state_names=names.states,
            action_names=names.actions,
            geometry=_geometry(geometry, num_states, num_actions),
            normalised=mended + mended_first if normalise else None,
            _available=mask,
        )

    @property
    def num_states(self) -> int:
        """S, the number of states."""
        return len(self.fail)

    @property
    def is_deterministic(self) -> bool:
        """Whether the model is stored as a successor table."""
        return self.next_state is not None

    @property
    def available(self) -> NDArray[np.bool_]:
        """bool (S, A): the actions one can take. None in fail states, all in terminal ones."""
        if self._available is not None:
            return self._available
        assert self.next_state is not None
        mask: NDArray[np.bool_] = self.next_state >= 0
        mask[self.fail] = False
        mask[self.terminal] = True
        return read_only(mask)

    def successors(self) -> NDArray[np.int32]:
        """int32 (S, A): ``next_state`` with fail rows -1 and terminal rows self-loops.

        A copy; for deterministic models only.
        """
        if self.next_state is None:
            raise ValueError("successors: the model is stochastic; use transitions()")
        table = self.next_state.copy()
        table[self.fail] = -1
        table[self.terminal] = np.flatnonzero(self.terminal)[:, None]
        return table

    def transitions(self) -> csr_array[np.float64]:
        """CSR (S*A, S): P(. | s, a) in row s*A + a, for either storage form.

        Rows of unavailable actions and of fail states are empty.
        """
        if self.kernel is not None:
            return self.kernel
        from dead_ends.model.transition_matrix import table_kernel

        return table_kernel(self.successors())

    def exact_probabilities(self) -> tuple[Fraction, ...]:
        """The probabilities of ``transitions().data`` as Fractions.

        Fractions are taken as given; a float is read as its shortest decimal (0.1 is
        1/10), and divided by its row's sum if the model was made with ``normalise=True``.

        Raises:
            ValueError: naming the state and action whose row does not sum to exactly 1.
        """
        if self.exact is not None:
            return self.exact
        from dead_ends.model.transition_matrix import exact_data

        names = Names(self.state_names, self.action_names, self.num_states, self.num_actions)
        return exact_data(self.transitions(), names.pair, self.normalised is not None)

    def state_name(self, state: int) -> str:
        """The state for a sentence: its number, and its name if it has one."""
        return named("state", state, self.state_names)

    def action_name(self, action: int) -> str:
        """The action for a sentence: its number, and its name if it has one."""
        return named("action", action, self.action_names)

    def refuse_estimate(self, promise: str) -> None:
        """Say that a promise cannot be made, if the model is an estimate.

        Raises:
            ValueError: naming the promise.
        """
        if self.estimate:
            raise ValueError(
                f"{promise} would be no promise about the task: the model is an estimate from a log"
            )

    def __repr__(self) -> str:
        kind = "deterministic" if self.is_deterministic else "stochastic"
        ends = f"{int(self.fail.sum()):,} fail, {int(self.terminal.sum()):,} terminal"
        kind += ", an estimate" if self.estimate else ""
        rows = f", {self.normalised:,} rows normalised" if self.normalised else ""
        sizes = f"{self.num_states:,} states, {self.num_actions} actions"
        return f"SafeMDP({kind}, {sizes}, {ends}{rows})"


def _geometry(geometry: Geometry | None, num_states: int, num_actions: int) -> Geometry | None:
    if geometry is None:
        return None
    require_type(geometry, Geometry, "geometry")
    if len(geometry.cell) != num_states:
        raise ValueError(f"geometry: expected {num_states} cells, got {len(geometry.cell)}")
    if geometry.arrows is not None and len(geometry.arrows) != num_actions:
        raise ValueError(f"geometry: expected {num_actions} arrows, got {len(geometry.arrows)}")
    return geometry


def require_type(value: object, kind: type, where: str) -> None:
    """Refuse what a function cannot take.

    Raises:
        TypeError: naming the type wanted, and what makes it.
    """
    if not isinstance(value, kind):
        made = _MADE_BY.get(kind.__name__, "")
        raise TypeError(f"{where} takes a {kind.__name__}{made}, not {type(value).__name__}")


_MADE_BY = {
    "SafeMDP": " (SafeMDP.deterministic and SafeMDP.stochastic make one of arrays)",
    "Values": " (value_iteration and evaluate_policy make them)",
    "Labelling": " (classify makes one)",
    "Certificate": " (certify makes one)",
    "FilterTable": " (safety_filter makes one)",
    "ExpectedSurvival": " (expected_survival makes one)",
}
