"""Offline data on disk: DSRL's flat HDF5 layout, and Minari's episodes.

HDF5: the data sets observations, next_observations, actions, rewards, costs, terminals and
timeouts, one row a transition. Without next_observations the following row's observation
is taken; the last row of an episode that was cut off then has none and is dropped, unless it
is a violation: that ends its episode by itself. Minari: episodes with observations (T + 1),
actions, rewards, terminations and truncations (T) and the cost in infos["cost"], of length T,
or T + 1 where the reset's comes first. What a cost must be to be a violation is said by the
same rule for both, see :mod:`deep.tasks.violation`.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from deep.data.transitions import (
    Transitions,
    check_episodes,
    check_shapes,
    checked,
    cut_at_violation,
    numbers,
)
from deep.tasks.violation import check_rule, violations

if TYPE_CHECKING:
    import gymnasium
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.episode_data import EpisodeData

__all__ = ["from_minari", "read_hdf5", "to_minari", "write_hdf5"]

Columns = dict[str, NDArray[Any]]
NEEDED = ("observations", "actions", "rewards", "costs", "terminals", "timeouts")
COLUMNS = (*NEEDED, "next_observations")


def write_hdf5(data: Transitions, path: str | os.PathLike[str]) -> None:
    """Write the flat layout; the file is whole or absent.

    >>> write_hdf5(log, "log.hdf5")
    >>> len(read_hdf5("log.hdf5"))
    5
    """
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        for field in fields(Transitions):
            file.create_dataset(field.name, data=getattr(data, field.name), compression="gzip")


def read_hdf5(
    path: str | os.PathLike[str], *, cut: bool = False, violation: str | None = None
) -> Transitions:
    """Read and check the flat layout, this project's or another's.

    Args:
        path: the file.
        cut: end an episode at each violation, see :func:`deep.data.transitions.cut_at_violation`.
        violation: which costs are one, see :mod:`deep.tasks.violation`; None: they are 0 or 1.

    Raises:
        ValueError: naming the file, the column and the row at fault.

    >>> write_hdf5(log, "log.hdf5")
    >>> read_hdf5("log.hdf5", violation="cost > 0.5").costs.tolist()
    [0.0, 0.0, 1.0, 0.0, 0.0]
    """
    check_rule(violation)
    if not Path(path).is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        return _transitions(_columns(path), cut, violation)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _columns(path: str | os.PathLike[str]) -> Columns:
    """The data sets as they are, checked by shape, type and size before they are read."""
    with _damage("not an HDF5 file, or a damaged one"):
        file = h5py.File(path, "r")
    with file:
        with _damage("the file is damaged"):
            present = [name for name in COLUMNS if file.id.links.exists(name.encode())]
        missing = [name for name in NEEDED if name not in present]
        if missing:
            raise ValueError(f"the data sets {', '.join(missing)} are missing")
        for name in present:
            with _damage(f"{name} is damaged"):
                fault = _fault(file, name)
            if fault:
                raise ValueError(f"{name}{fault}")
        lengths = {name: file[name].shape[0] for name in present}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"the data sets differ in length: {lengths}")
        _check_size(sum(math.prod(file[n].shape) * file[n].dtype.itemsize for n in present))
        columns: Columns = {}
        for name in present:
            with _damage(f"{name} is damaged"):
                columns[name] = np.asarray(file[name])
        return columns


@contextmanager
def _damage(what: str) -> Iterator[None]:
    """HDF5's own errors, of many types, as one sentence."""
    try:
        yield
    except (
        OSError,
        LookupError,
        RuntimeError,
        TypeError,
        ValueError,
        ArithmeticError,
        MemoryError,
    ) as error:
        reason = " ".join(str(error.args[0] if error.args else error).split())
        raise ValueError(f"{what} ({reason or type(error).__name__})") from error


def _fault(file: h5py.File, name: str) -> str:
    """What keeps it from being rows of numbers, all of them written, in this very file."""
    if file.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
        return " is a link, not a data set: copy what it means into the file"
    found = file[name]
    if not isinstance(found, h5py.Dataset):
        return f" is a {type(found).__name__.lower()}, not a data set"
    if found.is_virtual or found.external:
        return " keeps its numbers in other files: copy them into this one"
    if found.dtype.kind not in "biuf":
        kind = "text" if h5py.check_string_dtype(found.dtype) else found.dtype
        return f": the values are of type {kind}, not real numbers"
    if not found.shape:
        return " is a scalar or empty: a row for each transition is wanted"
    if not _is_written(found):
        return f": not all of its {found.shape[0]:,} rows were ever written"
    return ""


def _is_written(found: h5py.Dataset) -> bool:
    """Whether the file has all its values; HDF5 makes up those that it has not."""
    if not found.size:
        return True
    if found.chunks is None:
        return bool(found.id.get_space_status() == h5py.h5d.SPACE_STATUS_ALLOCATED)
    wanted = math.prod(-(-n // c) for n, c in zip(found.shape, found.chunks, strict=True))
    return bool(found.id.get_num_chunks() == wanted)


def _check_size(size: int) -> None:
    """Refuse what does not fit into memory, where it and its float32 copy are held."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if 2 * size > memory:
        raise ValueError(
            f"the data sets take {size / 1e9:,.1f} GB, more than half of this machine's memory"
        )


def _transitions(raw: Columns, cut: bool, violation: str | None) -> Transitions:
    """Checked row by row, as the rows are numbered in the source, before any is dropped."""
    if not len(raw["costs"]):
        raise ValueError("the data hold no transition")
    columns = {name: _flat(name, column) for name, column in raw.items()}
    columns["costs"] = violations(columns["costs"], violation)
    columns = {name: checked(name, column) for name, column in columns.items()}
    check_shapes({"next_observations": columns["observations"]} | columns)
    if violation is not None and not columns["costs"].any():
        raise ValueError(f"costs: there is no violation ({violation}) in the data")
    return Transitions(**_with_next_observations(_ended(columns, cut)))


def _ended(columns: Columns, cut: bool) -> Columns:
    """Every violation ends an episode: ``cut`` there, or in its last row, whatever the clock said.

    Raises:
        ValueError: if an episode goes on after one and is not to be cut.
    """
    if cut:
        return cut_at_violation(columns)
    violation, terminals, timeouts = (columns[k] for k in ("costs", "terminals", "timeouts"))
    last = terminals | timeouts
    last[-1] = True
    ended = terminals | ((violation == 1) & last)
    check_episodes(violation, ended)
    return columns | {"terminals": ended, "timeouts": timeouts & ~ended}


def _flat(name: str, column: NDArray[Any]) -> NDArray[Any]:
    """(N, 1) as (N,) where one number a row is meant."""
    single = name in ("rewards", "costs", "terminals", "timeouts")
    return column[:, 0] if single and column.ndim == 2 and column.shape[1] == 1 else column


def _with_next_observations(columns: Columns) -> Columns:
    """Fill next_observations from the following rows, if the file has none."""
    if "next_observations" in columns:
        return columns
    observations = columns["observations"]
    terminal = columns["terminals"]
    # After a terminal row nothing is bootstrapped: its successor does not matter.
    following = np.concatenate([observations[1:], observations[-1:]])
    following[terminal] = observations[terminal]
    cut_off = columns["timeouts"] & ~terminal
    cut_off[-1] |= not terminal[-1]
    before = np.append(cut_off[1:], False)
    keep = ~cut_off
    shortened = {name: column[keep].copy() for name, column in columns.items()}
    shortened["timeouts"] = (columns["timeouts"] | (before & ~terminal))[keep]
    return shortened | {"next_observations": following[keep]}


def to_minari(
    data: Transitions, dataset_id: str, env: gymnasium.Env[Any, Any] | None = None
) -> MinariDataset:
    """Store the data as a local Minari dataset (``namespace/name-v0``).

    Args:
        data: what to store; an unfinished last episode is stored as truncated.
        dataset_id: Minari's identifier.
        env: the environment, for its spaces; without it they are unbounded boxes.
    """
    import minari
    from gymnasium import spaces

    widths = (data.observations.shape[1], data.actions.shape[1])
    boxes = [spaces.Box(-np.inf, np.inf, (width,), np.float32) for width in widths]
    with warnings.catch_warnings():
        # Minari warns of every optional entry that is left out: author, e-mail, permalink.
        warnings.simplefilter("ignore", UserWarning)
        return minari.create_dataset_from_buffers(
            dataset_id,
            _episodes(data),
            env=env,
            observation_space=None if env is not None else boxes[0],
            action_space=None if env is not None else boxes[1],
            algorithm_name="deep collect",
            description="Offline data with costs: 1 at a violation, which ends the episode.",
        )


def _episodes(data: Transitions) -> list[EpisodeBuffer]:
    from minari.data_collector import EpisodeBuffer

    stops = np.flatnonzero(data.ends) + 1
    if not len(stops) or stops[-1] != len(data):
        stops = np.append(stops, len(data))
    episodes = []
    for number, (begin, end) in enumerate(zip([0, *stops[:-1]], stops, strict=True)):
        rows = slice(begin, end)
        truncations = data.timeouts[rows].copy()
        truncations[-1] |= not data.terminals[end - 1]
        episodes.append(
            EpisodeBuffer(
                id=number,
                observations=np.concatenate(
                    [data.observations[rows], data.next_observations[end - 1 : end]]
                ),
                actions=data.actions[rows],
                rewards=data.rewards[rows].tolist(),
                terminations=data.terminals[rows].tolist(),
                truncations=truncations.tolist(),
                infos={"cost": data.costs[rows]},
            )
        )
    return episodes


def from_minari(
    dataset: MinariDataset, *, cut: bool = False, violation: str | None = None
) -> Transitions:
    """Read and check a Minari dataset, this project's or another's.

    Args:
        dataset: the dataset.
        cut, violation: as for :func:`read_hdf5`.

    Raises:
        ValueError: naming the episode, and the column and row in it that are at fault.

    >>> from deep.data.formats import to_minari
    >>> from_minari(to_minari(log, "car/log-v0")).costs.tolist()
    [0.0, 0.0, 1.0, 0.0, 0.0]
    """
    check_rule(violation)
    parts: list[Columns] = []
    for episode in dataset.iterate_episodes():
        try:
            columns = _episode_columns(episode, violation)
            _check_widths(columns, parts)
            parts.append(_ended(columns, cut))
        except ValueError as error:
            raise ValueError(f"episode {episode.id}: {error}") from error
    if not parts:
        raise ValueError("the dataset holds no episode")
    return Transitions(
        **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    )


def _check_widths(columns: Columns, before: list[Columns]) -> None:
    """Episodes have observations and actions of one width each."""
    for name in ("observations", "actions") if before else ():
        width, wanted = columns[name].shape[1], before[0][name].shape[1]
        if width != wanted:
            raise ValueError(f"{name} in R^{width}, those of the first episode are in R^{wanted}")


def _episode_columns(episode: EpisodeData, violation: str | None) -> Columns:
    """The columns of one episode, checked; its last row ends it."""
    length = len(episode.rewards)
    if not length:
        raise ValueError("it has no step")
    infos = episode.infos or {}
    if "cost" not in infos:
        raise ValueError("there is no infos['cost']")
    cost = numbers("costs", infos["cost"])
    if cost.ndim == 0 or len(cost) not in (length, length + 1):
        raise ValueError(f"{cost.size} costs for {length} steps")
    violated = violations(cost, violation)
    if len(cost) > length and violated[0]:
        raise ValueError("its reset reports a violation: no action led there")
    observations = checked("observations", episode.observations)
    if observations.shape[:1] != (length + 1,):
        raise ValueError(f"observations of shape {observations.shape} for {length} steps")
    raw = {
        "observations": observations[:-1],
        "next_observations": observations[1:],
        "actions": episode.actions,
        "rewards": episode.rewards,
        "costs": violated[-length:],
        "terminals": episode.terminations,
        "timeouts": episode.truncations,
    }
    columns = {name: checked(name, column) for name, column in raw.items()}
    check_shapes(columns)
    timeouts = columns["timeouts"].copy()
    timeouts[-1] = True
    return columns | {"timeouts": timeouts & ~columns["terminals"]}
