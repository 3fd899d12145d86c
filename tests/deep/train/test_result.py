"""A run's result: what is written is what is read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from deep.runs.record import Record
from deep.train.episodes import Episodes
from deep.train.result import Budget, SeedResult, read_result, read_seeds, write_result


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    ends = np.array([True, False])
    found = Episodes(np.array([3.0, 4.0]), np.array([2, 8]), ends, np.array([1, 1]))
    trained = SeedResult.of(4, found, tv=7, episodes=9, training_arr=0.5, threshold=2.0)
    assert (trained.tv, trained.episodes, trained.training_arr) == (7, 9, 0.5)
    plain = SeedResult.of(3, found)
    assert (plain.acr, plain.avr, plain.arr, plain.length) == (3.5, 0.5, 0.2, 5.0)
    assert (plain.tv, plain.episodes, plain.training_arr, plain.threshold) == (None,) * 4
    budget = Budget(None, 20, 1.5, 2)
    write_result(tmp_path, "brake", "sac", budget, [trained, plain], policies="there")
    assert read_result(tmp_path).seeds == (trained, plain)
    record = Record.read(tmp_path / "result.json")
    assert read_seeds(record) == (trained, plain)
    assert Budget.from_record(record.record("budget")) == budget
    content = json.loads((tmp_path / "result.json").read_text())
    assert (content["task"], content["policies"]) == ("brake", "there")
