"""Who corrects: nobody, frozen filters, or a learner that goes on learning."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from deep.data.minibatches import Batch, Batches
from deep.data.normalisation import Normalisation, Ranges, TensorNormalisation
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import (
    DeaRrlSettings,
    Rrl,
    RrlMsdp,
    RrlMsdpSettings,
    RrlSettings,
    TaskPolicy,
)
from deep.pretraining.learner import Losses
from deep.pretraining.run import load_raw, read_run
from deep.tasks.bounds import Bounds
from deep.tasks.task import Sizes
from deep.train.config import TrainConfig
from deep.train.correction import FinetunedCorrection, FrozenCorrection, NoCorrection
from deep.train.learner import TaskBatch
from deep.train.pretrained import build_correction
from deep.train.sac import Sac, SacSettings
from tests.deep.online_runs import SEEDS, TINY, blocking_filter, braking_filter, hand_made
from tests.deep.online_runs import pretrained as short_pretraining

SIZES = Sizes(2, 1)
BOUNDS = Bounds.unit(1)
NETS = {"hidden": (8,), "batch_size": 16}
UNITS = (
    Normalisation((0.5, -1.0), (2.0, 0.5), (0.2,), (0.5,)),
    Normalisation((0.0, 1.0), (1.0, 3.0), (-0.1,), (2.0,)),
)
RANGES = (Ranges(BOUNDS, Bounds.unit(2)),) * 2


@pytest.fixture(scope="module")
def rrl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short_pretraining(tmp_path_factory.mktemp("rrl"), RrlSettings(**NETS))


@pytest.fixture(scope="module")
def dea_rrl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short_pretraining(tmp_path_factory.mktemp("dea-rrl"), DeaRrlSettings(**NETS))


def batch(seeds: int = 2, size: int = 16) -> TaskBatch:
    rng = np.random.default_rng(0)

    def uniform(*shape: int) -> Tensor:
        return torch.from_numpy(rng.uniform(-1, 1, (seeds, size, *shape)).astype(np.float32))

    cost = (uniform() > 0.5).float()
    return TaskBatch(
        uniform(2), uniform(1), uniform(1), uniform(2), uniform(),
        cost, cost, uniform(1), uniform(1),
    )  # fmt: skip


def task_policy(seeds: tuple[int, ...]) -> TaskPolicy:
    """An untrained SAC's, on raw observations."""
    policy = Sac(SacSettings(hidden=(8,)), SIZES, seeds).policy
    return lambda s, noise: policy.sample(s, noise)[0]


def observations(seeds: int = 2, n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    shape = (seeds, n)
    return (
        rng.uniform(-1, 1, (*shape, 2)).astype(np.float32),
        rng.uniform(-1, 1, (*shape, 1)).astype(np.float32),
    )


def state(correction: FinetunedCorrection) -> dict[str, Tensor]:
    return {name: tensor.clone() for name, tensor in correction.learner.state_dict().items()}


def finetuned(folder: Path, config: TrainConfig = TINY) -> FinetunedCorrection:
    correction = build_correction(replace(config, safety=folder), SIZES, BOUNDS)
    assert isinstance(correction, FinetunedCorrection)
    return correction


def rescaled(folder: Path) -> FinetunedCorrection:
    """RRL's pretrained learner behind units of its own, and thresholds that matter."""
    trained = finetuned(folder)
    s, a = observations()
    q = [f.q(s[k], a[k]) for k, f in enumerate(trained.filters())]
    data, _ = load_raw(read_run(folder))
    offline = Batches(data, SEEDS, 8, 0.5, torch.device("cpu"))
    limits = [float(np.median(part)) for part in q]
    return FinetunedCorrection(
        trained.learner, limits, TensorNormalisation(UNITS), RANGES, 0.9, offline
    )


def test_an_open_gate_lets_everything_through() -> None:
    s, a = observations()
    correction = NoCorrection()
    done = correction.correct(s, a)
    assert done.executed is a
    assert done.intervened.shape == (2, 200)
    assert not done.intervened.any()
    correction.learn(0, batch(), task_policy(SEEDS))
    assert correction.filters() == ()
    assert type(build_correction(TINY, SIZES, BOUNDS)) is NoCorrection


def test_frozen_filters_correct_each_its_own_seed() -> None:
    filters = (braking_filter(), blocking_filter(5, 0.5))
    correction = FrozenCorrection(filters)
    s, a = observations()
    done = correction.correct(s, a)
    near = filters[0].q(s[0], a[0]) >= 0.5
    assert 0 < near.sum() < 200
    assert np.array_equal(done.intervened, [near, np.ones(200, dtype=bool)])
    assert np.array_equal(done.executed[0, ~near], a[0, ~near])
    assert done.executed[0, near] == pytest.approx(np.tanh(-5.0))
    assert done.executed[1] == pytest.approx(np.tanh(0.3))
    assert correction.filters() == filters


def test_a_finetuned_gate_is_its_filters(rrl: Path) -> None:
    for correction in (rescaled(rrl), finetuned(rrl)):
        s, a = observations()
        done = correction.correct(s, a)
        for k, safety in enumerate(correction.filters()):
            expected = safety.correct(s[k], a[k])
            clear = abs(expected.critic - safety.threshold) > 1e-5
            assert clear.sum() > 190
            assert np.array_equal(done.intervened[k, clear], expected.intervened[clear])
            assert done.executed[k, clear] == pytest.approx(expected.executed[clear], abs=1e-5)
    done = rescaled(rrl).correct(*observations())
    assert 0 < done.intervened[0].sum() < 200
    assert not (done.executed == observations()[1])[done.intervened].any()


def test_only_finite_actions_within_bounds_leave_a_finetuned_correction(
    rrl: Path,
) -> None:
    """It keeps the rules of its filters; networks that overflow give the middle."""
    trained = rescaled(rrl)
    bounds = Bounds((-0.25,), (0.5,))
    ranges = [Ranges(bounds, Bounds.unit(2))] * 2
    correction = FinetunedCorrection(
        trained.learner,
        trained._thresholds,
        TensorNormalisation(UNITS),
        ranges,
        0.9,
        trained._offline,
    )
    s, a = observations()
    s[:, 0, 0], s[:, 1, 1], s[:, 2, 0] = np.nan, np.inf, -np.inf
    a[:, 3], a[:, 4], a[:, 5], a[:, 6] = np.nan, np.inf, -np.inf, 1e30
    done = correction.correct(s, a)
    assert done.intervened[:, :6].all()
    assert ((done.executed >= -0.25) & (done.executed <= 0.5)).all()
    for k, safety in enumerate(correction.filters()):
        assert safety.actions == bounds
        expected = safety.correct(s[k], a[k])
        clear = abs(expected.critic - safety.threshold) > 1e-5
        assert np.array_equal(done.intervened[k, clear], expected.intervened[clear])
        assert done.executed[k, clear] == pytest.approx(expected.executed[clear], abs=1e-5)
    with torch.no_grad():
        correction.learner.recovery.mlp.biases[0][:] = torch.nan
    executed = correction.correct(s, a).executed[:, :6]
    middle = np.array([n.action_centre for n in UNITS])[:, None]  # of the policy's own range
    assert executed == pytest.approx(np.broadcast_to(middle, executed.shape), abs=1e-6)


def test_frozen_filters_warn_once_of_what_they_were_not_trained_on() -> None:
    far = replace(braking_filter(), observations=Bounds((-0.1, -0.1), (0.1, 0.1)))
    correction = FrozenCorrection((far, braking_filter()))
    s, a = observations()
    with pytest.warns(UserWarning, match="far outside of what the safety filter was trained on"):
        correction.correct(s, a)
    count = correction.watch.out_of_range
    assert count == (abs(s[0]) > 0.12).any(axis=-1).sum() > 100
    correction.correct(s, a)
    assert (correction.watch.out_of_range, correction.watch.steps) == (2 * count, 800)


def test_a_critic_that_is_no_number_or_at_the_threshold_lets_nothing_through(rrl: Path) -> None:
    s, a = observations()
    correction = rescaled(rrl)
    with torch.no_grad():
        for parameter in correction.learner.critic.parameters():
            parameter.zero_()  # Q = 1/2 everywhere
    rest = (TensorNormalisation(UNITS), RANGES, 0.9, correction._offline)
    at = FinetunedCorrection(correction.learner, (0.5, 0.50001), *rest)
    assert at.correct(s, a).intervened.mean(axis=1).tolist() == [1, 0]
    over = FinetunedCorrection(correction.learner, (0.50001, 0.50001), *rest)
    assert over.correct(s, a).intervened.mean(axis=1).tolist() == [0, 0]
    for bad in (torch.nan, torch.inf, -torch.inf):  # a sigmoid of 0 would be no proof of safety
        with torch.no_grad():
            correction.learner.critic.mlp.biases[-1][0] = bad
        assert over.correct(s, a).intervened.mean(axis=1).tolist() == [1, 0]


def test_an_observation_whose_power_overflows_is_not_judged_as_the_mean(rrl: Path) -> None:
    correction = rescaled(rrl)
    with torch.no_grad():
        for parameter in correction.learner.critic.parameters():
            parameter.zero_()
    units = [replace(n, observation_power=(24.0, 1.0)) for n in UNITS]
    sharp = FinetunedCorrection(
        correction.learner, (0.6, 0.6), TensorNormalisation(units), RANGES, 0.9, correction._offline
    )
    s, a = observations()
    s[:, 0, 0] = 1e10
    found = sharp.correct(s, a).intervened
    assert found[:, 0].all()
    assert not found[:, 1:].any()


def test_rrl_learns_from_executed_actions_half_of_them_offline(
    rrl: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    correction = rescaled(rrl)
    seen: list[Batch] = []

    def spy(mixed: Batch, _: float) -> Losses:
        seen.append(mixed)
        return Losses(torch.zeros(2), torch.zeros(2), torch.zeros(2))

    monkeypatch.setattr(correction.learner, "update", spy)
    online = batch()
    policy = task_policy(SEEDS)
    correction.learn(7, online, policy)
    offline = correction._offline.get(7)
    centre, scale = torch.tensor([[[0.2]], [[-0.1]]]), torch.tensor([[[0.5]], [[2.0]]])
    normalisation = TensorNormalisation(UNITS)
    for name, given in {"action": "executed"}.items() | {
        (name, name) for name in ("cost", "terminal", "noise", "next_noise")
    }:
        mixed, column = getattr(seen[0], name), getattr(online, given)
        old = getattr(offline, name)
        if name == "action":
            column, old = (column - centre) / scale, (old - centre) / scale
        assert mixed.shape[:2] == (2, 16)
        assert torch.allclose(mixed[:, :8], old, atol=1e-6), name
        assert torch.allclose(mixed[:, 8:], column[:, :8], atol=1e-6), name
    for name in ("observation", "next_observation"):
        raw = torch.cat([getattr(offline, name), getattr(online, name)[:, :8]], dim=1)
        assert torch.allclose(getattr(seen[0], name), normalisation.observation(raw), atol=1e-6), (
            name
        )
    # RRL asks about its own batch's next states; the task policy sees them raw.
    assert isinstance(correction.learner, Rrl)
    following = torch.cat([offline.next_observation, online.next_observation[:, :8]], dim=1)
    noise = torch.cat([offline.next_noise, online.next_noise[:, :8]], dim=1)
    proposed = correction.learner.task_policy(seen[0].next_observation, noise)
    assert torch.allclose(proposed, (policy(following, noise) - centre) / scale, atol=1e-6)


def test_closenesses_are_sharpened_as_in_the_filters() -> None:
    sharp = tuple(replace(n, observation_power=(1.0, 8.0)) for n in UNITS)
    raw = np.array([[[-0.5, 0.9], [0.3, -0.1]]] * 2, dtype=np.float32)
    found = TensorNormalisation(sharp).observation(torch.from_numpy(raw)).numpy()
    for k, n in enumerate(sharp):
        powered = n.powered(raw[k])
        assert powered == pytest.approx(np.array([[-0.5, 0.9**8], [0.3, 0.0]]), rel=1e-5)
        expected = (powered - np.array(n.observation_centre)) / np.array(n.observation_scale)
        assert found[k] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("settings", [RrlSettings(**NETS), RrlMsdpSettings(**NETS)])
def test_finetuning_changes_critic_and_recovery_and_the_filters_are_copies(
    settings: RrlSettings | RrlMsdpSettings, tmp_path: Path
) -> None:
    correction = finetuned(short_pretraining(tmp_path / "run", settings))
    assert isinstance(correction.learner, Rrl | RrlMsdp)
    before = correction.filters()
    kept = [layer[0].copy() for layer in (*before[1].critic, *before[1].recovery)]
    correction.learn(0, batch(), task_policy(SEEDS))
    after = correction.filters()
    for old, new, copy in zip(
        (*before[1].critic, *before[1].recovery),
        (*after[1].critic, *after[1].recovery),
        kept,
        strict=True,
    ):
        assert np.array_equal(old[0], copy)
        assert not np.array_equal(old[0], new[0])
    assert [f.seed for f in after] == list(SEEDS)
    assert {f.method for f in after} == {correction.learner.name}
    assert {f.gamma_safe for f in after} == {settings.gamma_safe}


def test_the_corrections_of_a_pretraining_run_begin_with_what_it_learned(
    rrl: Path, dea_rrl: Path
) -> None:
    for folder, kind in ((rrl, FinetunedCorrection), (dea_rrl, FrozenCorrection)):
        correction = build_correction(replace(TINY, safety=folder), SIZES, BOUNDS)
        assert type(correction) is kind
        for k, seed in enumerate(SEEDS):
            path = folder / "filters" / f"seed{seed}.safetensors"
            correction.filters()[k].save(folder / "again.safetensors")
            assert (folder / "again.safetensors").read_bytes() == path.read_bytes()
    frozen = build_correction(replace(TINY, safety=rrl, finetune=False), SIZES, BOUNDS)
    assert type(frozen) is FrozenCorrection
    assert (
        type(build_correction(replace(TINY, safety=dea_rrl, finetune=True), SIZES, BOUNDS))
        is FinetunedCorrection
    )


def test_seeds_can_use_other_seeds_filters_and_thresholds(rrl: Path) -> None:
    config = replace(
        TINY, safety=rrl, seeds=(10, 11, 12), safety_seeds=(3, 0, 3), threshold=(0.1, 0.2, 0.3)
    )
    stored = {s: SafetyFilter.load(rrl / "filters" / f"seed{s}.safetensors") for s in SEEDS}
    for finetune in (True, False):
        correction = build_correction(replace(config, finetune=finetune), SIZES, BOUNDS)
        assert [f.threshold for f in correction.filters()] == [0.1, 0.2, 0.3]
        for found, seed in zip(correction.filters(), (3, 0, 3), strict=True):
            for (w, b), (v, c) in zip(found.critic, stored[seed].critic, strict=True):
                assert np.array_equal(w, v)
                assert np.array_equal(b, c)
            assert np.array_equal(found.recovery[0][0], stored[seed].recovery[0][0])
    correction = finetuned(rrl, replace(config, threshold=(0.4,)))
    assert [f.threshold for f in correction.filters()] == [0.4] * 3
    assert correction.learner.seeds == (10, 11, 12)
    data, _ = load_raw(read_run(rrl))
    expected = Batches([data[1], data[0], data[1]], (10, 11, 12), 8, 0.5, torch.device("cpu"))
    for found_column, column in zip(correction._offline.get(3), expected.get(3), strict=True):
        assert found_column.equal(column)


def test_a_seed_is_finetuned_as_if_alone(rrl: Path) -> None:
    both, alone = finetuned(rrl), finetuned(rrl, replace(TINY, seeds=(3,)))
    policies = [task_policy(seeds) for seeds in (SEEDS, (3,))]
    for update in range(5):
        both.learn(update, batch(), policies[0])
        alone.learn(update, TaskBatch(*(part[1:] for part in batch())), policies[1])
    for name, tensor in state(alone).items():
        half = len(state(both)[name]) // 2
        assert torch.allclose(state(both)[name][half:], tensor, atol=1e-5), name


@pytest.mark.parametrize("method", [RrlSettings(**NETS), RrlMsdpSettings(**NETS)])
def test_a_loss_that_is_no_number_stops_the_finetuning(
    method: RrlSettings | RrlMsdpSettings, tmp_path: Path
) -> None:
    correction = finetuned(short_pretraining(tmp_path, method))
    good = batch()
    correction.learn(0, good, task_policy(SEEDS))
    good.executed[1, 0] = torch.nan
    name = correction.learner.name
    message = f"^finetuning of {name}: update 7: the critic loss of seed 3 is nan; try"
    with pytest.raises(FloatingPointError, match=message):
        correction.learn(7, good, task_policy(SEEDS))


def test_pretraining_that_does_not_fit_is_refused(rrl: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no: there is no run here"):
        build_correction(replace(TINY, safety=tmp_path / "no"), SIZES, BOUNDS)
    message = "rrl.*: seed 5 was not pretrained; there are 0, 3$"
    with pytest.raises(ValueError, match=message):
        build_correction(replace(TINY, safety=rrl, seeds=(3, 5)), SIZES, BOUNDS)
    with pytest.raises(ValueError, match=message):
        build_correction(replace(TINY, safety=rrl, safety_seeds=(3, 5)), SIZES, BOUNDS)
    message = r"its filters take observations in R\^2 and actions in R\^1, brake has R\^3 and R\^1$"
    with pytest.raises(ValueError, match=message):
        build_correction(replace(TINY, safety=rrl), Sizes(3, 1), BOUNDS)
    with pytest.raises(ValueError, match=r"brake has R\^2 and R\^2$"):
        build_correction(replace(TINY, safety=rrl), Sizes(2, 2), Bounds.unit(2))
    message = r"^brake: its actions lie in \(-9\) to \(9\), the filter was trained on actions in "
    with pytest.raises(ValueError, match=message):
        build_correction(replace(TINY, safety=rrl), SIZES, Bounds((-9.0,), (9.0,)))
    with pytest.raises(ValueError, match=r"^threshold must lie in \(0, 1\], not 2.0$"):
        build_correction(replace(TINY, safety=rrl, threshold=(2.0,)), SIZES, BOUNDS)
    unfinished = hand_made(tmp_path / "unfinished", {0: braking_filter(), 3: braking_filter()})
    (unfinished / "filters" / "seed3.safetensors").unlink()
    message = (
        r"unfinished: not a finished pretraining run of seed 3 \(no filters/seed3.safetensors\)$"
    )
    with pytest.raises(ValueError, match=message):
        build_correction(replace(TINY, safety=unfinished), SIZES, BOUNDS)
    (rrl / "checkpoint.safetensors").rename(tmp_path / "moved")
    try:
        with pytest.raises(ValueError, match="checkpoint.safetensors: there is no such file$"):
            build_correction(replace(TINY, safety=rrl), SIZES, BOUNDS)
    finally:
        (tmp_path / "moved").rename(rrl / "checkpoint.safetensors")
    (unfinished / "config.json").write_text(json.dumps({"run": {"method": 3}}))
    with pytest.raises(ValueError, match="config.json: not a pretraining run "):
        build_correction(replace(TINY, safety=unfinished), SIZES, BOUNDS)
