"""Time, memory and the facts that a result file records."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import platform
import subprocess
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import process_time
from typing import Any, TypeVar

from dead_ends.io.atomic import atomic_path

Result = TypeVar("Result")
RESULTS = Path(__file__).parent / "results"
PACKAGES = (
    *("numpy", "scipy", "numba", "stormpy", "quantecon", "hj-reachability", "jax"),
    *("torch", "stable-baselines3", "gymnasium", "mujoco"),
)


def best_time(call: Callable[[], Result], repeats: int = 3) -> tuple[float, Result]:
    """The least time of some calls, in seconds of one processor, and the last answer.

    Processor time, because the machine may be shared: all that is measured here runs in one
    thread and waits for nothing, so that on an idle machine it is the time on the clock.
    """
    times = []
    for _ in range(repeats):
        gc.collect()
        started = process_time()
        result = call()
        times.append(process_time() - started)
    return min(times), result


def extra_memory(call: Callable[[], Any]) -> int:
    """Bytes of resident memory at the peak of a call, beyond what was held before (Linux)."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # what was freed goes back to the system
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    before = _status("VmRSS")
    result = call()
    peak = _status("VmHWM")
    del result
    return peak - before


def _status(field: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith(field + ":"))
    return int(line.split()[1]) * 1024


def facts() -> dict[str, Any]:
    """Where and with what a run was made."""
    return {
        "revision": _git("rev-parse", "--short", "HEAD"),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "cores": os.cpu_count(),
        "machine": platform.machine(),
    }


def _git(*arguments: str) -> str:
    here = Path(__file__).parent  # wherever it is called from
    done = subprocess.run(["git", *arguments], cwd=here, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def save(name: str, config: dict[str, Any], rows: list[dict[str, Any]], wall: float) -> Path:
    """Write a result file: what was asked, on what, what came out, how long it took."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    content = {"config": config, **facts(), "wall_seconds": round(wall, 1), "rows": rows}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")
    return path
