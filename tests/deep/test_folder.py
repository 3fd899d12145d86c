"""What run folders share: logs that survive a kill, versions, and a polite Ctrl-C."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

from deep.folder import CsvLog, InterruptAfterUpdate, versions


def test_a_log_drops_what_came_after_the_checkpoint_and_half_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    log = CsvLog(path, ("step", "a", "b"), 0)
    assert path.read_text().splitlines() == ["step,a,b"]
    log.write([(10, "x", ""), (10, "y", 2)])
    log.write([(20, "x", 3)])
    log.write([(30, "x", 4)])
    with path.open("a") as file:
        file.write("40,x")
    CsvLog(path, ("step", "a", "b"), 20).write([(25, "z", 5)])
    rows = ["step,a,b", "10,x,", "10,y,2", "20,x,3", "25,z,5"]
    assert path.read_text().splitlines() == rows
    # A row that is written by half may look like a smaller number.
    with path.open("a") as file:
        file.write("2,x,6")
    CsvLog(path, ("step", "a", "b"), 25)
    assert path.read_text().splitlines() == rows
    CsvLog(path, ("step", "a", "b"), 9)
    assert path.read_text().splitlines() == rows[:1]


def test_versions_name_what_the_numbers_hang_on() -> None:
    found = versions()
    assert set(found) == {"numpy", "torch", "gymnasium", "safetensors", "python", "git"}
    assert all(isinstance(version, str) for version in found.values())


def test_an_interrupt_waits_to_be_asked_for() -> None:
    before = signal.getsignal(signal.SIGINT)
    with InterruptAfterUpdate() as interrupt:
        assert not interrupt.asked
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.asked
    assert signal.getsignal(signal.SIGINT) is before


def test_outside_the_main_thread_interrupts_are_left_alone() -> None:
    before = signal.getsignal(signal.SIGINT)
    handlers = []

    def work() -> None:
        with InterruptAfterUpdate() as interrupt:
            handlers.append((signal.getsignal(signal.SIGINT), interrupt.asked))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [(before, False)]
