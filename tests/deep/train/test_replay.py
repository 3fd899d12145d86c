"""The replay buffer: what is remembered, how rows are drawn, what comes back out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from deep.data.normalisation import Normalisation, TensorNormalisation, centre_and_scale
from deep.train.noise import ActionNoise
from deep.train.replay import Arrival, Replay

SEEDS = (2, 7)
COPIES, CAPACITY, SLACK = 3, 10, 4


def buffer(path: Path, seeds: tuple[int, ...] = SEEDS) -> Replay:
    return Replay(path / "replay.bin", seeds, COPIES, CAPACITY, SLACK, 2, 1)


def arrival(step: int, copies: int = COPIES) -> Arrival:
    """Numbers that say where they belong: seed, step and copy; episodes of five steps.

    Every second episode ends in a violation, the others by the clock.
    """
    k, n = np.meshgrid(np.arange(2), np.arange(copies), indexing="ij")
    number = 10_000 * k + 100 * step + n
    last = np.full_like(number, step % 5 == 4)
    violation = last * ((step // 5 + n) % 2 == 0)
    return Arrival(
        observation=np.stack([number, n], axis=-1),
        action=number[..., None] + 0.25,
        executed=number[..., None] + 0.5,
        next_observation=np.stack([number + 100, n], axis=-1),
        reward=number + 0.125,
        cost=violation,
        terminal=violation,
        timeout=last - violation,
    )


def filled(path: Path, steps: int) -> Replay:
    replay = buffer(path)
    for step in range(steps):
        replay.add(step, arrival(step))
    return replay


def numbers(replay: Replay, steps: int, updates: int = 128) -> np.ndarray:
    """The observations' first coordinate of many batches: (K, updates * 32)."""
    batches = [replay.sample(update, steps, 32).observation for update in range(updates)]
    return np.concatenate([batch[..., 0].numpy() for batch in batches], axis=1)


@pytest.mark.parametrize("steps", [1, 6, 10, 14, 23, 57])
def test_what_is_drawn_is_the_last_capacity_and_all_of_it(steps: int, tmp_path: Path) -> None:
    drawn = numbers(filled(tmp_path, steps), steps)
    window = range(max(0, steps - CAPACITY), steps)
    for k in range(2):
        expected = {10_000 * k + 100 * step + n for step in window for n in range(COPIES)}
        assert set(drawn[k]) == expected


def test_rows_are_drawn_uniformly_from_the_window(tmp_path: Path) -> None:
    drawn = numbers(filled(tmp_path, 23), 23)
    for row in drawn:
        _, counts = np.unique(row, return_counts=True)
        cells = COPIES * CAPACITY
        assert len(counts) == cells
        expected = row.size / cells
        chi_square = float(((counts - expected) ** 2 / expected).sum())
        # 29 degrees of freedom: mean 29, deviation sqrt(58).
        assert abs(chi_square - (cells - 1)) < 4 * math.sqrt(2 * (cells - 1))
    places = drawn % 10_000
    assert not np.array_equal(places[0], places[1])  # each seed its own


def test_the_columns_of_a_batch_belong_together(tmp_path: Path) -> None:
    replay = filled(tmp_path, 23)
    batch = replay.sample(3, 23, 64)
    assert all(tensor.dtype.is_floating_point for tensor in batch)
    number, n = batch.observation[..., 0], batch.observation[..., 1]
    assert batch.action[..., 0].equal(number + 0.25)  # actions stay as they are
    assert batch.executed[..., 0].equal(number + 0.5)
    assert batch.next_observation[..., 0].equal(number + 100)
    assert batch.reward.equal(number + 0.125)
    step = (number % 10_000) // 100
    last = step % 5 == 4
    violation = last & ((step // 5 + n) % 2 == 0)
    assert batch.cost.equal(violation.float())
    assert batch.terminal.equal(violation.float())  # a timeout is no terminal state
    assert bool((last & ~violation).any())


def test_a_batch_is_a_function_of_seed_and_update(tmp_path: Path) -> None:
    replay = filled(tmp_path, 12)
    first = replay.sample(70, 12, 8)
    replay.sample(3, 12, 8)
    for old, new in zip(first, replay.sample(70, 12, 8), strict=True):
        assert old.equal(new)
    (tmp_path / "alone").mkdir()
    alone = buffer(tmp_path / "alone", (7,))
    for step in range(12):
        alone.add(step, Arrival(*(part[1:] for part in arrival(step))))
    for both, one in zip(first, alone.sample(70, 12, 8), strict=True):
        assert both[1:].equal(one)
    others = (replay.sample(update, 12, 8) for update in (6, 71))
    for other in others:
        assert not first.observation.equal(other.observation)
        assert not first.noise.equal(other.noise)
    assert not first.noise.equal(first.next_noise)
    assert first.noise.shape == first.next_noise.shape == first.action.shape
    noise = np.concatenate([replay.sample(u, 12, 8).noise.numpy() for u in range(200)])
    assert [noise.mean(), noise.std()] == pytest.approx([0, 1], abs=0.06)


def test_rows_of_a_lost_stretch_do_not_lie_over_the_window(tmp_path: Path) -> None:
    kept, killed = 30, 30 + SLACK
    replay = filled(tmp_path, kept)
    expected = replay.sample(5, kept, 32).observation
    for step in range(kept, killed):
        replay.add(step, arrival(step))
    assert replay.sample(5, kept, 32).observation.equal(expected)
    replay.add(killed, arrival(killed))  # one step more than the slack: the oldest is lost
    oldest, lost = 100 * (kept - CAPACITY), 100 * killed
    assert {int(x) // 100 * 100 for x in numbers(replay, kept)[0]} == {
        *range(oldest + 100, 100 * kept, 100), lost
    }  # fmt: skip


def test_the_file_outlives_the_buffer(tmp_path: Path) -> None:
    first = filled(tmp_path, 12)
    first.flush()
    again = buffer(tmp_path)
    assert first.sample(0, 12, 8).observation.equal(again.sample(0, 12, 8).observation)
    with pytest.raises(ValueError, match="replay.bin: not the replay buffer of this run$"):
        Replay(tmp_path / "replay.bin", SEEDS, COPIES, CAPACITY + 1, SLACK, 2, 1)


@pytest.mark.parametrize("steps", [5, 7, 12, 14])
def test_transitions_are_whole_episodes_copy_by_copy(steps: int, tmp_path: Path) -> None:
    replay = filled(tmp_path, steps)
    data = replay.transitions(7, steps)
    assert len(data) == steps * COPIES
    step = np.tile(np.arange(steps), COPIES)
    n = np.repeat(np.arange(COPIES), steps)
    number = 10_000 + 100 * step + n
    assert np.array_equal(data.observations, np.stack([number, n], axis=1))
    assert np.array_equal(data.actions[:, 0], number + 0.5)  # what was executed
    assert np.array_equal(data.next_observations[:, 0], number + 100)
    assert np.array_equal(data.rewards, number + 0.125)
    last = step % 5 == 4
    violation = last & ((step // 5 + n) % 2 == 0)
    assert np.array_equal(data.costs == 1, violation)
    assert np.array_equal(data.terminals, violation)
    # By the clock, or because the copy's recording ends there.
    assert np.array_equal(data.timeouts, (last | (step == steps - 1)) & ~violation)


def test_forgotten_transitions_are_not_given_out(tmp_path: Path) -> None:
    replay = filled(tmp_path, CAPACITY + SLACK)
    assert len(replay.transitions(2, CAPACITY + SLACK)) == (CAPACITY + SLACK) * COPIES
    with pytest.raises(ValueError, match="^the replay buffer holds 14 steps, not 15$"):
        replay.transitions(2, 15)


@pytest.mark.parametrize("steps", [8, 10, 13])
def test_a_cut_ends_episodes_by_the_clock_and_no_violation(steps: int, tmp_path: Path) -> None:
    """Steps 0 to 4, 5 to 9 and 10 to 14 are episodes; the tenth ends one anyway."""
    replay = filled(tmp_path, steps)
    replay.cut(steps)
    assert not (replay._rows[..., -1] * replay._rows[..., -2]).any()  # timeout and terminal
    replay.add(steps, arrival(steps))
    for k, seed in enumerate(SEEDS):
        data = replay.transitions(seed, steps + 1)
        places = [n * (steps + 1) + steps - 1 for n in range(COPIES)]
        violation = arrival(steps - 1).terminal[k].astype(bool)
        assert data.terminals[places].tolist() == violation.tolist()
        assert data.timeouts[places].tolist() == (~violation).tolist()
        ends = 2 + (steps - 1) // 5  # whole episodes, the cut, and where the recording ends
        assert data.timeouts.sum() + data.terminals.sum() == COPIES * ends


@pytest.mark.parametrize("steps", [8, 23])
def test_the_normalisation_is_each_seeds_own(steps: int, tmp_path: Path) -> None:
    """Of what a resumed run finds again: the rows that it would sample from."""
    replay = filled(tmp_path, steps)
    found = replay.normalisation(steps)
    for step in range(steps, steps + SLACK):  # a stretch that a killed run wrote
        replay.add(step, arrival(step))
    assert replay.normalisation(steps) == found
    seen = [arrival(step).observation for step in range(max(0, steps - CAPACITY), steps)]
    for k, normalisation in enumerate(found):
        rows = np.concatenate([observation[k] for observation in seen]).astype(np.float32)
        centre, scale = centre_and_scale(rows)
        assert normalisation.observation_centre == pytest.approx(centre)
        assert normalisation.observation_scale == pytest.approx(scale)
        assert (normalisation.action_centre, normalisation.action_scale) == ((0.0,), (1.0,))
    assert replace(found[0], observation_centre=found[1].observation_centre) != found[0]


def test_the_normalisation_of_closenesses_can_be_that_of_their_powers(tmp_path: Path) -> None:
    replay = buffer(tmp_path)
    rng = np.random.default_rng(0)
    seen = rng.random((8, 2, COPIES, 2), dtype=np.float32)
    seen[..., 0] *= 4  # a speed; the other is a closeness
    for step, observation in enumerate(seen):
        replay.add(step, arrival(step)._replace(observation=observation))
    plain, found = replay.normalisation(8), replay.normalisation(8, 6.0)
    for k in range(2):
        rows = seen[:, k].reshape(-1, 2)
        assert plain[k].observation_power == ()
        assert found[k].observation_power == (1.0, 6.0)
        assert found[k].observation_centre == pytest.approx((rows ** [1, 6]).mean(axis=0), rel=1e-5)
        assert found[k].observation_scale == pytest.approx((rows ** [1, 6]).std(axis=0), rel=1e-4)


def test_action_noise_is_a_function_of_seed_and_step() -> None:
    both, alone = ActionNoise((4, 9), 3, 2), ActionNoise((9,), 3, 2)
    steps = (0, 63, 64, 200, 5)
    for step in steps:
        noise, uniform = both.draw(step)
        assert noise.shape == uniform.shape == (2, 3, 2)
        assert np.array_equal(noise[1], alone.draw(step)[0][0])
        assert np.array_equal(uniform[1], alone.draw(step)[1][0])
        assert not np.array_equal(noise[0], noise[1])
    drawn = [both.draw(step) for step in range(640)]
    assert len({noise.tobytes() for noise, _ in drawn}) == 640
    noise, uniform = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    assert [noise.mean(), noise.std()] == pytest.approx([0, 1], abs=0.05)
    assert [uniform.mean(), uniform.std()] == pytest.approx([0, 3**-0.5], abs=0.05)
    assert uniform.min() >= -1
    assert uniform.max() < 1


def test_each_seeds_scaling_is_its_own() -> None:
    units = [
        Normalisation((100.0, 1.0), (4.0, 2.0), (0.0,), (1.0,)),
        Normalisation((0.0, 0.0), (0.5, 1.0), (0.5,), (2.0,)),
    ]
    normalisation = TensorNormalisation(units)
    raw = torch.arange(8.0).view(2, 2, 2)
    found = normalisation.observation(raw)
    assert found[0].equal((raw[0] - torch.tensor([100.0, 1.0])) / torch.tensor([4.0, 2.0]))
    assert found[1].equal(raw[1] / torch.tensor([0.5, 1.0]))
    action = torch.tensor([[[0.5]], [[0.5]]])
    assert normalisation.action(action).flatten().tolist() == [0.5, 0.0]
    assert normalisation.raw_action(normalisation.action(action)).equal(action)
