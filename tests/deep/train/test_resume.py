"""Online runs that were killed end as if nothing had happened."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deep.pretraining import RrlSettings
from deep.tasks.vectorised import Fleet
from deep.train.config import TrainConfig, train_config_to_json
from deep.train.replay import Replay
from deep.train.run import train
from tests.deep.online_runs import SEEDS, TINY, WRAPPED, pretrained, raw_replay, table


@pytest.fixture(scope="module")
def rrl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = RrlSettings(hidden=(8,), batch_size=16)
    return pretrained(tmp_path_factory.mktemp("rrl"), settings)


class Killed(BaseException):
    """Stands for the end of the process."""


def killed_after(step: int, config: TrainConfig, folder: Path) -> None:
    """Run until step ``step`` (0, 1, ...) is in the replay buffer, and no further."""
    add = Replay.add

    def last(self: Replay, now: int, arrival: object) -> None:
        add(self, now, arrival)  # type: ignore[arg-type]  # passed through
        if now == step:
            raise Killed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Replay, "add", last)
        with pytest.raises(Killed):
            train(config, folder, quiet=True)


def outcome(folder: Path) -> dict[str, object]:
    """Everything that a run says but for the time it took."""
    result = json.loads((folder / "result.json").read_text())
    del result["made with"], result["budget"]["wall_seconds"]
    kept = {
        f"{kind}/{path.name}": path.read_bytes()
        for kind in ("policies", "filters")
        for path in sorted((folder / kind).glob("*"))
    }
    logs = {name: table(folder / name) for name in ("progress.csv", "evaluations.csv")}
    return {"result": result, **kept, **logs}


@pytest.mark.parametrize("steps", [(9, 16, 29, 31, 44, 59), (58,)])
def test_killed_at_any_step(steps: tuple[int, ...], tmp_path: Path) -> None:
    # A checkpoint every 15 steps of 60; 20 begin at random; the buffer holds 20 and slack.
    train(WRAPPED, tmp_path / "whole", quiet=True)
    for step in steps:
        killed_after(step, WRAPPED, tmp_path / "killed")
    train(WRAPPED, tmp_path / "killed", quiet=True)
    assert outcome(tmp_path / "killed") == outcome(tmp_path / "whole")


def test_killed_while_the_buffer_wrapped_before_the_start_was_over(tmp_path: Path) -> None:
    config = replace(WRAPPED, start_steps=160)
    train(config, tmp_path / "whole", quiet=True)
    killed_after(44, config, tmp_path / "killed")
    train(config, tmp_path / "killed", quiet=True)
    assert outcome(tmp_path / "killed") == outcome(tmp_path / "whole")


def test_a_finetuned_run_goes_on_too(rrl: Path, tmp_path: Path) -> None:
    config = replace(WRAPPED, safety=rrl, threshold=(0.5,))
    train(config, tmp_path / "whole", quiet=True)
    for step in (18, 47):
        killed_after(step, config, tmp_path / "killed")
    train(config, tmp_path / "killed", quiet=True)
    found = outcome(tmp_path / "killed")
    assert found == outcome(tmp_path / "whole")
    assert {"filters/seed0.safetensors", "policies/seed3.safetensors"} < set(found)


def test_a_process_that_is_killed_again_and_again(tmp_path: Path) -> None:
    subprocess.run(
        [
            *(sys.executable, "-m", "tests.deep.killed_runs"),
            *(json.dumps(train_config_to_json(WRAPPED)), str(tmp_path)),
        ],
        cwd=Path(__file__).parents[3],
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        check=True,
    )
    assert outcome(tmp_path / "killed") == outcome(tmp_path / "whole")


def test_an_interrupt_saves_and_is_passed_on(tmp_path: Path) -> None:
    train(TINY, tmp_path / "whole", quiet=True)
    add = Replay.add

    def interrupted(self: Replay, now: int, arrival: object) -> None:
        add(self, now, arrival)  # type: ignore[arg-type]  # passed through
        if now == 36:
            os.kill(os.getpid(), signal.SIGINT)

    folder = tmp_path / "interrupted"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Replay, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(TINY, folder, quiet=True)
    stamp = (folder / "checkpoint.safetensors").stat().st_mtime_ns
    killed_after(37, TINY, folder)  # the step after: nothing was lost, nothing is saved yet
    assert (folder / "checkpoint.safetensors").stat().st_mtime_ns == stamp
    train(TINY, folder, quiet=True)
    assert outcome(folder) == outcome(tmp_path / "whole")


def test_environments_that_cannot_be_kept_begin_new_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Safety-Gymnasium's own do: what was under way is in no count of episodes."""
    monkeypatch.setattr(Fleet, "snapshot", lambda _: None)
    killed_after(31, TINY, tmp_path)
    trained = train(TINY, tmp_path, quiet=True)
    columns = raw_replay(tmp_path, TINY)
    # The seam: whatever was under way is cut off there, as by the clock.
    assert np.array_equal(columns["timeout"][:, 29], 1 - columns["terminal"][:, 29])
    train(TINY, tmp_path / "whole", quiet=True)
    uncut = raw_replay(tmp_path / "whole", TINY)
    assert np.array_equal(columns["terminal"][:, :30], uncut["terminal"][:, :30])
    columns["timeout"][:, 29] = uncut["timeout"][:, 29]
    first, fresh = (Fleet("brake", SEEDS, 4).reset(step) for step in (0, 30))
    assert not (first == fresh).any()  # or a run that is killed often sees the same ones
    for k in range(2):
        assert np.array_equal(columns["observation"][k, 30], fresh[k])
        ended = columns["terminal"][k, :60] + columns["timeout"][k, :60]
        assert trained.seeds[k].episodes == ended.sum()
        assert trained.seeds[k].tv == columns["cost"][k, :60].sum()
        # Episodes of the rows 160 to 200 that began after the restart at 120.
        since = ended[30:]
        lengths, running = [], np.zeros(4)
        for step, over in enumerate(since):
            running += 1
            if step < 10:
                lengths.extend(running[over == 1])
            running[over == 1] = 0
        row = [r for r in table(tmp_path / "progress.csv") if r["step"] == "160"][k]
        assert float(row["length"]) == pytest.approx(np.mean(lengths), rel=1e-5)


def test_a_run_without_its_replay_buffer_or_with_anothers_does_not_go_on(tmp_path: Path) -> None:
    killed_after(31, TINY, tmp_path)
    replay = tmp_path / "replay.bin"
    content = replay.read_bytes()
    replay.write_bytes(content[:-4])
    with pytest.raises(ValueError, match="replay.bin: not the replay buffer of this run$"):
        train(TINY, tmp_path, quiet=True)
    replay.unlink()
    for _ in range(2):
        with pytest.raises(
            ValueError, match="replay.bin: the run cannot go on without its replay buffer$"
        ):
            train(TINY, tmp_path, quiet=True)
    replay.write_bytes(content)
    (tmp_path / "checkpoint.safetensors").write_text("no")
    with pytest.raises(ValueError, match="checkpoint.safetensors: not a checkpoint of this run "):
        train(TINY, tmp_path, quiet=True)
