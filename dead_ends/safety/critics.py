"""What a decision is taken on: values within bounds, or a table that says it has none.

Q(s, a) < epsilon_safe decides whether an action passes, so a rounded Q near the threshold may
decide wrongly. The bounds of :class:`dead_ends.Values` tell when it would. A bare table has no
bounds; whoever trusts its numbers as they are writes :func:`unguarded`.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dead_ends.model.checks import plain_array, read_only
from dead_ends.values.values import Values

__all__ = ["Unguarded", "critic_table", "require_critic", "unguarded"]


@dataclass(frozen=True, eq=False)
class Unguarded:
    """A critic without bounds, as :func:`unguarded` makes it.

    Attributes:
        Q: (S, A), floats, or objects such as Fractions; read-only.
    """

    Q: NDArray[Any]


def unguarded(Q: ArrayLike) -> Unguarded:
    """A bare table as a critic: its numbers decide as they are, with no bounds to guard them.

        >>> import numpy as np
        >>> from dead_ends import allowed_actions, unguarded
        >>> allowed_actions(unguarded(np.array([[0.0, 0.9]])), 0.5)
        array([[ True, False]])

    Args:
        Q: (S, A), numbers or Fractions; +inf for actions that are not available. It is copied.

    Raises:
        ValueError: if Q is no table of real numbers, or has a NaN; the message names the place.
    """
    return Unguarded(read_only(_checked_table(Q).copy()))


def require_critic(Q: object, where: str) -> None:
    """Refuse what cannot decide.

    Raises:
        TypeError: naming what makes a critic, also of a bare table.
    """
    if not isinstance(Q, Values | Unguarded):
        raise TypeError(
            f"{where} takes a Values (value_iteration and evaluate_policy make them; of a bare "
            f"table, which has no bounds, unguarded(Q) makes a critic), not {type(Q).__name__}"
        )


def critic_table(Q: ArrayLike | Values | Unguarded) -> NDArray[Any]:
    """The checked table Q (S, A) of a critic: float64 (or longer), or objects such as Fractions.

    A value that underflowed to 0 although its state is lost is replaced by its upper bound, so
    that it is never taken for the 0 of a safe action.

    Raises:
        ValueError: if Q is no table of real numbers, or has a NaN; the message names the place.
    """
    if isinstance(Q, Values):
        table = _checked_table(Q.Q)
        if Q.exact:
            return table
        underflowed = (table == 0) & (Q.Q_upper > 0)
        return np.where(underflowed, Q.Q_upper, table) if underflowed.any() else table
    return Q.Q if isinstance(Q, Unguarded) else _checked_table(Q)


def _checked_table(Q: ArrayLike) -> NDArray[Any]:
    table = plain_array("Q", Q)
    if table.shape == () and table.dtype == object:
        raise TypeError(f"Q must be Values or a table (S, A), not {type(Q).__name__}")
    if table.ndim != 2 or 0 in table.shape:
        raise ValueError(f"Q must have shape (S, A), not {table.shape}")
    if table.dtype.kind in "iuf":
        table = table.astype(np.result_type(table.dtype, np.float64), copy=False)
    elif table.dtype == object:
        _check_real(table)
    else:
        raise ValueError(f"Q must hold floats or Fractions, not {table.dtype}")
    nan = np.argwhere(np.asarray(table != table, dtype=np.bool_))
    if len(nan):
        raise ValueError(f"Q: state {nan[0][0]}, action {nan[0][1]} is NaN")
    return table


def _check_real(table: NDArray[np.object_]) -> None:
    for (state, action), value in np.ndenumerate(table):
        if not isinstance(value, Real) or isinstance(value, bool):
            raise ValueError(f"Q: state {state}, action {action} is {value!r}, not a number")
