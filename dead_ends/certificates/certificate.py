"""Certificates: labels with witnesses that a small checker can verify.

:func:`certify` solves and finds the witnesses, :mod:`dead_ends.certificates.checker` says what
they mean and verifies them without searching. A certificate is a file of four integers a state:

* deterministic models: the rank of a dead state is its survival time;
* stochastic models: the rank of a state that is dead or at risk is the number of steps after
  which fail has become possible whatever the agent does; the escape of a state at risk is the
  number of steps in which the safe states can be reached.

Both are found backwards, in time linear in the transitions.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.certificates.checker import Certificate
from dead_ends.io.atomic import atomic_path
from dead_ends.io.errors import located
from dead_ends.io.npz import read_arrays
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.labels.labelling import Labelling
from dead_ends.model.digest import model_digest
from dead_ends.model.safe_mdp import SafeMDP, require_type

__all__ = ["certify", "find_witnesses", "load_certificate", "save_certificate"]

FORMAT = "dead-ends certificate"
VERSION = 1
COLUMNS = ("labels", "rank", "escape", "action")


def certify(model: SafeMDP, labelling: Labelling | None = None) -> Certificate:
    """The labels of a model with their witnesses.

    Args:
        model: deterministic or stochastic.
        labelling: its ``classify(model)``, if at hand.

    Raises:
        ValueError: if the model is an estimate: its labels are not those of the task.
    """
    require_type(model, SafeMDP, "certify")
    if labelling is not None:
        require_type(labelling, Labelling, "certify")
    model.refuse_estimate("a certificate")
    return find_witnesses(model, classify(model) if labelling is None else labelling)


def find_witnesses(model: SafeMDP, labelling: Labelling) -> Certificate:
    """What :func:`certify` returns, of an estimate too: it speaks of the model alone."""
    stays = safe_actions(model, labelling)
    action = np.where(labelling.safe, stays.argmax(axis=1), -1).astype(np.int32)
    escape = np.zeros(model.num_states, dtype=np.int32)
    if model.is_deterministic:
        rank = np.where(labelling.dead, labelling.survival_time, 0)
    else:
        rank, escape = _stochastic_ranks(model, labelling, action)
    return Certificate(
        digest=model_digest(model),
        labels=labelling.labels,
        rank=rank.astype(np.int32),
        escape=escape,
        action=action,
    )


def save_certificate(certificate: Certificate, path: str | os.PathLike[str]) -> None:
    """Write a certificate as .npz or .json.

    Raises:
        ValueError: if the suffix is another one or the folder does not exist.
        OSError: if the file cannot be written; then nothing is left behind.
    """
    require_type(certificate, Certificate, "save_certificate")
    head = {"format": FORMAT, "version": VERSION, "digest": certificate.digest}
    columns = {name: getattr(certificate, name) for name in COLUMNS}
    suffix = Path(path).suffix.lower()
    if suffix not in (".npz", ".json"):
        raise ValueError(f"{path}: certificates are written as .npz or .json")
    with atomic_path(path) as temporary:
        if suffix == ".npz":
            arrays: dict[str, Any] = head | columns
            np.savez(temporary, **arrays)
        else:
            lists = {name: column.tolist() for name, column in columns.items()}
            temporary.write_text(json.dumps(head | lists) + "\n", encoding="utf-8")


def load_certificate(path: str | os.PathLike[str]) -> Certificate:
    """Read a certificate; whether it proves anything is for the checker to say.

    Raises:
        ValueError: naming the file and what is wrong with it.
        OSError: if there is no such file.
    """
    content = read_arrays(path) if Path(path).suffix.lower() == ".npz" else _read_json(path)
    with located(path):
        if str(content.get("format")) != FORMAT:
            raise ValueError("not a certificate of dead-ends")
        if str(content.get("version")) != str(VERSION):
            raise ValueError(f"certificate of version {content.get('version')}, not {VERSION}")
        columns = {name: _column(content, name) for name in COLUMNS}
        return Certificate(digest=str(content.get("digest")), **columns)


def _read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    with located(path):
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ValueError(f"not JSON: {error}") from None
    return content if isinstance(content, dict) else {}


def _column(content: Mapping[str, Any], name: str) -> NDArray[Any]:
    if name not in content:
        raise ValueError(f"no column '{name}'")
    with located(name):
        column = np.asarray(content[name])
        if column.ndim != 1 or column.dtype.kind not in "iu":
            raise ValueError("not a list of integers")
    return column


def _stochastic_ranks(
    model: SafeMDP, labelling: Labelling, action: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Rank and escape; writes the escaping actions of states at risk into ``action``."""
    from dead_ends.certificates.search import danger_ranks, escapes

    columns = model.transitions().tocsc()
    rank = danger_ranks(columns.indptr, columns.indices, model.available, model.fail)
    escape, away = escapes(columns.indptr, columns.indices, labelling.safe, model.num_actions)
    at_risk = labelling.at_risk
    action[at_risk] = away[at_risk]
    return rank, np.where(at_risk, escape, 0).astype(np.int32)
