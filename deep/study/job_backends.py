"""Where jobs run: in this machine's cores, or on a cluster through Ray.

Both take a job and give a future of what came of it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Literal, Protocol, TypeAlias

from deep.study.job_process import JobProcess, Outcome, run_process

__all__ = ["BackendName", "Runner", "open_runner"]

BackendName: TypeAlias = Literal["local", "ray"]
OBJECT_STORE_BYTES = 100_000_000  # jobs talk through files; Ray would take a third of the memory


class Runner(Protocol):
    """Runs jobs side by side, up to a number of them."""

    workers: int

    def submit(self, job: JobProcess) -> Future[Outcome]:
        """Start a job."""

    def interrupt(self, urgency: int) -> None:
        """End all jobs: 1 politely, 2 at once."""


@contextmanager
def open_runner(name: BackendName, workers: int | None, address: str | None) -> Iterator[Runner]:
    """A backend for the time of a ``with`` block, at whose end no job of it runs any more.

    Args:
        name: the backend.
        workers: jobs at once; None: as many as there are cores, with Ray those of the cluster.
        address: of a Ray cluster; None: one of its own on this machine.

    Raises:
        ValueError: if Ray is not installed, or does not find the cluster.
    """
    opened = _local(workers or _cores()) if name == "local" else _ray(workers, address)
    with opened as runner:
        try:
            yield runner
        finally:
            runner.interrupt(1)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _LocalRunner:
    """Threads of this process, each of which watches over one job."""

    def __init__(self, pool: ThreadPoolExecutor, workers: int) -> None:
        self.workers = workers
        self._pool = pool
        self._urgency = 0

    def submit(self, job: JobProcess) -> Future[Outcome]:
        return self._pool.submit(run_process, job, lambda: self._urgency)

    def interrupt(self, urgency: int) -> None:
        self._urgency = urgency


@contextmanager
def _local(workers: int) -> Iterator[Runner]:
    with ThreadPoolExecutor(workers) as pool:
        yield _LocalRunner(pool, workers)


class _RayRunner:
    """Tasks of a Ray cluster, one core each, on a file system that all nodes see."""

    def __init__(self, ray: Any, workers: int) -> None:
        self.workers = workers
        self._ray = ray
        # A task that is lost with its node is a failed job, not one to be run twice.
        self._task = ray.remote(num_cpus=1, max_retries=0)(run_process)
        self._running: dict[Future[Outcome], Any] = {}
        self._urgency = 0

    def submit(self, job: JobProcess) -> Future[Outcome]:
        reference = self._task.remote(job)
        future: Future[Outcome] = reference.future()
        self._running[future] = reference
        future.add_done_callback(lambda done: self._running.pop(done, None))
        return future

    def interrupt(self, urgency: int) -> None:
        """Cancelling raises KeyboardInterrupt in the task, which then ends its process."""
        if urgency > self._urgency:
            self._urgency = urgency
            for reference in list(self._running.values()):
                self._ray.cancel(reference, force=urgency > 1)


@contextmanager
def _ray(workers: int | None, address: str | None) -> Iterator[Runner]:
    try:
        ray = import_module("ray")
    except ModuleNotFoundError:
        raise ValueError("the backend ray needs Ray: pip install 'dead-ends[cluster]'") from None
    quiet = {"log_to_driver": False, "configure_logging": False}
    try:
        if address is None:
            cores = workers or _cores()
            # Jobs compute on cores: nothing of Ray's is to touch their choice of a GPU.
            os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            ray.init(
                address="local",
                num_cpus=cores,
                include_dashboard=False,
                object_store_memory=OBJECT_STORE_BYTES,
                **quiet,
            )
        else:
            ray.init(address=address, **quiet)
            cores = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise ValueError(f"Ray at {address or 'this machine'}: {_first_line(error)}") from error
    try:
        yield _RayRunner(ray, cores)
    finally:
        ray.shutdown()


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
