"""Labels and survival times as npz, CSV or JSON."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path
from dead_ends.labels.labelling import INFINITE, Label, Labelling
from dead_ends.model.safe_mdp import SafeMDP, require_type

__all__ = ["save_labelling", "survival_time_file"]

Summary = Mapping[str, Any]
_Writer = Callable[[Path, SafeMDP, Labelling, Summary], None]


def save_labelling(
    labelling: Labelling, path: str | os.PathLike[str], *, model: SafeMDP, summary: Summary
) -> None:
    """Write every state's label and survival time, and a summary of the whole.

    The suffix chooses the format:

    * ``.npz``: arrays ``labels`` (0 fail, 1 dead, 2 safe, 3 at risk), ``survival_time``
      (the largest int32 where the state need not fail) and ``summary``, a JSON text;
    * ``.csv``: one row a state; the survival time is empty where the state need not fail;
    * ``.json``: the summary, and per state the label in words and the survival time or null.

    Raises:
        ValueError: if the suffix is another one or the folder does not exist.
        OSError: if the file cannot be written; then nothing is left behind.
    """
    require_type(model, SafeMDP, "save_labelling")
    require_type(labelling, Labelling, "save_labelling")
    writer = _WRITERS.get(Path(path).suffix.lower())
    if writer is None:
        raise ValueError(f"{path}: labels are written as {', '.join(_WRITERS)}")
    with atomic_path(path) as temporary:
        writer(temporary, model, labelling, summary)


@contextmanager
def survival_time_file(
    path: str | os.PathLike[str], num_states: int
) -> Iterator[NDArray[np.uint16]]:
    """Room for the survival times of a model too large for the memory: a ``.npy`` file.

    They are worked out in a file beside ``path`` that becomes ``path`` when all is done; an
    interrupt or an error leaves no file behind:

        with survival_time_file("times.npy", states) as times:
            classify_implicit(successor, fail, states, actions, times=times)

    Raises:
        ValueError: if the folder does not exist.
    """
    with atomic_path(path) as temporary:
        times = np.lib.format.open_memmap(temporary, "w+", dtype=np.uint16, shape=(num_states,))
        yield times
        times.flush()


def _write_npz(path: Path, _: SafeMDP, labelling: Labelling, summary: Summary) -> None:
    np.savez(
        path,
        labels=labelling.labels,
        survival_time=labelling.survival_time,
        summary=np.array(json.dumps(summary)),
    )


def _write_csv(path: Path, model: SafeMDP, labelling: Labelling, _: Summary) -> None:
    times = ["" if time is None else str(time) for time in _times(labelling)]
    columns: dict[str, Any] = {"state": range(model.num_states)}
    if model.state_names is not None:
        columns["name"] = model.state_names
    columns |= {"label": _words(labelling), "survival_time": times}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def _write_json(path: Path, model: SafeMDP, labelling: Labelling, summary: Summary) -> None:
    content = {"summary": summary, "labels": _words(labelling), "survival_time": _times(labelling)}
    if model.state_names is not None:
        content["state_names"] = model.state_names
    path.write_text(json.dumps(content) + "\n", encoding="utf-8")


def _words(labelling: Labelling) -> list[str]:
    words = [label.name.lower().replace("_", "-") for label in sorted(Label)]
    return [words[label] for label in labelling.labels.tolist()]


def _times(labelling: Labelling) -> list[int | None]:
    return [None if time == INFINITE else time for time in labelling.survival_time.tolist()]


_WRITERS: dict[str, _Writer] = {".npz": _write_npz, ".csv": _write_csv, ".json": _write_json}
