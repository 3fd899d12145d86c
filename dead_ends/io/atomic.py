"""Files that are whole or absent: written beside the target, then renamed.

Each file is written in a folder of its own beside the target, ``.NAME-xxxxxxxx.writing``. The
process holds a lock on that folder, which dies with it: a folder that can be locked is left of
a run that was killed, and the next run that writes the same file removes it.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["atomic_path", "check_target"]

SUFFIX = ".writing"
RANDOM = "[a-z0-9_]{8}"
"""What :func:`tempfile.mkdtemp` puts between prefix and suffix."""


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the folder of ``path`` that becomes ``path`` on success.

    The name is kept, since many writers choose the format by its suffix. On any exception, an
    interrupt too, what was written is removed and ``path`` is as it was. What killed runs left
    of the same file is removed first.

    Raises:
        ValueError: if there can be no such file, see :func:`check_target`.
    """
    target = check_target(path)
    _remove_stale(target)
    folder, lock = _locked_folder(target)
    try:
        yield folder / target.name
        (folder / target.name).replace(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def check_target(path: str | os.PathLike[str], *inputs: str | os.PathLike[str]) -> Path:
    """A file may be written there: it has a name, its folder exists, and it is no input.

    Args:
        path: the file to write.
        inputs: files that are read, and have to stay as they are; they may be missing.

    Raises:
        ValueError: naming the file, if the name is empty or a folder's, if its folder does not
            exist, or if it is one of the inputs, by whatever links or names.
    """
    if not os.fspath(path):
        raise ValueError("the name of the file to write is empty")
    target = Path(path)
    if target.is_dir():
        raise ValueError(f"{target}: is a folder, not a file to write")
    if not target.parent.is_dir():
        raise ValueError(f"{target}: the folder {target.parent} does not exist")
    for source in map(Path, inputs):
        if target.exists() and source.exists() and target.samefile(source):
            raise ValueError(f"{target}: is read as input ({source}) and would be overwritten")
    return target


def _locked_folder(target: Path) -> tuple[Path, int]:
    """A new folder beside the target, and the open lock on it."""
    while True:
        folder = Path(tempfile.mkdtemp(SUFFIX, f".{target.name}-", target.parent))
        lock = os.open(folder, os.O_RDONLY)
        # Another process may have taken it for a killed run's before the lock was there.
        if _lock(lock) is not False and folder.exists():
            return folder, lock
        os.close(lock)


def _lock(folder: int) -> bool | None:
    """Whether the lock on an open folder is ours now; None where the file system has none."""
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _remove_stale(target: Path) -> None:
    """Remove what killed runs left of this file; never what a live process holds.

    What cannot be opened is another user's, or another process has just removed it.
    """
    name = re.compile(re.escape(f".{target.name}-") + RANDOM + re.escape(SUFFIX))
    with suppress(OSError):
        for left in [path for path in os.listdir(target.parent) if name.fullmatch(path)]:
            with suppress(OSError):
                lock = os.open(target.parent / left, os.O_RDONLY)
                try:
                    if _lock(lock):
                        shutil.rmtree(target.parent / left, ignore_errors=True)
                finally:
                    os.close(lock)
