"""Models in NumPy's npz files.

The arrays carry the names of the library. The smallest file is a successor table, or a
kernel, and the fail states, so that one can write it without this package::

    np.savez("model.npz", next_state=next_state, fail=fail)
    np.savez("model.npz", P=P, fail=fail)

Arrays of a file (S states, A actions):

* ``next_state`` int (S, A), or ``P`` float (S, A, S), or the CSR parts ``P_data``,
  ``P_indices``, ``P_indptr`` of the kernel (S*A, S); ``P_exact``, strings such as "1/3" in
  place of ``P_data``, for exact models; ``available`` bool (S, A), with a kernel only;
* ``fail`` bool (S,); ``terminal`` bool (S,); ``rewards`` float (S, A); ``initial``;
* ``state_names`` and ``action_names``, strings;
* ``estimate``, one bool: the model is an estimate, see :class:`dead_ends.SafeMDP`;
* ``geometry_cell`` and the other fields of :class:`dead_ends.model.safe_mdp.Geometry`.

Nothing is ever unpickled.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from dead_ends.io.errors import located
from dead_ends.model.checks import MAX_BITS, ExactEntries, read_fraction
from dead_ends.model.memory import require_memory
from dead_ends.model.safe_mdp import Geometry, SafeMDP

__all__ = ["load_npz", "read_arrays", "save_npz"]

Arrays = Mapping[str, NDArray[Any]]

_KERNEL = ("P_data", "P_indices", "P_indptr")
_OPTIONAL = ("terminal", "rewards", "initial", "state_names", "action_names")
_GEOMETRY = tuple(f"geometry_{field.name}" for field in fields(Geometry))
_KNOWN = {
    *("next_state", "P", "P_exact", "available", "fail", "estimate"),
    *(*_KERNEL, *_OPTIONAL, *_GEOMETRY),
}


def save_npz(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    """Write a model so that :func:`load_npz` gives it back.

    Raises:
        ValueError: if the folder does not exist.
        OSError: if the file cannot be written; then nothing is left behind.
    """
    arrays = _model_arrays(model)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def load_npz(path: str | os.PathLike[str], *, normalise: bool = False) -> SafeMDP:
    """The model in an npz file; ``normalise`` as in :meth:`dead_ends.SafeMDP.stochastic`.

    Raises:
        ValueError: naming the file and the array at fault.
        OSError: if there is no such file.
    """
    arrays = read_arrays(path)
    with located(path):
        unknown = sorted(set(arrays) - _KNOWN)
        if unknown:
            raise ValueError(
                f"unknown array '{unknown[0]}'; a model has the arrays {', '.join(sorted(_KNOWN))}"
            )
        if "fail" not in arrays:
            raise ValueError("no array 'fail': which states fail?")
        return replace(_read_model(arrays, normalise), estimate=_estimate(arrays))


def read_arrays(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """All arrays of an npz file, by name; never unpickles.

    Raises:
        ValueError: naming the file, and the array if one is damaged.
        OSError: if there is no such file.
    """
    with Path(path).open("rb") as file:
        if not zipfile.is_zipfile(file):
            raise ValueError(f"{path}: not an npz file, or it is truncated")
        file.seek(0)
        arrays = {}
        try:
            with np.load(file, allow_pickle=False) as archive:
                for entry in archive.zip.infolist():
                    require_memory(entry.file_size, f"{path}: the array {entry.filename}")
                for name in archive.files:
                    with located(f"{path}: array '{name}'"):
                        arrays[name] = _read(archive, name)
                        if not isinstance(arrays[name], np.ndarray):
                            raise ValueError("not an array")
        except (zipfile.BadZipFile, zlib.error, EOFError, KeyError) as error:
            raise ValueError(f"{path}: damaged npz file: {error}") from None
    return arrays


def _read(archive: Any, name: str) -> Any:
    try:
        return archive[name]
    except (MemoryError, OverflowError) as error:  # of a shape that nothing can have
        raise ValueError(str(error)) from None


def _read_model(arrays: Arrays, normalise: bool) -> SafeMDP:
    forms = [form for form in ("next_state", "P", "P_indptr") if form in arrays]
    if len(forms) != 1:
        raise ValueError(
            "a model has exactly one of 'next_state', 'P' and the CSR parts "
            f"'P_data', 'P_indices', 'P_indptr'; found {', '.join(forms) or 'none of them'}"
        )
    fail = arrays["fail"]
    keywords: dict[str, Any] = {name: arrays[name] for name in _OPTIONAL if name in arrays}
    for names in ("state_names", "action_names"):
        if names in keywords:
            keywords[names] = _strings(keywords[names], names)
    keywords |= {"geometry": _read_geometry(arrays), "normalise": normalise}
    if forms == ["next_state"]:
        _reject(arrays, "available", "with 'next_state': -1 marks an action as not available")
        return SafeMDP.deterministic(arrays["next_state"], fail, **keywords)
    kernel = arrays["P"] if forms == ["P"] else _read_kernel(arrays, fail)
    return SafeMDP.stochastic(kernel, fail, arrays.get("available"), **keywords)


def _estimate(arrays: Arrays) -> bool:
    with located("estimate"):
        return "estimate" in arrays and _flag(arrays["estimate"])


def _read_kernel(arrays: Arrays, fail: NDArray[Any]) -> Any:
    """CSR (S*A, S), or the same in Fractions if the file is exact."""
    from scipy import sparse

    values = "P_exact" if "P_exact" in arrays else "P_data"
    for name in (values, "P_indices", "P_indptr"):
        if name not in arrays:
            raise ValueError(f"no array '{name}'")
        if arrays[name].ndim != 1:
            raise ValueError(f"{name} must have one dimension, not shape {arrays[name].shape}")
    for name in ("P_indices", "P_indptr"):
        if not np.issubdtype(arrays[name].dtype, np.integer):
            raise ValueError(f"{name} must hold integers, not {arrays[name].dtype}")
    num_states, rows = fail.size, len(arrays["P_indptr"]) - 1
    if num_states == 0 or rows <= 0 or rows % num_states:
        raise ValueError(f"P_indptr must have S*A + 1 entries for S = {num_states}, not {rows + 1}")
    indices, indptr = arrays["P_indices"], arrays["P_indptr"]
    data = np.ones(len(indices)) if values == "P_exact" else arrays[values]
    if len(arrays[values]) != len(indices):
        raise ValueError(f"{values} has {len(arrays[values])} entries, P_indices {len(indices)}")
    with located("P_data, P_indices, P_indptr"):
        kernel = sparse.csr_array((data, indices, indptr), shape=(rows, num_states))
        kernel.check_format(full_check=True)
    if values == "P_data":
        return kernel
    texts = _strings(arrays["P_exact"], "P_exact")
    with located("P_exact"):
        exact = [read_fraction(text) for text in texts]
    return ExactEntries(
        row=np.repeat(np.arange(rows), np.diff(indptr)),
        column=indices,
        value=np.array(exact, dtype=object),
        shape=(rows, num_states),
    )


def _read_geometry(arrays: Arrays) -> Geometry | None:
    given = {name.removeprefix("geometry_"): arrays[name] for name in _GEOMETRY if name in arrays}
    if not given:
        return None
    if "cell" not in given:
        raise ValueError("no array 'geometry_cell', which the other geometry arrays need")
    keywords: dict[str, Any] = {}
    for name, array in given.items():
        with located(f"geometry_{name}"):
            keywords[name] = array if name == "cell" else _GEOMETRY_READERS[name](array)
    return Geometry(**keywords)


def _text(array: NDArray[Any]) -> str:
    if array.shape != () or array.dtype.kind != "U":
        raise ValueError(f"expected one string, not {array.dtype} of shape {array.shape}")
    return str(array)


def _flag(array: NDArray[Any]) -> bool:
    if array.shape != () or array.dtype != np.bool_:
        raise ValueError(f"expected one bool, not {array.dtype} of shape {array.shape}")
    return bool(array)


def _pair(array: NDArray[Any]) -> tuple[float, float]:
    if array.shape != (2,):
        raise ValueError(f"expected two numbers, not shape {array.shape}")
    return float(array[0]), float(array[1])


def _rows(array: NDArray[Any]) -> tuple[tuple[Any, Any], ...]:
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"expected shape (n, 2), not {array.shape}")
    return tuple((row[0], row[1]) for row in array.tolist())


_GEOMETRY_READERS = {
    "x_label": _text,
    "y_label": _text,
    "origin": _pair,
    "step": _pair,
    "y_down": _flag,
    "walls": _rows,
    "arrows": _rows,
}


def _model_arrays(model: SafeMDP) -> dict[str, Any]:
    arrays: dict[str, Any] = {"fail": model.fail, "terminal": model.terminal}
    if model.next_state is not None:
        arrays["next_state"] = model.successors()
    else:
        kernel = model.transitions()
        arrays["P_indices"], arrays["P_indptr"] = kernel.indices, kernel.indptr
        if model.exact is None:
            arrays["P_data"] = kernel.data
        else:
            arrays["P_exact"] = np.array([str(p) for p in model.exact], dtype=np.str_)
        arrays["available"] = model.available
    for name in ("rewards", "initial"):
        if getattr(model, name) is not None:
            arrays[name] = getattr(model, name)
    for name in ("state_names", "action_names"):
        if getattr(model, name) is not None:
            arrays[name] = np.array(getattr(model, name), dtype=np.str_)
    if model.estimate:
        arrays["estimate"] = np.True_
    if model.geometry is not None:
        arrays |= _geometry_arrays(model.geometry)
    return arrays


def _geometry_arrays(geometry: Geometry) -> dict[str, Any]:
    values = {field.name: getattr(geometry, field.name) for field in fields(Geometry)}
    values["walls"] = np.array(values["walls"], dtype=np.int64).reshape(-1, 2)
    return {f"geometry_{name}": value for name, value in values.items() if value is not None}


def _strings(array: NDArray[Any], name: str) -> list[str]:
    if array.ndim != 1 or array.dtype.kind != "U":
        raise ValueError(f"{name} must be a list of strings, not {array.dtype} {array.shape}")
    if array.dtype.itemsize > 4 * MAX_BITS:
        raise ValueError(f"{name} holds strings of {array.dtype.itemsize // 4:,} characters")
    return [str(text) for text in array]


def _reject(arrays: Arrays, name: str, why: str) -> None:
    if name in arrays:
        raise ValueError(f"'{name}' has no meaning {why}")
