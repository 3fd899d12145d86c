"""One process a job: a lock file that names its owner and is free again when that one is dead.

The file is locked by the kernel (flock) for as long as a process has it open, the job's own
process included: whoever dies, in whatever way, the lock is free when the last of them is gone.
The text in it, process and host, is for people, and for the one case that the kernel may not
see: an owner on another host, whose lock on a cluster's job is never taken over. A run folder
or an output, which a killed run leaves and another host may go on with, trusts the kernel alone.
"""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from pathlib import Path

__all__ = ["JobLock", "LockHeldError"]


class LockHeldError(Exception):
    """Somebody else has the lock; the message says who."""


class JobLock:
    """The lock of a job, from its making to the end of the ``with`` block.

    Args:
        path: the lock file, in a folder that exists.
        across_hosts: never take over the lock of another host.

    Attributes:
        handle: the open file, to be handed to the job's process.

    Raises:
        LockHeldError: if another process has the lock.
        ValueError: if the file system knows no locks.
    """

    def __init__(self, path: Path, *, across_hosts: bool = True) -> None:
        self.path = path
        while (handle := _create(path)) is None:
            if (handle := _take_over(path, across_hosts)) is not None:
                break
            # The owner went away between the two attempts.
        self.handle = handle

    def sign(self, process: int) -> None:
        """Name the process that does the work."""
        _sign(self.handle, process)

    def __enter__(self) -> JobLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.path.unlink(missing_ok=True)
        os.close(self.handle)


def _create(path: Path) -> int | None:
    """A new lock file that appears with its text in it and locked; None if there is one."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
    try:
        _sign(handle, os.getpid())
        _try_lock(handle, path)
        os.link(name, path)
    except BaseException as error:
        os.close(handle)
        if isinstance(error, FileExistsError):
            return None
        raise
    finally:
        os.unlink(name)
    return handle


def _take_over(path: Path, across_hosts: bool) -> int | None:
    """The lock of a process that is dead; None if the file went away meanwhile."""
    try:
        handle = os.open(path, os.O_RDWR)
    except FileNotFoundError:
        return None
    try:
        free = _try_lock(handle, path)
        if not free or (across_hosts and _is_of_another_host(handle)):
            raise LockHeldError(f"it is the work of {_owner(handle)} (lock file {path})")
        if _is_open_file(path, handle):
            _sign(handle, os.getpid())
            return handle
    except BaseException:
        os.close(handle)
        raise
    os.close(handle)
    return None


def _try_lock(handle: int, path: Path) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise ValueError(f"{path}: the file system knows no locks ({error.strerror})") from error
    return True


def _is_open_file(path: Path, handle: int) -> bool:
    """Whether the path still means the file that is open."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


def _sign(handle: int, process: int) -> None:
    os.ftruncate(handle, 0)
    os.pwrite(handle, f"process {process} on {socket.gethostname()}".encode(), 0)


def _owner(handle: int) -> str:
    return os.pread(handle, 1000, 0).decode(errors="replace").strip()


def _is_of_another_host(handle: int) -> bool:
    return _owner(handle).partition(" on ")[2] not in ("", socket.gethostname())
