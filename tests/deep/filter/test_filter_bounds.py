"""What a filter refuses, counts and never executes: bounds, ranges, NaN, other spaces."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import minari
import numpy as np
import onnx
import onnxruntime
import pytest
from gymnasium import spaces
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import ClipAction
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from numpy.typing import NDArray

from deep.data.normalisation import Normalisation, ranges_of
from deep.filter.behavior_correction import BehaviorCorrection, BehaviorCorrectionVector
from deep.filter.onnx_export import export_onnx
from deep.filter.safety_filter import SafetyFilter, inner_ends
from deep.tasks import Brake, TaskEnv
from deep.tasks.bounds import Bounds
from tests.deep.filters import linear_filter, random_filter

BAD = (np.nan, np.inf, -np.inf)
KEYS = {
    "intervened",
    "executed_action",
    "critic",
    "out_of_range",
    "not_finite",
    "out_of_range_steps",
    "not_finite_steps",
}


THREE = Bounds((-3.0,), (3.0,))


class Room(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """Shows what it is told to, and remembers what it was made to do."""

    def __init__(self, actions: spaces.Space[Any] | None = None, shape: tuple[int, ...] = (1,)):
        self.observation_space = spaces.Box(-np.inf, np.inf, shape, np.float64)
        self.action_space = actions or spaces.Box(-3.0, 3.0, (1,), np.float32)
        self.shown: list[float] = []
        self.done: list[NDArray[Any]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return self._next(), {}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        self.done.append(action)
        return self._next(), 0.0, False, False, {}

    def _next(self) -> NDArray[Any]:
        shape = self.observation_space.shape or ()
        return np.full(shape, self.shown.pop(0) if self.shown else 0.5)


def lift_filter(bias: float = -5.0) -> SafetyFilter:
    """Actions in +-3, observations in [0, 1]; blocks nothing, recovers by 3 tanh(0.3)."""
    units = Normalisation((0.5,), (0.25,), (0.0,), (3.0,))
    seen = Bounds((0.0,), (1.0,))
    return linear_filter([0.0], 0.0, bias, 0.3, normalisation=units, observations=seen)


def box(low: Any, high: Any, kind: Any = np.float32) -> spaces.Box:
    return spaces.Box(np.array([low], kind), np.array([high], kind), dtype=kind)


def test_other_action_bounds_are_refused_at_construction() -> None:
    message = r"^the environment: its actions lie in \(-30\) to \(30\), the filter was trained on "
    with pytest.raises(ValueError, match=message + r"actions in \(-3\) to \(3\); if the log "):
        BehaviorCorrection(Room(box(-30.0, 30.0)), lift_filter())
    with pytest.raises(ValueError, match=message):
        BehaviorCorrectionVector(SyncVectorEnv([lambda: Room(box(-30.0, 30.0))] * 2), lift_filter())
    for low, high in ((-3.31, 3.0), (-3.0, 3.31), (-2.98, 3.0), (-3.0, 2.98), (-1.0, 1.0)):
        with pytest.raises(ValueError, match="its actions lie in"):
            BehaviorCorrection(Room(box(low, high)), lift_filter())
    with pytest.raises(ValueError, match=r"actions in \(-3\) to \(3\)$"):  # no hint: narrower
        BehaviorCorrection(Room(box(-1.0, 3.0)), lift_filter())
    for low, high in ((-3.29, 3.29), (-2.999, 2.999)):  # nobody logged the very ends; rounding
        protected = BehaviorCorrection(Room(box(low, high)), lift_filter())
        assert protected.safety.actions.low[0] == pytest.approx(low)
        assert protected.safety.actions.high[0] == pytest.approx(high)


def test_every_coordinate_has_bounds_of_its_own() -> None:
    safety = random_filter()  # actions in [3, 7] and [-1, 1]
    assert safety.for_actions(safety.actions, "here").actions == safety.actions
    with pytest.raises(ValueError, match=r"^here: its actions lie in \(3, -2\) to \(7, 1\), "):
        safety.for_actions(Bounds((3.0, -2.0), (7.0, 1.0)), "here")


def test_spaces_that_are_not_for_a_filter_are_refused_by_name() -> None:
    discrete = "^discrete actions are not for this filter: it corrects vectors of real numbers, "
    for space in (spaces.Discrete(2), spaces.MultiDiscrete([2, 3]), spaces.MultiBinary(2)):
        with pytest.raises(ValueError, match=discrete):
            BehaviorCorrection(Room(space), lift_filter())
    with pytest.raises(ValueError, match=discrete + r"and the environment's actions are Discrete"):
        BehaviorCorrection(gymnasium.make("CartPole-v1"), lift_filter())
    with pytest.raises(ValueError, match="^the environment's actions are not bounded .*finite"):
        BehaviorCorrection(Room(box(-np.inf, np.inf)), lift_filter())
    with pytest.raises(ValueError, match="put ClipAction around the filter"):
        BehaviorCorrection(ClipAction(Room()), lift_filter())
    clipped = ClipAction(BehaviorCorrection(Room(), lift_filter()))
    clipped.reset()
    assert clipped.step(np.array([99.0]))[-1]["executed_action"] == 3
    with pytest.raises(ValueError, match="^the environment's actions must be vectors"):
        BehaviorCorrection(Room(spaces.Box(-3.0, 3.0, (1, 1))), lift_filter())
    with pytest.raises(ValueError, match="^the environment's actions must be real numbers"):
        BehaviorCorrection(Room(spaces.Box(-3, 3, (1,), np.int64)), lift_filter())
    with pytest.raises(ValueError, match=r"shapes \(2,\) and \(1,\), the filter was trained on"):
        BehaviorCorrection(Room(shape=(2,)), lift_filter())


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.float16])
def test_what_is_executed_lies_in_the_action_space(kind: Any) -> None:
    """0.1 and 0.7 are no float32; asymmetric bounds, and actions far outside of them."""
    units = Normalisation((0.5,), (0.25,), (0.4,), (0.3,))
    warnings.simplefilter("ignore", UserWarning)  # of the NaN
    for bias in (-5.0, 5.0):  # the agent's action, and the recovery policy's
        safety = linear_filter([0.0], 0.0, bias, 20.0, normalisation=units)
        env = Room(box(0.1, 0.7, kind))
        protected = BehaviorCorrection(env, safety)
        protected.reset()
        for action in (-9.0, 0.1, 0.7, 1e38, *BAD):
            *_, info = protected.step(np.array([action]))
            assert protected.action_space.contains(info["executed_action"])
            assert env.done[-1] is info["executed_action"]
    assert env.done[0][0] == pytest.approx(0.7, abs=1e-3)  # recovery: at the upper end


def test_bounds_in_float32_are_never_wider() -> None:
    rng = np.random.default_rng(0)
    low, high = -rng.random(500), rng.random(500)
    least, most = inner_ends(Bounds.of(low, high))
    assert least.dtype == most.dtype == np.float32
    assert (least.astype(float) >= low).all()
    assert (most.astype(float) <= high).all()
    assert least == pytest.approx(low, rel=2e-7)
    assert most == pytest.approx(high, rel=2e-7)
    assert (least.astype(float) > low).any()  # some had to be moved


def test_an_action_outside_the_bounds_is_judged_and_executed_at_the_nearest_one() -> None:
    units = Normalisation((0.5,), (0.25,), (0.0,), (3.0,))
    safety = linear_filter([0.0], 1.0, 0.0, 0.3, threshold=0.9, normalisation=units)
    found = safety.correct(np.full((3, 1), 0.5), np.array([[3.0], [300.0], [-300.0]]))
    assert found.executed[:, 0].tolist() == [3.0, 3.0, -3.0]
    assert not found.intervened.any()
    assert found.critic[0] == found.critic[1]
    assert not found.not_finite.any()


@pytest.mark.parametrize("bad", [*BAD, 1e39])  # the last: an infinity in float32
def test_what_is_not_finite_gives_the_recovery_action_of_the_mean(bad: float) -> None:
    safety = replace(random_filter(), threshold=1.0)
    good = np.array([[0.5, -1.0, 2.0]])
    mean = np.array(safety.normalisation.observation_centre)
    action = np.array([[5.0, 0.2]])
    assert not safety.correct(good, action).not_finite.any()
    for coordinate in range(3):
        shown, guessed = good.copy(), good.copy()
        shown[0, coordinate], guessed[0, coordinate] = bad, mean[coordinate]
        found = safety.correct(shown, action)
        assert found.executed == pytest.approx(safety.recovery_action(guessed), abs=1e-6)
        assert found.intervened.all()
        assert found.not_finite.all()
        assert found.critic.tolist() == [1.0]
    for coordinate in range(2):
        proposed = action.copy()
        proposed[0, coordinate] = bad
        found = safety.correct(good, proposed)
        assert np.array_equal(found.executed, safety.recovery_action(good))
        assert (found.not_finite.all(), found.critic[0]) == (True, 1.0)


def test_networks_that_overflow_act_in_the_middle() -> None:
    safety = random_filter()
    huge = [(w * np.float32(1e30), b) for w, b in (*safety.critic, *safety.recovery)]
    safety = replace(safety, critic=tuple(huge[:3]), recovery=tuple(huge[3:]), threshold=1.0)
    rng = np.random.default_rng(0)
    found = safety.correct(rng.normal(size=(50, 3)) * 1e30, rng.normal(size=(50, 2)))
    assert np.isfinite(found.executed).all()
    assert np.isfinite(found.critic).all()
    middle = (found.executed == (5.0, 0.0)).all(axis=1)
    assert middle.any()
    assert found.intervened[middle].all()


def test_nothing_that_is_not_finite_leaves_a_filter() -> None:
    safety, rng = random_filter(), np.random.default_rng(0)
    rows = rng.normal(size=(2000, 5)) * 10.0 ** rng.integers(-3, 45, (2000, 5))
    rows[rng.random(rows.shape) < 0.1] = rng.choice(BAD)
    found = safety.correct(rows[:, :3], rows[:, 3:])
    low, high = safety.actions.low, safety.actions.high
    assert ((found.executed >= low) & (found.executed <= high)).all()
    assert ((found.critic >= 0) & (found.critic <= 1)).all()
    with np.errstate(over="ignore"):
        bad = ~np.isfinite(rows.astype(np.float32)).all(axis=1)
    assert np.array_equal(found.not_finite, bad)
    assert found.intervened[bad].all()


@pytest.mark.parametrize("power", [(), (1.0, 3.0, 24.0)])
def test_onnx_has_the_same_rules_and_the_ranges(power: tuple[float, ...], tmp_path: Path) -> None:
    safety = random_filter()
    units = replace(safety.normalisation, observation_power=power)
    *hidden, (weights, biases) = safety.critic
    tame = (*hidden, (weights / 20, biases))  # values that are not all next to 1
    safety = replace(safety, normalisation=units, critic=tame)
    rng = np.random.default_rng(0)
    scale = 0.3 if power else 4.0
    rows = (rng.normal(size=(500, 5)) * scale).astype(np.float32)
    median = float(np.median(safety.q(rows[:, :3], rows[:, 3:].clip((3, -1), (7, 1)))))
    safety = safety.with_threshold(median)
    export_onnx(safety, tmp_path / "filter.onnx")
    told = onnx.load(tmp_path / "filter.onnx").metadata_props
    assert {entry.key: json.loads(entry.value) for entry in told} == {
        "action_low": [3.0, -1.0],
        "action_high": [7.0, 1.0],
        "observation_low": [-5.0] * 3,
        "observation_high": [5.0] * 3,
        "threshold": median,
    }
    rows = np.where(rng.random(rows.shape) < 0.1, rng.choice(BAD, rows.shape), rows)
    rows = rows.astype(np.float32)
    rows[:3, 3:] = 5.0, 0.2
    rows[:3, :3] = [[np.nan, 1, 1], [1, np.inf, 1], [1, 1, -np.inf]]
    session = onnxruntime.InferenceSession(str(tmp_path / "filter.onnx"))
    given = {"observation": rows[:, :3], "action": rows[:, 3:]}
    executed, intervened, critic = session.run(None, given)
    expected = safety.correct(rows[:, :3], rows[:, 3:])
    assert expected.not_finite.sum() > 100
    clear = abs(expected.critic - median) > 1e-4
    assert clear[expected.not_finite].all()
    assert 0 < expected.intervened[~expected.not_finite].mean() < 1
    assert critic == pytest.approx(expected.critic, abs=1e-5)
    assert np.array_equal(intervened[clear], expected.intervened[clear])
    assert executed[clear] == pytest.approx(expected.executed[clear], abs=1e-4)
    assert ((executed >= safety.actions.low) & (executed <= safety.actions.high)).all()


def test_far_is_more_than_a_tenth_of_the_range_outside() -> None:
    safety = lift_filter()  # observations in [0, 1]
    shown = np.array([[-0.101], [-0.099], [0.5], [1.099], [1.101], [np.nan]])
    found = safety.correct(shown, np.zeros((6, 1)))
    assert found.out_of_range.tolist() == [True, False, False, False, True, False]
    still = replace(safety, observations=Bounds((0.7,), (0.7,)))  # constant up to rounding
    shown = np.array([[0.7], [0.7 + 1e-7], [0.71], [0.69]])
    assert still.out_of_range(shown.astype(np.float32)).tolist() == [False, False, True, True]


def test_what_a_filter_should_not_meet_is_counted_and_warned_of_once() -> None:
    env = Room()
    protected = BehaviorCorrection(env, lift_filter())
    env.shown = [0.5, 7.0, 8.0, np.nan, np.nan, 0.5]
    protected.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        *_, info = protected.step(np.zeros(1))
    assert (info["out_of_range"], info["out_of_range_steps"]) == (False, 0)
    message = r"far outside of .*\(coordinate 0 is 7, the data reach from 0 to 1\)"
    with pytest.warns(UserWarning, match=message):
        *_, info = protected.step(np.zeros(1))
    assert (info["out_of_range"], info["out_of_range_steps"]) == (True, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        *_, info = protected.step(np.zeros(1))
    assert (info["out_of_range_steps"], info["not_finite_steps"]) == (2, 0)
    with pytest.warns(UserWarning, match="holds a NaN or an infinity: the recovery policy acts"):
        *_, info = protected.step(np.zeros(1))
    assert (info["not_finite"], info["intervened"], info["critic"]) == (True, True, 1.0)
    assert info["executed_action"] == pytest.approx(3 * np.tanh(0.3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        protected.step(np.zeros(1))
        *_, info = protected.step(np.full(1, np.inf))
    assert (info["out_of_range_steps"], info["not_finite_steps"]) == (2, 3)
    assert (protected.steps, protected.interventions) == (6, 3)


def test_an_agent_that_changes_its_observation_in_place_is_judged_where_it_was() -> None:
    protected = BehaviorCorrection(Room(), linear_filter([10.0], 0.0, -4.0, 0.3, actions=THREE))
    seen, _ = protected.reset()
    for _ in range(2):
        seen -= 0.5  # as one that normalises; Q is above 1/2 from 0.4 on
        seen, *_, info = protected.step(np.zeros(1))
        assert info["critic"] == pytest.approx(1 / (1 + np.exp(-1)), abs=1e-6)


def test_the_vector_wrapper_counts_over_all_copies() -> None:
    inner = [Room(), Room()]
    inner[1].shown = [7.0, 7.0, np.nan]
    many = BehaviorCorrectionVector(SyncVectorEnv([lambda e=e: e for e in inner]), lift_filter())
    _, first = many.reset()
    with pytest.warns(UserWarning, match="coordinate 0 is 7"):
        *_, info = many.step(np.zeros((2, 1), np.float32))
    assert info["out_of_range"].tolist() == [False, True]
    many.step(np.zeros((2, 1), np.float32))
    with pytest.warns(UserWarning, match="NaN"):
        *_, info = many.step(np.zeros((2, 1), np.float32))
    assert info["out_of_range_steps"].tolist() == [2, 2]
    assert info["not_finite_steps"].tolist() == [1, 1]
    assert set(first) == KEYS
    for name in KEYS:
        assert first[name].shape == info[name].shape
        assert first[name].dtype == info[name].dtype


def test_an_environment_that_normalises_is_noticed() -> None:
    """Heights in metres around 100 were logged; the wrapper shows them around 0."""
    safety = replace(lift_filter(), observations=Bounds((90.0,), (110.0,)))
    env = Room()
    env.shown = [100.0, 101.0, 99.0]
    protected = BehaviorCorrection(gymnasium.wrappers.NormalizeObservation(env), safety)
    protected.reset()
    with pytest.warns(UserWarning, match="far outside"):
        protected.step(np.zeros(1, np.float32))


def brake_filter() -> SafetyFilter:
    return linear_filter([0.0, 0.0], 10.0, 0.0, -20.0)


def test_reset_and_step_give_info_of_one_structure() -> None:
    protected = BehaviorCorrection(TaskEnv(Brake()), brake_filter())
    _, first = protected.reset(seed=0)
    *_, later = protected.step(np.ones(1, np.float32))
    assert {"cost", "state"} | KEYS == set(first) == set(later)
    for name, value in first.items():
        assert type(value) is type(later[name])
        assert np.shape(value) == np.shape(later[name])
        assert getattr(value, "dtype", None) == getattr(later[name], "dtype", None)
    assert (first["intervened"], first["critic"], first["executed_action"][0]) == (False, 0, 0)


def test_the_wrapper_is_made_again_from_its_spec() -> None:
    protected = BehaviorCorrection(gymnasium.make("deep/Brake-v0"), brake_filter())
    spec = protected.spec
    assert spec is not None
    for again in (gymnasium.make(spec), gymnasium.make(type(spec).from_json(spec.to_json()))):
        assert type(again) is BehaviorCorrection
        assert again.spec == spec
        for env in (protected, again):
            env.reset(seed=3)
        for action in (1.0, -0.5, 0.3):
            mine, its = (env.step(np.array([action])) for env in (protected, again))
            assert np.array_equal(mine[0], its[0])
            assert mine[4]["critic"] == its[4]["critic"]


def test_what_a_vector_wrappers_spec_makes_is_protected_too() -> None:
    """Gymnasium's specifications know no vector wrappers: the filter would be lost."""
    bare = gymnasium.make_vec("deep/Brake-v0", 3, vectorization_mode="sync")
    protected = BehaviorCorrectionVector(bare, brake_filter())
    assert protected.spec is not None
    assert bare.spec is not None
    assert not bare.spec.additional_wrappers
    again = gymnasium.make_vec(protected.spec)
    actions = np.array([[1.0], [-0.5], [0.3]], dtype=np.float32)
    for env in (protected, again):
        env.reset(seed=3)
    ended = np.zeros(3, dtype=np.bool_)
    for _ in range(3):
        mine, its = (env.step(actions) for env in (protected, again))
        assert np.array_equal(mine[0], its[0])
        if not ended.any():  # a copy that begins anew executes nothing
            assert np.array_equal(mine[4]["executed_action"], its[4]["executed_action"])
            assert mine[4]["intervened"].tolist() == [True, False, True]
        ended = mine[2]
    between = RecordEpisodeStatistics(gymnasium.make_vec("deep/Brake-v0", 3))
    assert BehaviorCorrectionVector(between, brake_filter()).spec is None


def test_a_filter_is_the_same_as_text_and_a_broken_one_is_refused() -> None:
    safety = random_filter()
    again = SafetyFilter.from_text(safety.to_text())
    assert again.to_text() == safety.to_text()
    assert (again.actions, again.observations) == (safety.actions, safety.observations)
    with pytest.raises(ValueError, match="^not a safetensors file"):
        SafetyFilter.from_text("AAAA")


def tree_map(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """As ``jax.tree_util.tree_map``, of which Minari's collector needs no more: dicts."""
    if not isinstance(tree, dict):
        return function(tree, *others)
    if any(tree.keys() != other.keys() for other in others):
        raise ValueError("the structures differ")
    return {name: tree_map(function, tree[name], *(o[name] for o in others)) for name in tree}


@pytest.fixture
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Minari's, in a folder of the test, and without JAX."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    util = ModuleType("jax.tree_util")
    util.tree_map = tree_map  # type: ignore[attr-defined]  # what a module holds is not declared
    jax = ModuleType("jax")
    jax.tree_util = util  # type: ignore[attr-defined]  # likewise
    monkeypatch.setitem(sys.modules, "jax", jax)
    monkeypatch.setitem(sys.modules, "jax.tree_util", util)


@pytest.mark.usefixtures("datasets")
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")  # Minari's own folder
def test_minari_records_a_corrected_environment() -> None:
    protected = BehaviorCorrection(gymnasium.make("deep/Brake-v0"), brake_filter())
    collector = minari.DataCollector(protected, record_infos=True)
    for seed in range(3):
        collector.reset(seed=seed)
        ended = False
        while not ended:
            *_, terminated, truncated, _ = collector.step(protected.action_space.sample())
            ended = terminated or truncated
    with warnings.catch_warnings():
        # Minari warns of every optional entry that is left out: author, e-mail, permalink.
        warnings.simplefilter("ignore", UserWarning)
        found = collector.create_dataset("deep/corrected-v0")
    assert found.total_episodes == 3
    replaced = sum(int(episode.infos["intervened"].sum()) for episode in found)
    assert replaced == protected.interventions > 0
    for episode in found:
        infos, actions = episode.infos, episode.actions
        assert len(infos["intervened"]) == len(actions) + 1
        kept = ~infos["intervened"][1:]
        assert np.array_equal(infos["executed_action"][1:][kept], actions[kept])
    assert type(found.recover_environment()) is BehaviorCorrection
    collector._tmp_dir.cleanup()  # the one that it makes for a next data set


def test_files_of_another_version_and_bounds_that_make_no_sense_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "filter.safetensors"
    with monkeypatch.context() as patch:
        patch.setattr("deep.filter.safety_filter.FORMAT", "dead-ends safety filter 1")
        random_filter().save(path)
    message = "filter.safetensors: not a 'dead-ends safety filter 2' file but .* of another version"
    with pytest.raises(ValueError, match=message):
        SafetyFilter.load(path)
    with pytest.raises(ValueError, match="1 lower ends for 2 upper ones"):
        Bounds((0.0,), (1.0, 2.0))
    with pytest.raises(ValueError, match=r"bounds must be finite, not \(0\) to \(inf\)"):
        Bounds((0.0,), (np.inf,))
    with pytest.raises(ValueError, match="bounds must not cross"):
        Bounds((1.0,), (0.0,))
    with pytest.raises(ValueError, match="those of 1 observations and 1 actions, expected 3 and 2"):
        replace(random_filter(), actions=Bounds.unit(1), observations=Bounds.unit(1))
    assert str(Bounds.unit(9)) == "(-1, -1, -1, -1, -1, -1, ..., -1) to (1, 1, 1, 1, 1, 1, ..., 1)"


def test_ranges_are_those_of_the_data_and_stated_bounds_hold_them() -> None:
    from tests.deep.pretraining.test_run import transitions  # actions from -1 to 1

    data = transitions(np.random.default_rng(0).normal(size=(50, 2)))
    seen = Bounds.covered(data.observations)
    assert ranges_of(data) == (Bounds.unit(1), seen)
    assert seen.low == tuple(data.observations.min(axis=0).tolist())
    assert ranges_of(data, Bounds((-2.0,), (1.0,))) == (Bounds((-2.0,), (1.0,)), seen)
    with pytest.raises(ValueError, match=r"^actions: row 0 is \(-1\), outside of their bounds"):
        ranges_of(data, Bounds((-0.99,), (1.0,)))
    with pytest.raises(ValueError, match=r"^actions lie in R\^1, their bounds in R\^2$"):
        ranges_of(data, Bounds.unit(2))


def test_rows_of_other_shapes_and_kinds_are_refused_and_never_stretched() -> None:
    safety, seen, action = random_filter(), np.zeros((2, 3)), np.full((2, 2), 4.0)
    for bad, message in (
        (action[:, :1], r"^actions have shape \(2, 1\), expected \(n, 2\)$"),
        (action[:, :, None], r"^actions have shape \(2, 2, 1\), expected \(n, 2\)$"),
        (action[0], r"^actions have shape \(2,\), expected \(n, 2\)$"),
        (action[:1], r"^there are 2 observations and 1 actions$"),
        (None, r"^actions are of type object, not real numbers$"),
        ([["4", "0"]] * 2, "^actions are of type <U1, not real numbers$"),
        ([[10**400, 0]] * 2, "^actions are of type object, not real numbers$"),
        (action * 1j, "^actions are of type complex128, not real numbers$"),
        ([[1, 2], [3]], "^actions: the rows differ in length"),
    ):
        with pytest.raises(ValueError, match=message):
            safety.correct(seen, bad)  # type: ignore[arg-type]  # what an agent may send
        with pytest.raises(ValueError, match=message):
            safety.q(seen, bad)  # type: ignore[arg-type]  # likewise
    for bad in (np.full((2, 1), np.nan), seen[0], seen[:, :2]):
        with pytest.raises(ValueError, match=r"^observations have shape .*, expected \(n, 3\)$"):
            safety.recovery_action(bad)
    env = BehaviorCorrection(Room(shape=(1,)), lift_filter())
    env.reset()
    for wrong in (np.zeros(2), 0.5, None):
        with pytest.raises(ValueError, match="^actions "):
            env.step(wrong)  # type: ignore[arg-type]  # likewise


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_network_that_overflows_to_nothing_does_not_call_it_safe(
    sign: float, tmp_path: Path
) -> None:
    """The sigmoid of minus infinity is 0."""
    safety = linear_filter([10.0], 0.0, 0.0, 0.3)
    two = tuple(np.concatenate([x, -x], axis=0) for x in safety.critic[0])
    for critic in (safety.critic, (two,)):
        safety = replace(safety, critic=critic)
        shown, action = np.array([[sign * 3e38]], dtype=np.float32), np.zeros((1, 1), np.float32)
        found = safety.correct(shown, action)
        assert (found.critic[0], found.intervened[0], safety.q(shown, action)[0]) == (1, True, 1)
        export_onnx(safety, tmp_path / "filter.onnx")
        session = onnxruntime.InferenceSession(str(tmp_path / "filter.onnx"))
        _, intervened, critic_value = session.run(None, {"observation": shown, "action": action})
        assert (critic_value[0], intervened[0]) == (1, True)


def test_an_observation_whose_power_overflows_is_not_judged(tmp_path: Path) -> None:
    """A hidden unit would make 0 of minus infinity, and the critic a number of that."""
    units = Normalisation((0.0,), (1.0,), (0.0,), (1.0,), (24.0,))
    one = np.ones((1, 1, 1), dtype=np.float32)
    hidden = (np.array([[[-1.0], [0.0]]], dtype=np.float32), 0 * one)
    safety = replace(
        linear_filter([0.0], 0.0, 0.0, 0.3, normalisation=units), critic=(hidden, (one, -5 * one))
    )
    shown, action = np.array([[0.5], [1e10]], dtype=np.float32), np.zeros((2, 1), np.float32)
    found = safety.correct(shown, action)
    assert found.intervened.tolist() == [False, True]
    assert found.critic[1] == safety.q(shown, action)[1] == 1
    export_onnx(safety, tmp_path / "filter.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "filter.onnx"))
    _, intervened, _ = session.run(None, {"observation": shown, "action": action})
    assert intervened.tolist() == [False, True]


def test_numbers_that_single_precision_cannot_hold_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"bounds must be finite, not \(-1e\+300\) to \(1e\+300\), in single"
    ):
        Bounds((-1e300,), (1e300,))
    with pytest.raises(ValueError, match="action: centres must be finite, scales positive"):
        Normalisation((0.0,), (1.0,), (0.0,), (1e300,))
    for scale in (1e-42, 1e-300):  # one over it is infinite
        with pytest.raises(
            ValueError, match="observation: centres must be finite, scales positive"
        ):
            Normalisation((0.0,), (scale,), (0.0,), (1.0,))
    units = Normalisation((0.0,), (1e-36,), (0.0,), (1.0,))
    with pytest.raises(ValueError, match="^critic: the scales are too small for its weights$"):
        linear_filter([1e6], 0.0, 0.0, 0.0, normalisation=units)


def test_an_action_that_is_one_number_is_executed_as_that_number() -> None:
    """Neither 0.1 in double precision nor any number of a range around it is a float32."""
    units = Normalisation((0.5,), (0.25,), (0.1,), (1.0,))
    safety = linear_filter(
        [0.0], 0.0, 5.0, 0.0, normalisation=units, actions=Bounds((0.1,), (0.1,))
    )
    single = SyncVectorEnv([lambda: Room(box(0.1, 0.1, np.float64))] * 2)
    env = BehaviorCorrection(Room(box(0.1, 0.1, np.float64)), safety)
    env.reset()
    assert env.action_space.contains(env.step(np.array([0.1]))[-1]["executed_action"])
    copies = BehaviorCorrectionVector(single, safety)
    copies.reset()
    executed = copies.step(np.full((2, 1), 0.1))[-1]["executed_action"]
    assert copies.action_space.contains(executed)


@pytest.mark.parametrize("wrong", [{"reach": x} for x in (0.0, -1.0, *BAD)] + [{"gamma_safe": 7.0}])
def test_numbers_that_turn_the_recovery_around_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))} must "):
        replace(random_filter(), **wrong)


def test_networks_of_the_other_kind_are_refused_before_the_first_step() -> None:
    safety = random_filter()
    several = tuple((w[None], b[None, None]) for w, b in safety.recovery)
    with pytest.raises(ValueError, match="^recovery: layer 0 holds several networks, expected one"):
        replace(safety, recovery=several)
    one = tuple((w[0], b[0, 0]) for w, b in safety.critic)
    with pytest.raises(ValueError, match="^critic: layer 0 holds one network, expected several"):
        replace(safety, critic=one)
    none = tuple((w[:0], b[:0]) for w, b in safety.critic)
    with pytest.raises(ValueError, match="^critic: layer 0 holds no network"):
        replace(safety, critic=none)
    double = tuple((w.astype(float), b.astype(float)) for w, b in safety.critic)
    with pytest.raises(ValueError, match="^critic: layer 0 is of type float64, expected float32$"):
        replace(safety, critic=double)


@pytest.mark.parametrize(
    "lie",
    [
        {"normalisation": []},
        {"normalisation": {"observation_centre": []}},
        {"actions": []},
        {"actions": {"low": "ab", "high": "cd"}},
        {"actions": {"low": [3, -1], "high": [7, None]}},
        {"observations": {"low": [[0]] * 3, "high": [[1]] * 3}},
        {"seed": float("inf")},
        {"threshold": 10**400},
        {"threshold": None},
        {"normalisation": {name: [] for name in vars(Normalisation.identity(1, 1))}},
    ],
)
def test_a_header_that_lies_is_one_sentence_with_the_file(
    lie: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    safety, path = random_filter(), tmp_path / "filter.safetensors"
    told = safety._rest() | lie
    monkeypatch.setattr(SafetyFilter, "_rest", lambda _: told)
    safety.save(path)
    with pytest.raises(ValueError, match=r"filter.safetensors: ") as found:
        SafetyFilter.load(path)
    assert "ufunc" not in str(found.value)


def test_a_path_is_no_filter_as_text() -> None:
    with pytest.raises(ValueError, match=r"^not a safety filter as text.*SafetyFilter\.load"):
        BehaviorCorrection(Room(), "runs/lift/filters/seed0.safetensors")
