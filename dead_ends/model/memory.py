"""Whether a computation fits the machine's memory, asked before it starts."""

from __future__ import annotations

from pathlib import Path

__all__ = ["available_memory", "require_memory"]

MEMINFO = Path("/proc/meminfo")
GIB = 2**30


def available_memory() -> int | None:
    """Bytes that can be had without swapping; None where the system does not tell (not Linux)."""
    try:
        text = MEMINFO.read_text()
    except OSError:
        return None
    for line in text.splitlines():
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) * 1024
    return None


def require_memory(needed: int, what: str) -> None:
    """Refuse what does not fit, in one sentence. ``what`` names the computation.

    Raises:
        MemoryError: if less than ``needed`` bytes are available.
    """
    if needed < GIB:  # always worth trying, and small solves do not pay for the question
        return
    available = available_memory()
    if available is not None and needed > available:
        raise MemoryError(
            f"{what} needs {needed / GIB:.1f} GiB of memory, {available / GIB:.1f} are available"
        )
