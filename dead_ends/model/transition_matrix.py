"""The sparse kernel of a stochastic model: building, checking, exact probabilities.

Row s*A + a of a kernel is P(. | s, a). Kept apart from :mod:`dead_ends.model` because
scipy.sparse is imported only by those who need it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dead_ends.model.checks import (
    MAX_BITS,
    ROW_SUM_TOLERANCE,
    ExactEntries,
    mend_rows,
    not_one,
    read_fraction,
    read_only,
    shown,
)

Csr: TypeAlias = "sparse.csr_array[np.float64]"
NamePair = Callable[[int, int], str]


def build_kernel(
    P: Any,
    available: NDArray[np.bool_],
    terminal: NDArray[np.bool_],
    name: NamePair,
    normalise: bool = False,
) -> tuple[Csr, tuple[Fraction, ...] | None, int]:
    """The checked kernel of ``P``, its exact data if P holds Fractions, and the rows mended.

    Rows of unavailable actions (and so of fail states) are emptied, those of terminal
    states replaced by self-loops, stored zeros dropped.
    """
    num_states, num_actions = available.shape
    if isinstance(P, ExactEntries):
        return _build_exact(P, available, terminal, name, normalise)
    if not sparse.issparse(P):
        if P.dtype == object:
            entries = _listed(P, available)
            return _build_exact(entries, available, terminal, name, normalise)
        _check_kind(P.dtype)
        P = P.astype(np.float64, copy=False).reshape(num_states * num_actions, num_states)
    _check_kind(P.dtype)
    kernel = sparse.csr_array(P, dtype=np.float64, copy=True)
    _check_indices(kernel, num_actions, name)
    kernel.sum_duplicates()
    kernel = _normalise(kernel, available, terminal)
    _check_probabilities(kernel, num_actions, name)
    mended = 0
    if normalise:
        kernel.data, mended = mend_rows(_rows_of(kernel), kernel.data)
    _check_sums(kernel, available, name)
    return _freeze(kernel), None, mended


def table_kernel(successors: NDArray[np.int32]) -> Csr:
    """The kernel of a successor table (S, A), -1 where an action is not available."""
    num_states, num_actions = successors.shape
    flat = successors.ravel()
    indptr = np.concatenate(([0], np.cumsum(flat >= 0)))
    indices = flat[flat >= 0]
    data = np.ones(len(indices))
    shape = (num_states * num_actions, num_states)
    return _freeze(sparse.csr_array((data, indices, indptr), shape=shape))


def exact_data(kernel: Csr, name: NamePair, normalise: bool = False) -> tuple[Fraction, ...]:
    """Each stored float as its shortest decimal; every non-empty row sums to exactly 1."""
    data = tuple(Fraction(repr(float(p))) for p in kernel.data)
    if normalise:
        data = tuple(mend_rows(_rows_of(kernel), np.array(data, dtype=object))[0])
    num_actions = kernel.shape[0] // kernel.shape[1]
    try:
        _check_exact_sums(data, kernel.indptr, num_actions, name)
    except ValueError as error:
        raise ValueError(f"{error} (exactly, a float is its shortest decimal)") from None
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


def _listed(P: NDArray[np.object_], available: NDArray[np.bool_]) -> ExactEntries:
    """What a dense array (S, A, S) of objects holds in the rows of available actions."""
    num_states, num_actions = available.shape
    rows = np.flatnonzero(available)
    dense = P.reshape(num_states * num_actions, num_states)[rows]
    try:
        place, column = np.nonzero(np.asarray(dense != 0, dtype=np.bool_))
    except (ValueError, ArithmeticError):  # as of arrays, of a signalling NaN
        raise ValueError("P holds objects that are no numbers") from None
    return ExactEntries(
        row=rows[place],
        column=column,
        value=dense[place, column],
        shape=(num_states * num_actions, num_states),
    )


def _build_exact(
    entries: ExactEntries,
    available: NDArray[np.bool_],
    terminal: NDArray[np.bool_],
    name: NamePair,
    normalise: bool,
) -> tuple[Csr, tuple[Fraction, ...], int]:
    """Fractions: nothing is rounded before the checks."""
    num_actions = available.shape[1]
    ends = np.repeat(terminal, num_actions)
    total: dict[tuple[int, int], Fraction] = {
        (row, row // num_actions): Fraction(1) for row in np.flatnonzero(ends).tolist()
    }
    kept = (available.ravel() & ~ends)[entries.row]
    columns = (entries.row[kept].tolist(), entries.column[kept].tolist(), entries.value[kept])
    for row, column, p in zip(*columns, strict=True):
        try:
            value = _fraction(p)
        except ValueError as error:
            raise ValueError(f"{name(*divmod(row, num_actions))}: {error}") from None
        if value:
            place = row, column
            total[place] = total[place] + value if place in total else value
    places = sorted(total)
    rows = np.array([row for row, _ in places], dtype=np.int64)
    values = np.array([total[place] for place in places], dtype=object)
    values, mended = mend_rows(rows, values) if normalise else (values, 0)
    exact = tuple(values)
    counts = np.bincount(rows, minlength=available.size)
    empty = (counts == 0) & available.ravel()
    _raise_first(empty, num_actions, name, "probabilities sum to 0, not 1")
    indptr = np.concatenate(([0], np.cumsum(counts)))
    _check_exact_sums(exact, indptr, num_actions, name)
    # What is possible stays so: no Fraction is rounded to 0.
    data = np.array([max(float(p), math.ulp(0.0)) for p in exact])
    indices = np.array([column for _, column in places], dtype=np.int32)
    return _freeze(sparse.csr_array((data, indices, indptr), shape=entries.shape)), exact, mended


def _fraction(p: Any) -> Fraction:
    try:
        value = _exactly(p)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{str(p)[:80]!r} is not a probability") from None
    if value < 0:
        raise ValueError(f"negative probability {shown(value)}")
    if max(value.numerator.bit_length(), value.denominator.bit_length()) > MAX_BITS:
        raise ValueError(f"a probability with more than {MAX_BITS:,} bits")
    return value


def _exactly(p: Any) -> Fraction:
    """A number as a Fraction of Python's integers, which never overflow; a float as a decimal."""
    if type(p) is int:
        return Fraction(p)
    if isinstance(p, float | np.floating):
        return Fraction(repr(float(p)))
    if isinstance(p, str | Decimal):
        return read_fraction(str(p))
    value = Fraction(p)
    if type(value.numerator) is int and type(value.denominator) is int:
        return value
    return Fraction(int(value.numerator), int(value.denominator))


def _rows_of(kernel: Csr) -> NDArray[np.int64]:
    """(N,) the row of each stored entry."""
    return np.repeat(np.arange(kernel.shape[0]), np.diff(kernel.indptr))


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
        what = not_one(sums[row], int(np.diff(kernel.indptr)[row]))
        raise ValueError(f"{name(*divmod(row, available.shape[1]))}: {what}{hint}")


def _check_exact_sums(
    data: tuple[Fraction, ...], indptr: NDArray[Any], num_actions: int, name: NamePair
) -> None:
    for row, (start, stop) in enumerate(pairwise(indptr)):
        total = sum(data[start:stop], Fraction(0))
        if stop > start and total != 1:
            raise ValueError(f"{name(*divmod(row, num_actions))}: {not_one(total, stop - start)}")


def _raise_first(bad: NDArray[np.bool_], num_actions: int, name: NamePair, what: str) -> None:
    if bad.any():
        raise ValueError(f"{name(*divmod(int(np.flatnonzero(bad)[0]), num_actions))}: {what}")


def _freeze(kernel: Csr) -> Csr:
    kernel.sort_indices()
    for array in (kernel.data, kernel.indices, kernel.indptr):
        read_only(array)
    return kernel
