"""Algorithm 1 in memory: the filters of a run in a folder, without the folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deep import Transitions, pretrain
from deep.data.formats import write_hdf5
from deep.pretraining import DeaRrlAnnealedSettings, RrlSettings
from deep.pretraining.config import Mix, PretrainConfig
from deep.pretraining.run import pretrain_in_folder
from deep.tasks import make_task

SMALL = {"hidden": (8,), "batch_size": 16}


@pytest.fixture(scope="module")
def log() -> Transitions:
    """Random actions on the braking task, in units of its own."""
    data = Mix(transitions=400).collect(make_task("brake"), np.random.default_rng(0))
    return replace(data, actions=data.actions * 3 + 1)


@pytest.mark.parametrize("method", [DeaRrlAnnealedSettings(**SMALL), RrlSettings(**SMALL)])
def test_it_learns_what_a_run_in_a_folder_learns(
    method: DeaRrlAnnealedSettings | RrlSettings,
    log: Transitions,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = {"method": method, "seeds": (2, 5), "updates": 20, "horizon": 3, "sharpness": 2.0}
    settings |= {"action_low": (-2.5,), "action_high": (4.5,)}
    found = pretrain(log, quiet=True, **settings)  # type: ignore[arg-type]  # of several types
    assert list(tmp_path.iterdir()) == []
    write_hdf5(log, tmp_path / "log.hdf5")
    config = PretrainConfig(data=tmp_path / "log.hdf5", **settings)  # type: ignore[arg-type]
    expected = pretrain_in_folder(config, tmp_path / "run", quiet=True)
    assert [f.to_text() for f in found.filters] == [f.to_text() for f in expected.filters]
    assert found.health == expected.health


def test_what_cannot_be_used_is_refused(log: Transitions) -> None:
    with pytest.raises(ValueError, match="give the horizon"):
        pretrain(log)
    with pytest.raises(ValueError, match="updates must be at least 1, not 0"):
        pretrain(log, 3, updates=0)
    with pytest.raises(ValueError, match="outside of their bounds"):
        pretrain(log, 3, action_low=[0], action_high=[1])
    with pytest.raises(ValueError, match="give both action_low and action_high"):
        pretrain(log, 3, action_low=[0])


def test_a_loss_that_is_no_number_is_named(log: Transitions) -> None:
    method = DeaRrlAnnealedSettings(learning_rate=1e38, **SMALL)
    with pytest.raises(FloatingPointError, match="update 20"):
        pretrain(log, 3, method=method, updates=20, quiet=True)
