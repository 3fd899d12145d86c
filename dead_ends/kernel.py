"""The sparse kernel of a stochastic model: building, checking, exact probabilities.

Row s*A + a of a kernel is P(. | s, a). Kept apart from :mod:`dead_ends.model` because
scipy.sparse is imported only by those who need it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.model_input import ROW_SUM_TOLERANCE

Csr: TypeAlias = "sparse.csr_array[np.float64]"
NamePair = Callable[[int, int], str]


def build_kernel(
    P: Any, available: NDArray[np.bool_], terminal: NDArray[np.bool_], name: NamePair
) -> tuple[Csr, tuple[Fraction, ...] | None]:
    """The checked kernel of ``P`` and, if P holds Fractions, its exact data.

    Rows of unavailable actions (and so of fail states) are emptied, those of terminal
    states replaced by self-loops, stored zeros dropped.
    """
    num_states, num_actions = available.shape
    if not sparse.issparse(P):
        P = np.asarray(P)
        if P.dtype == object:
            return _build_exact(P, available, terminal, name)
        _check_kind(P.dtype)
        P = sparse.csr_array(P.reshape(num_states * num_actions, num_states))
    _check_kind(P.dtype)
    kernel = sparse.csr_array(P, dtype=np.float64, copy=True)
    _check_indices(kernel, num_actions, name)
    kernel.sum_duplicates()
    kernel = _normalise(kernel, available, terminal)
    _check_probabilities(kernel, num_actions, name)
    _check_sums(kernel, available, name)
    return _freeze(kernel), None


def table_kernel(successors: NDArray[np.int32]) -> Csr:
    """The kernel of a successor table (S, A), -1 where an action is not available."""
    num_states, num_actions = successors.shape
    flat = successors.ravel()
    indptr = np.concatenate(([0], np.cumsum(flat >= 0)))
    indices = flat[flat >= 0]
    data = np.ones(len(indices))
    shape = (num_states * num_actions, num_states)
    return _freeze(sparse.csr_array((data, indices, indptr), shape=shape))


def exact_data(kernel: Csr, name: NamePair) -> tuple[Fraction, ...]:
    """Each stored float as its shortest decimal; every non-empty row sums to exactly 1."""
    data = tuple(Fraction(repr(float(p))) for p in kernel.data)
    num_actions = kernel.shape[0] // kernel.shape[1]
    try:
        _check_exact_sums(data, kernel.indptr, num_actions, name)
    except ValueError as error:
        raise ValueError(
            f"{error}: exactly, a float is its shortest decimal; give the model in fractions"
        ) from None
    return data


def select_rows(
    kernel: Csr, exact: tuple[Fraction, ...] | None, rows: NDArray[np.integer[Any]]
) -> tuple[Csr, tuple[Fraction, ...] | None]:
    """The kernel whose row i is row ``rows[i]`` of the given one, and its exact data."""
    selected = _freeze(kernel[rows])
    if exact is None:
        return selected, None
    spans = zip(kernel.indptr[rows], kernel.indptr[rows + 1], strict=True)
    return selected, tuple(p for start, stop in spans for p in exact[start:stop])


def _build_exact(
    P: NDArray[np.object_],
    available: NDArray[np.bool_],
    terminal: NDArray[np.bool_],
    name: NamePair,
) -> tuple[Csr, tuple[Fraction, ...]]:
    """A dense array of Fractions: nothing is rounded before the checks."""
    num_states, num_actions = available.shape
    indptr, indices, data = [0], [], []
    for state in range(num_states):
        for action in range(num_actions):
            if terminal[state]:
                indices.append(state)
                data.append(Fraction(1))
            elif available[state, action]:
                for successor, p in enumerate(P[state, action]):
                    p = _fraction(p, state, action, name)
                    if p:
                        indices.append(successor)
                        data.append(p)
            indptr.append(len(indices))
    exact = tuple(data)
    kernel = sparse.csr_array(
        (
            # What is possible stays so: no Fraction is rounded to 0.
            np.array([max(float(p), math.ulp(0.0)) for p in exact]),
            np.array(indices, dtype=np.int32),
            np.array(indptr),
        ),
        shape=(num_states * num_actions, num_states),
    )
    empty = np.diff(kernel.indptr) == 0
    _raise_first(empty & available.ravel(), num_actions, name, "probabilities sum to 0, not 1")
    _check_exact_sums(exact, kernel.indptr, num_actions, name)
    return _freeze(kernel), exact


def _fraction(p: Any, state: int, action: int, name: NamePair) -> Fraction:
    try:
        value = Fraction(repr(float(p))) if isinstance(p, float) else Fraction(p)
    except (TypeError, ValueError):
        raise ValueError(f"{name(state, action)}: {p!r} is not a probability") from None
    if value < 0:
        raise ValueError(f"{name(state, action)}: negative probability {value}")
    return value


def _check_kind(dtype: np.dtype[Any]) -> None:
    if dtype.kind not in "biuf":
        raise ValueError(f"P must hold real numbers (or, if dense, Fractions), not {dtype}")


def _check_indices(kernel: Csr, num_actions: int, name: NamePair) -> None:
    """scipy does not check what it is given: indices out of range would be read as they are."""
    try:
        kernel.check_format(full_check=True)
    except ValueError as error:
        bad = (kernel.indices < 0) | (kernel.indices >= kernel.shape[1])
        if not bad.any():
            raise ValueError(f"P is not a valid sparse matrix: {error}") from None
        entry = int(np.flatnonzero(bad)[0])
        row = int(np.searchsorted(kernel.indptr, entry, side="right")) - 1
        raise ValueError(
            f"{name(*divmod(row, num_actions))}: successor {kernel.indices[entry]} is not a state"
        ) from None


def _normalise(kernel: Csr, available: NDArray[np.bool_], terminal: NDArray[np.bool_]) -> Csr:
    num_actions = available.shape[1]
    ends = np.repeat(terminal, num_actions)
    keep = available.ravel() & ~ends
    rows = np.repeat(np.arange(len(keep)), np.diff(kernel.indptr))
    stays = keep[rows] & (kernel.data != 0)
    loop_rows = np.flatnonzero(ends)
    result = sparse.coo_array(
        (
            np.concatenate((kernel.data[stays], np.ones(len(loop_rows)))),
            (
                np.concatenate((rows[stays], loop_rows)),
                np.concatenate((kernel.indices[stays], loop_rows // num_actions)),
            ),
        ),
        shape=kernel.shape,
    )
    return result.tocsr()


def _check_probabilities(kernel: Csr, num_actions: int, name: NamePair) -> None:
    bad = np.flatnonzero(~((kernel.data >= 0) & np.isfinite(kernel.data)))
    if len(bad):
        row = int(np.searchsorted(kernel.indptr, bad[0], side="right")) - 1
        value = kernel.data[bad[0]]
        what = "negative probability" if value < 0 else "probability"
        raise ValueError(f"{name(*divmod(row, num_actions))}: {what} {value}")


def _check_sums(kernel: Csr, available: NDArray[np.bool_], name: NamePair) -> None:
    sums: NDArray[np.float64] = np.asarray(kernel.sum(axis=1)).ravel()
    bad = available.ravel() & (np.abs(sums - 1) > ROW_SUM_TOLERANCE)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        hint = "" if sums[row] else "; mark the action in `available` if it cannot be taken"
        raise ValueError(
            f"{name(*divmod(row, available.shape[1]))}: "
            f"probabilities sum to {sums[row]:.12g}, not 1{hint}"
        )


def _check_exact_sums(
    data: tuple[Fraction, ...], indptr: NDArray[Any], num_actions: int, name: NamePair
) -> None:
    for row, (start, stop) in enumerate(pairwise(indptr)):
        total = sum(data[start:stop], Fraction(0))
        if stop > start and total != 1:
            raise ValueError(
                f"{name(*divmod(row, num_actions))}: probabilities sum to {total}, not exactly 1"
            )


def _raise_first(bad: NDArray[np.bool_], num_actions: int, name: NamePair, what: str) -> None:
    if bad.any():
        raise ValueError(f"{name(*divmod(int(np.flatnonzero(bad)[0]), num_actions))}: {what}")


def _freeze(kernel: Csr) -> Csr:
    kernel.sort_indices()
    for array in (kernel.data, kernel.indices, kernel.indptr):
        array.flags.writeable = False
    return kernel
