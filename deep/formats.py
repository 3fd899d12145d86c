"""Offline data on disk: DSRL's flat HDF5 layout, and Minari's episodes.

HDF5: the data sets observations, next_observations, actions, rewards, costs, terminals and
timeouts, one row a transition. Without next_observations the following row's observation
is taken; the last row of an episode that was cut off then has none and is dropped. Minari:
episodes with observations (T + 1), actions, rewards, terminations and truncations (T) and
the cost in infos["cost"], of length T, or T + 1 where the reset's comes first.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from deep.data import Transitions, cut_at_violation

if TYPE_CHECKING:
    import gymnasium
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

__all__ = ["from_minari", "read_hdf5", "to_minari", "write_hdf5"]

Columns = dict[str, NDArray[Any]]
NEEDED = ("observations", "actions", "rewards", "costs", "terminals", "timeouts")


def write_hdf5(data: Transitions, path: str | os.PathLike[str]) -> None:
    """Write the flat layout; the file is whole or absent."""
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        for field in fields(Transitions):
            file.create_dataset(field.name, data=getattr(data, field.name), compression="gzip")


def read_hdf5(path: str | os.PathLike[str], *, cut: bool = False) -> Transitions:
    """Read and check the flat layout, this project's or another's.

    Args:
        path: the file.
        cut: end every episode at its first violation, see
            :func:`deep.data.cut_at_violation`.

    Raises:
        ValueError: naming the file, the column and the row at fault.
    """
    if not Path(path).is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        with h5py.File(path, "r") as file:
            names = [name for name in (*NEEDED, "next_observations") if name in file]
            columns: Columns = {name: np.asarray(file[name]) for name in names}
    except OSError as error:
        raise ValueError(f"{path}: not an HDF5 file ({error})") from error
    missing = [name for name in NEEDED if name not in columns]
    if missing:
        raise ValueError(f"{path}: the data sets {', '.join(missing)} are missing")
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{path}: the data sets differ in length: {lengths}")
    try:
        columns = {name: _flat(name, column) for name, column in columns.items()}
        columns = cut_at_violation(columns) if cut else columns
        return Transitions(**_with_next_observations(columns))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _flat(name: str, column: NDArray[Any]) -> NDArray[Any]:
    """(N, 1) as (N,) where one number a row is meant."""
    single = name in ("rewards", "costs", "terminals", "timeouts")
    return column[:, 0] if single and column.ndim == 2 and column.shape[1] == 1 else column


def _with_next_observations(columns: Columns) -> Columns:
    """Fill next_observations from the following rows, if the file has none."""
    if "next_observations" in columns:
        return columns
    observations = columns["observations"]
    terminal = columns["terminals"].astype(np.bool_)
    # After a terminal row nothing is bootstrapped: its successor does not matter.
    following = np.concatenate([observations[1:], observations[-1:]])
    following[terminal] = observations[terminal]
    cut_off = columns["timeouts"].astype(np.bool_) & ~terminal
    cut_off[-1] |= not terminal[-1]
    before = np.append(cut_off[1:], False)
    keep = ~cut_off
    shortened = {name: column[keep].copy() for name, column in columns.items()}
    shortened["timeouts"] = (columns["timeouts"].astype(np.bool_) | (before & ~terminal))[keep]
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


def from_minari(dataset: MinariDataset, *, cut: bool = False) -> Transitions:
    """Read and check a Minari dataset, this project's or another's.

    Raises:
        ValueError: naming the episode without a cost, or the column and row at fault.
    """
    parts: list[Columns] = []
    for episode in dataset.iterate_episodes():
        length = len(episode.rewards)
        infos = episode.infos or {}
        if "cost" not in infos:
            raise ValueError(f"episode {episode.id}: there is no infos['cost']")
        cost = np.asarray(infos["cost"], dtype=np.float64).reshape(-1)
        if len(cost) not in (length, length + 1):
            raise ValueError(f"episode {episode.id}: {len(cost)} costs for {length} steps")
        observations = np.asarray(episode.observations)
        parts.append(
            {
                "observations": observations[:-1],
                "next_observations": observations[1:],
                "actions": np.asarray(episode.actions),
                "rewards": np.asarray(episode.rewards),
                "costs": cost[-length:],
                "terminals": np.asarray(episode.terminations),
                "timeouts": np.asarray(episode.truncations) & ~np.asarray(episode.terminations),
            }
        )
    if not parts:
        raise ValueError("the dataset holds no episode")
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Transitions(**(cut_at_violation(columns) if cut else columns))
