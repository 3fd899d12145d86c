"""What run folders have in common: who made them from what, their files, a polite Ctrl-C.

One process at a time works in a folder or on a file, and nothing is written over what somebody
else has left there.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import platform
import signal
import subprocess
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from dead_ends.io.atomic import atomic_path
from deep.runs.lock import JobLock, LockHeldError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = [
    "CsvLog",
    "InterruptAfterUpdate",
    "check_folder",
    "check_unused",
    "fingerprint",
    "from_plain",
    "new_file",
    "only_process",
    "open_folder",
    "read_object",
    "refuse_empty_names",
    "versions",
    "write_json",
]

Config = TypeVar("Config", bound="DataclassInstance")


RUN_FILES = ("result.json", "checkpoint.safetensors", "progress.csv", "filters", "policies")


def check_unused(folder: Path) -> None:
    """Refuse to begin a run where another left something: it would pass for this run's.

    Raises:
        ValueError: naming what is there.
    """
    for name in RUN_FILES:
        if (folder / name).exists():
            raise ValueError(f"{folder}: there is {name} of something else; begin in a new folder")


def check_folder(
    folder: Path,
    plain: Mapping[str, Any],
    data: str | None = None,
    *,
    file: str = "config.json",
    what: str = "run",
) -> None:
    """Refuse a folder that holds another run; nothing is written.

    Args:
        folder: the run's.
        plain: its configuration, as JSON values.
        data: the fingerprint of the data it learns from, if they are a file.
        file: where the configuration is kept.
        what: it is called.

    Raises:
        ValueError: if the folder holds another run, or what no run here has written, or the
            data have changed since.
    """
    path = folder / file
    if not path.exists():
        check_unused(folder)
        return
    content = read_object(path, "run")
    if content["run"] != json.loads(json.dumps(plain)):
        raise ValueError(f"{folder} holds a {what} with another configuration")
    if content.get("data") != data:
        raise ValueError(f"{plain['data']}: the data have changed since the run began")


def open_folder(
    folder: Path,
    plain: Mapping[str, Any],
    data: str | None = None,
    *,
    file: str = "config.json",
    what: str = "run",
) -> None:
    """Begin a run in a new folder, or find the same one in an old folder, see
    :func:`check_folder`.
    """
    check_folder(folder, plain, data, file=file, what=what)
    path = folder / file
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        made = {"run": plain, "made with": versions()}
        write_json(path, made | ({"data": data} if data else {}))


@contextmanager
def only_process(folder: Path) -> Iterator[None]:
    """Be the only process that works in a folder; it is made, and goes again if it stays empty.

    The lock dies with its process, in whatever way, see :mod:`deep.runs.lock`.

    Raises:
        ValueError: if another process is at work there.
    """
    with _made(folder), _lock(folder / ".lock", folder):
        yield


@contextmanager
def new_file(path: Path) -> Iterator[None]:
    """Be the only process that makes this file, in a folder that is made if need be.

    Raises:
        ValueError: if it is there, or another process is making it, or it is a folder.
    """
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, not a file to write")
    with _made(path.parent), _lock(path.with_name(f".{path.name}.lock"), path):
        if path.exists():
            raise ValueError(f"{path}: it is there already; remove it, or give another name")
        yield


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """A folder that exists; it and its parents go again if they were made for nothing."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file, not a folder")
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # not empty: there is something to keep
            for place in made:
                place.rmdir()


@contextmanager
def _lock(file: Path, what: Path) -> Iterator[None]:
    try:
        lock = JobLock(file, across_hosts=False)
    except LockHeldError as held:
        raise ValueError(f"{what}: another process is at work there: {held}") from held
    with lock:
        yield


def refuse_empty_names(arguments: Sequence[str]) -> None:
    """Refuse an option without a name: an empty path would mean the folder of the moment.

    Raises:
        ValueError: naming the option.
    """
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if not argument.strip():
            raise ValueError(f"{before or 'the first argument'}: an empty name")
        if argument.startswith("--") and argument.endswith("="):
            raise ValueError(f"{argument[:-1]}: an empty name")


def versions() -> dict[str, str]:
    """Versions of what the numbers hang on, and the source tree's git revision."""
    names = ("numpy", "torch", "gymnasium", "safetensors")
    found = {name: metadata.version(name) for name in names}
    return found | {"python": platform.python_version(), "git": _git_revision()}


def _git_revision() -> str:
    """The revision of the source tree, with a + if it has changes; "" if git knows none.

    Only of the repository to which this very file belongs: an installed package may lie inside
    somebody else's.
    """
    if _git("ls-files", "--error-unmatch", "--", Path(__file__).name) is None:
        return ""
    return _git("describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*") or ""


def _git(*arguments: str) -> str | None:
    """What git says about the folder of this file; None if it fails, or is not there."""
    # Inside a hook git points its own commands at that hook's repository.
    clean = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        run = subprocess.run(
            ["git", *arguments],
            cwd=Path(__file__).parent,
            env=clean,
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError:
        return None
    return run.stdout.strip() if run.returncode == 0 else None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON object as a file, wholly or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")


def read_object(path: Path, *entries: str) -> dict[str, Any]:
    """The JSON object in a file, which has at least these entries.

    Raises:
        ValueError: if it cannot be read, is none, or lacks an entry.
    """
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: not a readable JSON file ({error})") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected a JSON object")
    missing = [entry for entry in entries if entry not in content]
    if missing:
        raise ValueError(f"{path}: {missing[0]!r} is missing")
    return content


def from_plain(kind: type[Config], plain: Mapping[str, Any]) -> Config:
    """A dataclass from what ``asdict`` and JSON made of it: their lists were tuples.

    Raises:
        TypeError: naming the first entry that is missing or unknown.
    """
    names = {f.name for f in fields(kind)}
    for name in sorted(names ^ set(plain)):
        raise TypeError(f"{name!r} is {'missing' if name in names else 'unknown'}")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in plain.items()})


def fingerprint(path: Path | None) -> str | None:
    """The SHA-256 of a data file, so that a run knows its data again; None of none.

    Raises:
        ValueError: if there is no such file.
    """
    if path is None:
        return None
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class InterruptAfterUpdate:
    """Holds Ctrl-C back until the update at work is whole; outside the main thread: nothing."""

    def __init__(self) -> None:
        self.asked = False
        self._before: Any = None

    def __enter__(self) -> InterruptAfterUpdate:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._ask)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _ask(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002  (a handler's signature)
        self.asked = True


class CsvLog:
    """A table that grows by rows; what a killed run wrote after its checkpoint is dropped.

    Args:
        path: the file.
        columns: its header; the first column counts what has been done.
        done: rows that count more are dropped.
    """

    def __init__(self, path: Path, columns: Sequence[str], done: int) -> None:
        self._path = path
        rows = [row for row in _rows(path, len(columns)) if int(row[0]) <= done]
        with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
            csv.writer(file).writerows([columns, *rows])

    def write(self, rows: Iterable[Sequence[object]]) -> None:
        """Append rows and hand them to the disk."""
        with self._path.open("a", newline="") as file:
            csv.writer(file).writerows(rows)
            file.flush()
            os.fsync(file.fileno())


def _rows(path: Path, width: int) -> list[list[str]]:
    """The rows that were written wholly, without the header."""
    if not path.exists():
        return []
    lines = path.read_text().splitlines(keepends=True)[1:]
    whole = [line for line in lines if line.endswith("\n") and line.count(",") == width - 1]
    return list(csv.reader(whole))
