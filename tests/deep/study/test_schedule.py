"""Many jobs: each once, in order, whatever fails; interrupts leave no process behind."""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deep.runs.lock import JobLock, LockHeldError
from deep.study.job_backends import open_runner
from deep.study.job_process import Ending, JobProcess, run_process
from deep.study.schedule import Failure, Job, failure_table, run_jobs

# A job that obeys: "exit N", "write FILE", "note FILE WORD", "print WORD", "sleep SECONDS",
# "own FILE": its process number; "await FILE"; "polite FILE": on SIGINT writes it and ends.
SCRIPT = """
import os, signal, sys, time
words = iter(sys.argv[1:])
def polite(file):
    def save(number, frame):
        open(file, "w").close()
        sys.exit(130)
    signal.signal(signal.SIGINT, save)
for word in words:
    if word == "exit": sys.exit(int(next(words)))
    if word == "write": open(next(words), "w").close()
    if word == "note":
        with open(next(words), "a") as file: file.write(next(words))
    if word == "print": print(next(words), flush=True)
    if word == "sleep": time.sleep(float(next(words)))
    if word == "environment": print(os.environ.get(next(words)), flush=True)
    if word == "own":
        with open(next(words), "w") as file: file.write(f"{os.getpid()}\\n")
    if word == "await":
        file = next(words)
        while not os.path.exists(file): time.sleep(0.01)
    if word == "polite": polite(next(words))
    if word == "deaf": signal.signal(signal.SIGINT, signal.SIG_IGN)
"""
STUB = (sys.executable, "-S", "-c", SCRIPT)
ROOT = Path(__file__).parents[3]


def job(folder: Path, name: str, *words: str, needs: tuple[str, ...] = ()) -> Job:
    """A job that does what it is told, then writes its result."""
    result = folder / f"{name}.result"
    result.parent.mkdir(parents=True, exist_ok=True)
    return Job(name, (*words, "write", str(result)), result, needs)


def wait_for(path: Path) -> str:
    """What is in the file as soon as it is whole: with a line's end."""
    deadline = time.monotonic() + 90
    while not (path.exists() and path.read_text().endswith("\n")):
        assert time.monotonic() < deadline, f"{path} did not appear"
        time.sleep(0.01)
    return path.read_text()


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_jobs_run_in_order_after_their_needs(tmp_path: Path) -> None:
    order = tmp_path / "order"
    jobs = [
        job(tmp_path, "c", "note", str(order), "c", needs=("b",)),
        job(tmp_path, "a", "note", str(order), "a"),
        job(tmp_path, "b", "note", str(order), "b"),
        job(tmp_path, "d", "note", str(order), "d"),
    ]
    result = run_jobs(jobs, logs=tmp_path / "logs", workers=1, quiet=True, program=STUB)
    # c is first, but not ready until b is done; then it goes before d.
    assert order.read_text() == "abcd"
    assert result.finished == ("c", "a", "b", "d")
    assert (result.skipped, result.failed, result.blocked) == ((), (), ())


def test_what_is_finished_is_skipped_and_counts_for_those_that_need_it(tmp_path: Path) -> None:
    order = tmp_path / "order"
    jobs = [
        job(tmp_path, "first", "note", str(order), "1"),
        job(tmp_path, "second", "note", str(order), "2", needs=("first",)),
        job(tmp_path, "failing", "exit", "1"),
        job(tmp_path, "kept", "note", str(order), "3", needs=("failing",)),
    ]
    jobs[0].result.touch()
    jobs[3].result.touch()
    result = run_jobs(jobs, logs=tmp_path / "logs", workers=2, quiet=True, program=STUB)
    assert order.read_text() == "2"
    assert result.skipped == ("first", "kept")
    assert result.finished == ("second",)
    assert result.blocked == ()
    assert not (tmp_path / "logs" / "first.log").exists()


def test_a_failed_job_is_reported_and_stops_only_those_that_need_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = [
        job(tmp_path, "t/train/bad", "print", "one", "print", "it hurts", "exit", "3"),
        Job("t/silent", ("print", "done"), tmp_path / "never"),
        job(tmp_path, "needs-bad", needs=("t/train/bad",)),
        job(tmp_path, "needs-that", needs=("good", "needs-bad")),
        job(tmp_path, "good"),
        Job("mute", ("exit", "4"), tmp_path / "never too"),
    ]
    logs = tmp_path / "logs"
    result = run_jobs(jobs, logs=logs, workers=2, program=STUB)
    assert result.finished == ("good",)
    assert result.blocked == ("needs-bad", "needs-that")
    assert result.failed == (
        Failure("t/train/bad", "exit status 3", "it hurts", logs / "t/train/bad.log"),
        Failure("t/silent", f"ended without {tmp_path / 'never'}", "done", logs / "t/silent.log"),
        Failure("mute", "exit status 4", "", logs / "mute.log"),
    )
    table = failure_table(result).splitlines()
    assert table[0] == f"t/train/bad  failed   exit status 3: it hurts ({logs / 't/train/bad.log'})"
    assert (
        table[2] == f"mute         failed   exit status 4: its log is empty ({logs / 'mute.log'})"
    )
    assert table[4] == "needs-that   blocked  a job that it needs failed"
    said = capsys.readouterr().err
    assert f"t/train/bad failed: exit status 3: it hurts ({logs / 't/train/bad.log'})" in said
    assert "1/6" in said
    assert "6/6" not in said
    assert "100%" not in said
    assert "3 failed, 2 blocked" in said


def test_a_log_has_a_header_grows_and_its_last_line_is_of_the_last_run(tmp_path: Path) -> None:
    first = Job("a/b", ("print", "it hurts", "exit", "3"), tmp_path / "x")
    second = Job("a/b", ("environment", "OMP_NUM_THREADS", "exit", "3"), tmp_path / "x")
    third = Job("a/b", ("exit", "3"), tmp_path / "x")
    lines = []
    for one in (first, second, third):
        result = run_jobs([one], logs=tmp_path, workers=1, quiet=True, program=STUB)
        lines.append(result.failed[0].last_line)
    assert lines == ["it hurts", "1", ""]
    log = (tmp_path / "a/b.log").read_text()
    headers = [line for line in log.splitlines() if line.startswith("# 2")]
    assert len(headers) == 3
    assert f"{socket.gethostname()}: {sys.executable} -S -c" in headers[0]
    assert " exit 3\n" in log
    assert not (tmp_path / "a/b.lock").exists()


def test_a_progress_bar_in_the_log_is_not_one_line(tmp_path: Path) -> None:
    one = Job("bar", ("print", "10%\r50%\rstopped", "exit", "1"), tmp_path / "x")
    result = run_jobs([one], logs=tmp_path, workers=1, quiet=True, program=STUB)
    assert result.failed[0].last_line == "stopped"


def test_as_many_at_once_as_there_are_workers(tmp_path: Path) -> None:
    # Each waits for the other; with one worker neither would end.
    files = [str(tmp_path / name) for name in "ab"]
    jobs = [
        job(tmp_path, "a1", "write", files[0], "await", files[1]),
        job(tmp_path, "b1", "write", files[1], "await", files[0]),
    ]
    result = run_jobs(jobs, logs=tmp_path, workers=2, quiet=True, program=STUB)
    assert result.finished == ("a1", "b1")
    # And never more: a third would find both others at work.
    count = tmp_path / "count"
    more = [
        job(tmp_path, f"c{k}", "note", str(count), "<", "sleep", "0.1", "note", str(count), ">")
        for k in range(3)
    ]
    run_jobs(more, logs=tmp_path, workers=1, quiet=True, program=STUB)
    assert count.read_text() == "<><><>"


def test_a_program_that_cannot_start_is_a_failed_job(tmp_path: Path) -> None:
    jobs = [job(tmp_path, "a"), job(tmp_path, "b", needs=("a",))]
    result = run_jobs(jobs, logs=tmp_path, workers=1, quiet=True, program=("/no/such/program",))
    assert "/no/such/program" in result.failed[0].reason
    assert result.blocked == ("b",)
    assert not (tmp_path / "a.lock").exists()


@pytest.mark.parametrize(
    ("needs", "message"),
    [
        ({"a": (), "b": ("c",)}, "job 'b' needs 'c', and there is no such job"),
        ({"a": ("a",)}, "no job of a circle can be first: 'a' needs 'a'"),
        ({"a": ("b",), "b": ("a",)}, "no job of a circle can be first: 'a' needs 'b' needs 'a'"),
        ({"../a": ()}, "job '../a': its name must be a relative path"),
        ({"/a": ()}, "job '/a': its name must be a relative path"),
        ({"a//b": ()}, "job 'a//b': its name must be a relative path"),
        ({"": ()}, "job '': its name must be a relative path"),
    ],
)
def test_lists_of_jobs_that_cannot_be_run(
    tmp_path: Path, needs: dict[str, tuple[str, ...]], message: str
) -> None:
    jobs = [Job(name, (), tmp_path / "x", need) for name, need in needs.items()]
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        run_jobs(jobs, logs=tmp_path)


def test_options_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = [Job("a", (), tmp_path / "x")]
    with pytest.raises(ValueError, match="^two jobs are named 'a'$"):
        run_jobs([*one, *one], logs=tmp_path)
    with pytest.raises(ValueError, match="^workers must be at least 1, not 0$"):
        run_jobs(one, logs=tmp_path, workers=0)
    with pytest.raises(ValueError, match="^an address is that of a Ray cluster: it needs the back"):
        run_jobs(one, logs=tmp_path, address="auto")
    monkeypatch.setitem(sys.modules, "ray", None)
    message = r"^the backend ray needs Ray: pip install 'dead-ends\[cluster\]'$"
    with pytest.raises(ValueError, match=message):
        run_jobs(one, logs=tmp_path, backend="ray")


def test_the_default_is_one_worker_a_core() -> None:
    with open_runner("local", None, None) as runner:
        assert runner.workers == len(os.sched_getaffinity(0))


# Locks


def test_a_lock_is_held_by_one_and_says_by_whom(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    with JobLock(path) as lock:
        lock.sign(1234)
        with pytest.raises(LockHeldError) as error:
            JobLock(path)
    host = socket.gethostname()
    assert str(error.value) == f"it is the work of process 1234 on {host} (lock file {path})"
    assert list(tmp_path.iterdir()) == []
    with JobLock(path):
        assert path.read_text() == f"process {os.getpid()} on {host}"


def test_a_dead_owner_of_this_host_has_a_successor(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    code = "import os, sys; from pathlib import Path; from deep.runs.lock import JobLock; "
    code += "JobLock(Path(sys.argv[1])); os._exit(0)"
    subprocess.run([sys.executable, "-c", code, str(path)], cwd=ROOT, check=True)
    assert socket.gethostname() in path.read_text()
    with JobLock(path):
        assert path.read_text().startswith(f"process {os.getpid()} on ")
        with pytest.raises(LockHeldError):
            JobLock(path)
    path.write_text("process 1 on another-host")  # whether it lives cannot be known from here
    with pytest.raises(LockHeldError, match="process 1 on another-host"):
        JobLock(path)


def test_a_lock_outlives_its_maker_in_the_process_of_the_job(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    lock = JobLock(path)
    child = subprocess.Popen([*STUB, "sleep", "60"], pass_fds=(lock.handle,))
    try:
        os.close(lock.handle)  # as if the maker were dead
        with pytest.raises(LockHeldError):
            JobLock(path)
    finally:
        child.kill()
        child.wait()
    with JobLock(path):
        pass


def test_of_many_that_want_a_stale_lock_one_gets_it(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    for _ in range(20):
        path.write_text(f"process 1 on {socket.gethostname()}")
        start, got = threading.Barrier(8), []

        def take(start: threading.Barrier = start, got: list[JobLock] = got) -> None:
            start.wait()
            try:
                got.append(JobLock(path))
            except LockHeldError:
                return

        threads = [threading.Thread(target=take) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(got) == 1
        with got[0]:
            pass


def test_a_file_that_its_owner_removes_meanwhile_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.lock"
    path.write_text(f"process 1 on {socket.gethostname()}")
    stale = path.stat()
    flock = fcntl.flock

    def owner_goes_first(handle: int, operation: int) -> None:
        if path.exists() and os.path.samestat(os.fstat(handle), stale):
            path.unlink()
        flock(handle, operation)

    monkeypatch.setattr("deep.runs.lock.fcntl.flock", owner_goes_first)
    with JobLock(path) as lock:
        assert os.path.samestat(path.stat(), os.fstat(lock.handle))


def test_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("deep.runs.lock.fcntl.flock", refuse)
    with pytest.raises(ValueError, match=r"a\.lock: the file system knows no locks \(Function not"):
        JobLock(tmp_path / "a.lock")
    assert list(tmp_path.iterdir()) == []


def test_two_calls_at_once_run_no_job_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deep.study.schedule.ELSEWHERE_PAUSE", 0.05)
    count = tmp_path / "count"
    jobs = [job(tmp_path, f"j{k}", "note", str(count), str(k), "sleep", "0.1") for k in range(4)]
    results = []

    def run() -> None:
        results.append(run_jobs(jobs, logs=tmp_path / "logs", workers=2, program=STUB))

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(count.read_text()) == ["0", "1", "2", "3"]
    one, two = results
    assert {*one.finished, *two.finished} == {"j0", "j1", "j2", "j3"}
    assert not {*one.finished} & {*two.finished}
    assert {*one.finished, *one.skipped} == {*two.finished, *two.skipped}
    assert "waits: it is the work of process" in capsys.readouterr().err


def test_who_gets_the_lock_too_late_finds_the_result(tmp_path: Path) -> None:
    (tmp_path / "result").touch()
    late = JobProcess((*STUB, "exit", "1"), tmp_path, tmp_path / "result", tmp_path / "a.log")
    assert run_process(late).ending is Ending.SKIPPED


# Interrupts

CALL = """
import json, sys
from pathlib import Path
from deep.study.schedule import Job, run_jobs
program, folder, backend, *jobs = json.loads(sys.argv[1])
jobs = [Job(name, tuple(words), Path(folder) / f"{name}.result") for name, words in jobs]
try:
    run_jobs(jobs, logs=Path(folder), workers=2, backend=backend, quiet=True, program=program)
except KeyboardInterrupt:
    sys.exit(77)
"""


@pytest.fixture
def calls() -> Iterator[list[subprocess.Popen[str]]]:
    """Calls that a test starts; ended with it, pass or fail."""
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


def call(
    calls: list[subprocess.Popen[str]], folder: Path, *jobs: tuple[str, list[str]],
    backend: str = "local",
) -> subprocess.Popen[str]:  # fmt: skip
    """Jobs run by another process, which can be interrupted."""
    process = subprocess.Popen(
        [sys.executable, "-c", CALL, json.dumps([STUB, str(folder), backend, *jobs])],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    calls.append(process)
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_lets_every_process_save_and_starts_no_other(
    tmp_path: Path, calls: list[subprocess.Popen[str]], number: signal.Signals
) -> None:
    jobs = [
        (k, ["polite", str(tmp_path / f"{k}.saved"), "own", str(tmp_path / f"{k}.own")])
        for k in "abc"
    ]
    process = call(calls, tmp_path, *((name, [*words, "sleep", "60"]) for name, words in jobs))
    children = [int(wait_for(tmp_path / f"{k}.own")) for k in "ab"]
    process.send_signal(number)
    said, _ = process.communicate(timeout=90)
    assert process.returncode == 77, said
    assert not any(map(is_alive, children))
    assert {p.name for p in tmp_path.iterdir() if p.suffix == ".saved"} == {"a.saved", "b.saved"}
    assert not (tmp_path / "c.own").exists()
    assert not list(tmp_path.glob("*.lock"))


def test_a_second_interrupt_ends_what_does_not_listen(
    tmp_path: Path, calls: list[subprocess.Popen[str]]
) -> None:
    process = call(calls, tmp_path, ("a", ["deaf", "own", str(tmp_path / "own"), "sleep", "60"]))
    child = int(wait_for(tmp_path / "own"))
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None  # it waits for the child
    assert is_alive(child)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=90)
    assert process.returncode == 77
    assert not is_alive(child)


def test_patience_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    patience = ((signal.SIGINT, 0.1), (signal.SIGTERM, 5.0))
    monkeypatch.setattr("deep.study.job_process.PATIENCE", patience)
    own = tmp_path / "own"
    arguments = (*STUB, "deaf", "own", str(own), "sleep", "60")
    deaf = JobProcess(arguments, tmp_path, tmp_path / "result", tmp_path / "a.log")
    with pytest.raises(KeyboardInterrupt):
        run_process(deaf, lambda: int(own.exists() and own.read_text().endswith("\n")))
    assert not is_alive(int(own.read_text()))


def test_who_took_over_the_job_of_a_killed_call_waits_for_its_process(
    tmp_path: Path, calls: list[subprocess.Popen[str]]
) -> None:
    go, count = tmp_path / "go", tmp_path / "count"
    one = job(
        tmp_path, "a", "note", str(count), "x", "own", str(tmp_path / "own"), "await", str(go)
    )
    process = call(calls, tmp_path, ("a", list(one.command)))
    child = int(wait_for(tmp_path / "own"))
    process.kill()
    process.communicate()
    assert is_alive(child)
    waiting = run_process(JobProcess(STUB, tmp_path, one.result, tmp_path / "a.log"))
    assert waiting.ending is Ending.ELSEWHERE
    assert f"process {child} on" in waiting.reason
    go.touch()
    result = run_jobs([one], logs=tmp_path, workers=1, quiet=True, program=STUB)
    assert (result.skipped, count.read_text()) == (("a",), "x")


# The real program, and Ray

COLLECT = ("collect", "--task", "brake", "--transitions", "300", "--out")


def test_real_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    data = tmp_path / "brake.hdf5"
    jobs = [
        Job("brake/data", (*COLLECT, str(data)), data),
        Job("bike", ("collect", "--task", "bike", "--out", str(tmp_path / "b")), tmp_path / "b"),
    ]
    result = run_jobs(jobs, logs=tmp_path, workers=2, quiet=True)
    assert result.finished == ("brake/data",)
    assert result.failed[0].reason == "exit status 2"
    assert result.failed[0].last_line.startswith("deep: there is no task 'bike'")
    assert "brake.hdf5: 300 transitions" in (tmp_path / "brake/data.log").read_text()


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # Ray's own: log files and its processes
def test_ray_runs_the_same_with_the_same_reports(tmp_path: Path) -> None:
    order, later = tmp_path / "order", (tmp_path / "none")
    jobs = [
        job(tmp_path, "c", "note", str(order), "c", needs=("a", "b")),
        job(tmp_path, "a", "note", str(order), "a"),
        job(tmp_path, "b", "await", str(order), "note", str(order), "b"),
        Job("bad", ("environment", "OMP_NUM_THREADS", "exit", "3"), later),
        Job("blocked", (), later, ("bad",)),
        Job("skipped", ("exit", "1"), tmp_path),
    ]
    result = run_jobs(
        jobs, logs=tmp_path / "logs", workers=2, backend="ray", quiet=True, program=STUB
    )
    assert order.read_text() == "abc"
    assert result.finished == ("c", "a", "b")
    assert result.failed == (Failure("bad", "exit status 3", "1", tmp_path / "logs/bad.log"),)
    assert (result.skipped, result.blocked) == (("skipped",), ("blocked",))


def test_an_interrupt_reaches_the_processes_of_ray(
    tmp_path: Path, calls: list[subprocess.Popen[str]]
) -> None:
    words = ["polite", str(tmp_path / "saved"), "own", str(tmp_path / "own"), "sleep", "60"]
    process = call(calls, tmp_path, ("a", words), backend="ray")
    child = int(wait_for(tmp_path / "own"))
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=90)
    assert process.returncode == 77, said
    assert (tmp_path / "saved").exists()
    assert not is_alive(child)
    assert not (tmp_path / "a.lock").exists()
