"""The benchmarks beside Stable-Baselines3: what they compute from what they measure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import learner, learning_curves
from benchmarks.learning_curves import Course, figure, our_curves, their_curves, verdict
from benchmarks.sb3 import Idle, filled_sac, stable_baselines3_sac
from deep.tasks.task import Sizes
from deep.train.sac import Sac, SacSettings

TINY = SacSettings(hidden=(8,), batch_size=16, final_rate=1, reward_scale=1)


def test_ratios_are_those_of_neighbours() -> None:
    row = learner.compared([10.0, 40.0, 20.0], [10.0, 20.0, 5.0])
    assert row == {
        "ours": 20.0,
        "stable_baselines3": 10.0,
        "ratio": 2.0,
        "least_ratio": 1.0,
        "greatest_ratio": 4.0,
    }
    (line,) = learner.table([row | {"width": 64, "batch_size": 32, "seeds": 8}])[2:]
    assert line == "| 64 x 64 | 32 | 8 | 20 | 10 | 2.00 | 1.00 to 4.00 |"


def test_a_rate_counts_the_updates_of_all_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0.0

    def updates(count: int) -> None:
        nonlocal clock
        clock += 0.5 * count

    monkeypatch.setattr(learner, "process_time", lambda: clock)
    assert learner.rate(updates, 10, 4) == 8
    assert learner.count_for(updates, 7.0) == 14


def test_both_tools_really_update(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Sac] = []

    def kept(settings: SacSettings, sizes: Sizes, seeds: range) -> Sac:
        made.append(Sac(settings, sizes, seeds))
        return made[-1]

    monkeypatch.setattr(learner, "Sac", kept)
    updates = learner.our_updates(TINY, 2, tmp_path, replay=200)
    (ours,) = made
    before = [p.clone() for p in ours.parameters()]
    updates(3)
    assert not any(
        torch.equal(old, new) for old, new in zip(before, ours.parameters(), strict=True)
    )
    assert all(len(p) in (2, 4) for p in ours.parameters())  # two seeds, of twins and policies

    theirs = filled_sac(TINY, 60, 2, 200)
    assert theirs.replay_buffer is not None
    assert theirs.replay_buffer.size() == 200
    theirs.train(3, TINY.batch_size)
    assert theirs._n_updates == 3
    learner.their_updates(TINY, 200)(2)


def test_their_settings_are_ours() -> None:
    model = stable_baselines3_sac(
        Idle(3, 1), replace(TINY, temperature=0.1), seed=0, start_steps=7, replay=50
    )
    assert (model.gamma, model.tau, model.batch_size) == (0.99, 0.005, 16)
    assert (model.learning_starts, model.buffer_size, model.gradient_steps) == (7, 50, 1)
    assert model.lr_schedule(1.0) == model.lr_schedule(0.01) == 1e-3
    assert model.ent_coef_tensor.item() == pytest.approx(0.1)
    assert [p.shape[0] for p in model.actor.latent_pi.parameters()] == [8, 8]
    for settings in (replace(TINY, final_rate=0.5), replace(TINY, reward_scale=100.0)):
        with pytest.raises(ValueError, match="^only a constant learning rate and unscaled rewards"):
            stable_baselines3_sac(Idle(3, 1), settings, seed=0, start_steps=7, replay=50)


def test_curves_that_differ_less_than_their_seeds_are_equal() -> None:
    rng = np.random.default_rng(0)
    curves = rng.normal(size=(8, 5)) + 10 * rng.normal(size=(8, 1))
    shuffled = rng.permutation(curves)
    same = verdict(curves, shuffled, rng)
    assert same["equal"]
    assert same["difference"] == pytest.approx(0)
    assert same["mann_whitney_p"] == 1
    low, high = same["interval"]
    deviation = np.sqrt(2 * curves.mean(axis=1).var() / 8)  # of the bootstrap's difference
    assert (low, high) == pytest.approx((-1.96 * deviation, 1.96 * deviation), rel=0.1)
    other = verdict(curves + 30, shuffled, rng)
    assert not other["equal"]
    assert other["difference"] == pytest.approx(30)
    assert other["interval"] == pytest.approx([30 + low, 30 + high], rel=0.03)
    assert other["mann_whitney_p"] < 0.01
    # Wilcoxon's pairs the seeds: a small gain of every one of eight is 2 / 2**8.
    gained = verdict(curves + 0.1, curves, rng)
    assert gained["equal"]
    assert gained["wilcoxon_p"] == pytest.approx(2 / 2**8)


def test_both_tools_are_evaluated_at_the_same_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning_curves, "EPISODES", 1)
    course = Course("Pendulum-v1", temperature=0.2, steps=60, start_steps=30, every=20)
    assert course.moments == [40, 60]
    ours = our_curves(course, TINY, (0, 5), tmp_path)
    theirs = their_curves(course, TINY, (0, 5))
    for curves in (ours, theirs):
        assert curves.shape == (2, 2)
        assert ((curves < 0) & (curves > -2000)).all()
        assert not np.allclose(curves[0], curves[1])  # each seed its own
        assert not np.allclose(ours, theirs)
    row = {"environment": "Pendulum-v1", "moments": course.moments, "steps": 60}
    row |= {"ours": ours.tolist(), "theirs": theirs.tolist()}
    drawn = figure([row])
    assert len(drawn.axes[0].lines) == 6
    costs = {"our_seconds": 1.0, "their_seconds": 2.4}
    (line,) = learning_curves.table(
        [row | costs | verdict(ours, theirs, np.random.default_rng(0))]
    )[2:]
    assert line.startswith("| Pendulum-v1 | 60 | -")
    assert line.endswith("| 1 | 2 |")
