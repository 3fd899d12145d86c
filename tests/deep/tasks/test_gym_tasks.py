"""Any Gymnasium environment as a task: its steps, its seeds, and training on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import deep.train.run
from deep.data.formats import read_hdf5, write_hdf5
from deep.filter.behavior_correction import BehaviorCorrection
from deep.filter.task_policy import TrainedPolicy
from deep.pretraining import DeaRrlAnnealedSettings, RrlSettings
from deep.pretraining.config import PretrainConfig
from deep.pretraining.run import pretrain_in_folder
from deep.tasks.bounds import Bounds
from deep.tasks.gym import NO_RULES, GymVectorEnv, Rules
from deep.tasks.vectorised import Fleet, evaluation_copies, make_vector_env
from deep.train.config import TrainConfig
from deep.train.episodes import run_episodes
from deep.train.evaluation import evaluate_policies
from deep.train.learner import TaskBatch, TaskLosses
from deep.train.offline_data import offline_data
from deep.train.replay import Replay
from deep.train.run import train
from deep.train.sac import Sac, SacSettings
from tests.deep.online_runs import table

POSITIVE = Rules(violation="cost > 0")
ENDS = Rules(termination_is_violation=True)
PENDULUM = TrainConfig(
    task="gym:Pendulum-v1",
    rules=ENDS,
    method=SacSettings(hidden=(8,), batch_size=16, reward_scale=1.0),
    seeds=(0, 3),
    steps=820,
    copies=2,
    start_steps=100,
    steps_per_update=20,
    replay=820,
    evaluate_every=410,
    evaluation_episodes=2,
    episodes=3,
    log_every=410,
    checkpoint_every=410,
    keep_replay=True,
)


class Counter(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """Counts its steps, and reports a cost of 0.5 at the third, which it survives."""

    def __init__(
        self,
        observations: spaces.Space[Any] | None = None,
        actions: spaces.Space[Any] | None = None,
    ) -> None:
        self.observation_space = observations or spaces.Box(0.0, 9.0, (1,), np.float64)
        self.action_space = actions or spaces.Box(
            np.array([-1, 2], dtype=np.float32), np.array([3, 4], dtype=np.float32)
        )
        self.done: list[NDArray[Any]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.steps = 0
        return np.zeros(1), {}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        self.done.append(action)
        self.steps += 1
        cost = 0.5 if self.steps == 3 else 0.0
        return np.full(1, float(self.steps)), float(self.steps), False, False, {"cost": cost}


class Rail(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """A cart between two ends, moved by a force in newtons within odd bounds."""

    def __init__(self, low: float = -30.0, high: float = 30.0, unit: float = 0.01) -> None:
        self.observation_space = spaces.Box(-2.0, 2.0, (1,), np.float32)
        self.action_space = spaces.Box(low, high, (1,), np.float64)
        self.unit = unit
        self.forces: list[float] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.place = self.np_random.uniform(-0.5, 0.5)
        return np.array([self.place], np.float32), {"cost": 0.0}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self.forces.append(float(action[0]))
        self.place += self.unit * action[0]
        cost = float(abs(self.place) > 1)
        seen = np.array([self.place], np.float32)
        return seen, 0.0, False, False, {"cost": cost}


def build(**kwargs: Any) -> Counter:
    return Counter(**kwargs)


def still(observations: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.zeros((len(observations), 2), dtype=np.float32)


@pytest.fixture
def counter() -> Iterator[None]:
    gymnasium.register("test/Counter-v0", entry_point=build, max_episode_steps=4)
    yield
    del gymnasium.registry["test/Counter-v0"]


def test_steps_are_those_of_plain_environments() -> None:
    env = GymVectorEnv("Pendulum-v1", 3, ENDS)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, _ = env.reset(seed=7)
    seeds = np.random.default_rng(7).integers(2**31, size=3)
    alone = [gymnasium.make("Pendulum-v1") for _ in seeds]
    for copy, seed, row in zip(alone, seeds, observation, strict=True):
        assert np.array_equal(copy.reset(seed=int(seed))[0], row)
    rng = np.random.default_rng(0)
    for step in range(1, 420):
        action = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        action *= 2  # the pendulum's own bounds
        observation, reward, terminated, truncated, info = env.step(action)
        assert observation.dtype == np.float32
        for n, copy in enumerate(alone):
            there, gained, _, over, _ = copy.step(action[n])
            assert reward[n] == pytest.approx(gained, abs=1e-5)
            assert truncated[n] == over == (step % 200 == 0)
            last = info["final_obs"][n] if over else observation[n]
            assert last == pytest.approx(there, abs=1e-5)
            if over:
                assert np.array_equal(observation[n], copy.reset()[0])
        assert not terminated.any()
        assert not info["cost"].any()
        assert ("final_obs" in info) == truncated.any()
    env.close()


@pytest.mark.usefixtures("counter")
def test_the_first_cost_ends_the_episode() -> None:
    fleet = Fleet("gym:test/Counter-v0", (0,), 2, POSITIVE)
    assert (fleet.observation_dim, fleet.action_dim) == (1, 2)
    observation = fleet.reset()
    for step in range(1, 7):
        arrived = fleet.step(np.zeros((1, 2, 2), dtype=np.float32))
        violated = step % 3 == 0
        assert (arrived.cost == violated).all()  # a cost of 0.5 counts as a violation
        assert (arrived.terminal == violated).all()
        assert not arrived.timeout.any()
        assert (arrived.last == observation + 1).all()
        observation = arrived.observation
        assert (observation == step % 3).all()
        assert (arrived.reward == (step - 1) % 3 + 1).all()
    assert fleet.snapshot() is None
    episodes = run_episodes("gym:test/Counter-v0", still, None, 5, 0, 2, POSITIVE)
    assert episodes.avr == 1
    assert (episodes.lengths == 3).all()
    assert (episodes.returns == 6).all()


@pytest.mark.usefixtures("counter")
def test_actions_are_in_the_environments_units_and_end_at_its_bounds() -> None:
    env = GymVectorEnv("test/Counter-v0", 1, POSITIVE)
    assert env.single_action_space == Counter().action_space
    fleet = Fleet("gym:test/Counter-v0", (0,), 1, POSITIVE)
    assert fleet.action_bounds == Bounds((-1.0, 2.0), (3.0, 4.0))
    env.reset(seed=0)
    for action in ([-1, 2], [3, 4], [1, 3.5], [3 + 1e-6, -7], [-30, 30]):
        env.step(np.array([action]))
    (copy,) = env._copies
    found = np.array(copy.unwrapped.done)  # type: ignore[attr-defined]  # Counter's own
    assert found.dtype == np.float32
    assert found == pytest.approx(np.array([[-1, 2], [3, 4], [1, 3.5], [3, 2], [-1, 4]]))


@pytest.mark.usefixtures("counter")
def test_time_limits_truncate() -> None:
    gymnasium.registry["test/Counter-v0"].max_episode_steps = 2
    env = GymVectorEnv("test/Counter-v0", 1, POSITIVE)
    env.reset(seed=0)
    over = [env.step(np.zeros((1, 2)))[2:4] for _ in range(4)]
    assert [bool(terminated[0]) for terminated, _ in over] == [False] * 4
    assert [bool(truncated[0]) for _, truncated in over] == [False, True, False, True]
    gymnasium.registry["test/Counter-v0"].max_episode_steps = 3
    env = GymVectorEnv("test/Counter-v0", 1, POSITIVE)
    env.reset(seed=0)
    *_, (_, _, terminated, truncated, _) = [env.step(np.zeros((1, 2))) for _ in range(3)]
    assert terminated.all()
    assert not truncated.any()


def refusal(observations: spaces.Space[Any] | None, actions: spaces.Space[Any] | None) -> str:
    """The sentence with which an environment with these spaces is refused."""
    kwargs = {"observations": observations, "actions": actions}
    gymnasium.register("test/Odd-v0", entry_point=build, kwargs=kwargs, max_episode_steps=4)
    try:
        with pytest.raises(ValueError, match="^test/Odd-v0: ") as caught:
            make_vector_env("gym:test/Odd-v0", 1)
    finally:
        del gymnasium.registry["test/Odd-v0"]
    return str(caught.value)


def test_other_spaces_are_refused() -> None:
    sentence = "observations must be vectors of numbers (Box), not "
    assert sentence + "Discrete(3)" in refusal(spaces.Discrete(3), None)
    assert sentence + "Box(0.0, 1.0, (2, 2), float32)" in refusal(spaces.Box(0, 1, (2, 2)), None)
    assert sentence + "Box([], [], (0,), float32)" in refusal(spaces.Box(0, 1, (0,)), None)
    sentence = "actions must be vectors of real numbers within finite bounds (Box), not "
    assert sentence + "Box(-1, 1, (1,), int64)" in refusal(None, spaces.Box(-1, 1, (1,), np.int64))
    assert sentence + "Box([], [], (0,), float32)" in refusal(None, spaces.Box(-1, 1, (0,)))
    assert sentence + "Discrete(2)" in refusal(None, spaces.Discrete(2))
    assert sentence + "Box(-1.0, 1.0, (1, 1), float32)" in refusal(None, spaces.Box(-1, 1, (1, 1)))
    assert sentence + "Box(-inf, inf, (1,)" in refusal(None, spaces.Box(-np.inf, np.inf, (1,)))


def test_errors_say_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="^there is no Gymnasium environment 'Bike-v0': "):
        make_vector_env("gym:Bike-v0", 1)
    with pytest.raises(ValueError, match="'no_module:Bike-v0': No module named 'no_module'"):
        make_vector_env("gym:no_module:Bike-v0", 1)
    with pytest.raises(ValueError, match="^num_envs must be at least 1, not 0$"):
        GymVectorEnv("Pendulum-v1", 0)
    env = GymVectorEnv("Pendulum-v1", 2, ENDS)
    with pytest.raises(ValueError, match=r"^Pendulum-v1: call reset\(\) before step\(\)$"):
        env.step(np.zeros((2, 1)))
    with pytest.raises(ValueError, match="^the copies' seeds are drawn: give one seed, not a list"):
        env.reset(seed=[1, 2])


class Odd(Counter):
    """A counter that is wrong, or silent, in one way."""

    fault = ""
    after = 0
    """Steps before it goes wrong."""

    def reset(self, **given: Any) -> Any:  # type: ignore[override]  # that is what is tested
        began = super().reset(**given)
        return {"bare reset": began[0], "nan reset": (np.full(1, np.nan), {})}.get(Odd.fault, began)

    def step(self, action: NDArray[Any]) -> Any:
        observation, reward, over, cut, _ = super().step(action)
        if self.steps <= Odd.after:
            return observation, reward, over, cut, {"cost": 0.0}
        return {
            "four": (observation, reward, over, {"cost": 0.0}),
            "silent": (observation, reward, over, cut, {}),
            "ends": (observation, reward, self.steps == 3, cut, {}),
            "ends at no cost": (observation, reward, self.steps == 3, cut, {"cost": 0.0}),
            "two": (observation, reward, over, cut, {"cost": np.array([0.0, self.steps])}),
            "half": (observation, reward, over, cut, {"cost": 0.5}),
            "nan cost": (observation, reward, over, cut, {"cost": np.nan}),
            "text": (observation, reward, over, cut, {"cost": "high"}),
            "nan": (observation * np.nan, reward, over, cut, {"cost": 0.0}),
            "nan reward": (observation, np.nan, over, cut, {"cost": 0.0}),
            "huge": (np.full(1, 1e300), reward, over, cut, {"cost": 0.0}),
            "longer": (np.zeros(2), reward, over, cut, {"cost": 0.0}),
            "complex": (observation * 1j, reward, over, cut, {"cost": 0.0}),
            "no reward": (observation, None, over, cut, {"cost": 0.0}),
            "rewards": (observation, np.zeros(2), over, cut, {"cost": 0.0}),
            "ragged": (observation, reward, over, cut, {"cost": [[1], [1, 2]]}),
            "no flag": (observation, reward, None, cut, {"cost": 0.0}),
            "flags": (observation, reward, over, np.array([False]), {"cost": 0.0}),
        }.get(Odd.fault, (observation, reward, over, cut, {"cost": 0.0}))


@pytest.fixture
def odd(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., GymVectorEnv]]:
    def make(fault: str, rules: Rules = NO_RULES, *, after: int = 0) -> GymVectorEnv:
        monkeypatch.setattr(Odd, "fault", fault)
        monkeypatch.setattr(Odd, "after", after)
        return GymVectorEnv("test/Odd-v0", 1, rules)

    gymnasium.register(
        "test/Odd-v0", entry_point=Odd, max_episode_steps=4, disable_env_checker=True
    )
    yield make
    del gymnasium.registry["test/Odd-v0"]


NO_COST = (
    r"^test/Odd-v0: its steps report no info\['cost'\], so that no violation could be counted; it "
    r"must report one at every step .* or give --termination-is-violation"
)
REFUSED = {
    "four": r"^test/Odd-v0: step\(\) returns a tuple of 4 \(ndarray, float, bool, dict\), where",
    "bare reset": r"^test/Odd-v0: reset\(\) returns no tuple but a ndarray, where Gymnasium wants",
    "silent": NO_COST,
    "two": r"^test/Odd-v0: info\['cost'\] has 2 costs, .* --violation \"cost\[0\] > 0",
    "half": r"^test/Odd-v0: info\['cost'\] is 0.5; a cost is 1 .* --violation \"cost > 0\"",
    "nan cost": r"^test/Odd-v0: info\['cost'\] is nan$",
    "text": r"^test/Odd-v0: info\['cost'\] is 'high', not a number$",
    "ragged": r"^test/Odd-v0: info\['cost'\] differs in shape",
    "no flag": r"^test/Odd-v0: step\(\) says that its episode is .*: None, False, where",
    "flags": r"^test/Odd-v0: step\(\) says that .*, array\(\[False\]\), where Gymnasium wants",
}
LATER = {fault: REFUSED[fault] for fault in ("silent", "half", "nan cost")} | {
    "nan": r"^test/Odd-v0: one of its observations is not finite: \[",
    "nan reward": r"^test/Odd-v0: one of its rewards is not finite: \[",
    "huge": r"^test/Odd-v0: one of its observations is not finite: \[",
    "longer": r"^test/Odd-v0: its observations have shape \(2,\), not \(1,\)$",
    "complex": r"^test/Odd-v0: its observations are complex128, not real numbers",
    "no reward": r"^test/Odd-v0: its rewards are object, not real numbers: None$",
    "rewards": r"^test/Odd-v0: its rewards have shape \(2,\), not \(\)$",
}


@pytest.mark.parametrize("fault", REFUSED)
def test_environments_that_say_too_little_are_refused_before_the_first_step(
    fault: str, odd: Callable[..., GymVectorEnv]
) -> None:
    with pytest.raises(ValueError, match=REFUSED[fault]):
        odd(fault)


@pytest.mark.parametrize("fault", LATER)
def test_what_goes_wrong_later_stops_the_run(fault: str, odd: Callable[..., GymVectorEnv]) -> None:
    env = odd(fault, after=1)
    env.reset(seed=0)
    env.step(np.zeros((1, 2)))
    with pytest.raises(ValueError, match=LATER[fault]):
        env.step(np.zeros((1, 2)))


def test_observations_at_reset_are_finite(odd: Callable[..., GymVectorEnv]) -> None:
    env = odd("nan reset")
    with pytest.raises(ValueError, match="^test/Odd-v0: one of its observations is not finite"):
        env.reset(seed=0)


def test_an_end_can_be_a_violation(odd: Callable[..., GymVectorEnv]) -> None:
    for fault in ("ends", "ends at no cost"):
        env = odd(fault, ENDS)
        env.reset(seed=0)
        found = [env.step(np.zeros((1, 2))) for _ in range(3)]
        assert [float(info["cost"][0]) for *_, info in found] == [0, 0, 1]
    env = odd("silent", ENDS)  # the time limit ends its episodes, and is none
    env.reset(seed=0)
    *_, (_, _, terminated, truncated, info) = [env.step(np.zeros((1, 2))) for _ in range(4)]
    assert (bool(terminated[0]), bool(truncated[0]), info["cost"][0]) == (False, True, 0)


def test_a_rule_already_given_is_not_advised(odd: Callable[..., GymVectorEnv]) -> None:
    both = Rules(violation="cost > 0", termination_is_violation=True)
    with pytest.raises(ValueError, match=r"or at none, without --violation"):
        odd("silent", both)


def test_of_several_constraints_one_counts(odd: Callable[..., GymVectorEnv]) -> None:
    env = odd("two", Rules(violation="cost[1] >= 2"))
    env.reset(seed=0)
    assert [float(env.step(np.zeros((1, 2)))[4]["cost"][0]) for _ in range(2)] == [0, 1]
    with pytest.raises(ValueError, match=r"there is no cost\[2\]"):
        odd("two", Rules(violation="cost[2] > 0"))


@pytest.mark.usefixtures("counter")
def test_without_a_time_limit_one_is_wanted() -> None:
    gymnasium.registry["test/Counter-v0"].max_episode_steps = None
    message = r"^test/Counter-v0: it is registered without a time limit .* give --time-limit STEPS"
    with pytest.raises(ValueError, match=message):
        make_vector_env("gym:test/Counter-v0", 1)
    rules = Rules(violation="cost > 1", time_limit=7)
    assert run_episodes("gym:test/Counter-v0", still, None, 2, 0, 1, rules).length == 7
    with pytest.raises(ValueError, match="^time_limit must be at least 1, not 0$"):
        Rules(time_limit=0)


def test_rules_are_for_gymnasiums_environments() -> None:
    with pytest.raises(ValueError, match="^brake knows its violations and its time limit: "):
        make_vector_env("brake", 1, ENDS)


def test_few_copies_of_others_simulators_are_evaluated_at_once() -> None:
    assert evaluation_copies("brake") is None
    assert evaluation_copies("real:static-env") == evaluation_copies("gym:Pendulum-v1") == 4


def test_a_fleet_is_a_function_of_its_seeds() -> None:
    both, alone = (Fleet("gym:Pendulum-v1", seeds, 2, ENDS) for seeds in ((4, 9), (9,)))
    first = both.reset()
    assert np.array_equal(first[1:], alone.reset())
    assert len(np.unique(first[..., 0])) == 4
    action = np.random.default_rng(0).uniform(-1, 1, (205, 2, 2, 1)).astype(np.float32)
    for step in action:
        arrived, one = both.step(step), alone.step(step[1:])
        for two, own in zip(arrived, one, strict=True):
            assert np.array_equal(np.asarray(two)[1:], np.asarray(own))


def test_training_seeds_reproduce_and_truncation_is_no_end(tmp_path: Path) -> None:
    found = train(PENDULUM, tmp_path / "both", quiet=True)
    again = train(replace(PENDULUM, seeds=(3,)), tmp_path / "one", quiet=True)
    assert found.seeds[1].acr == pytest.approx(again.seeds[0].acr, rel=1e-3)
    assert found.seeds[0].acr != found.seeds[1].acr
    assert [entry.episodes for entry in found.seeds] == [4, 4]
    assert {entry.tv for entry in found.seeds} == {0}
    assert [row["length"] for row in table(tmp_path / "both" / "evaluations.csv")] == ["200"] * 4
    replay = Replay(tmp_path / "both" / "replay.bin", (0, 3), 2, 410, 205, 3, 1)
    rows = replay._rows.reshape(2, 615, 2, 12)[:, :410]
    speed, torque, after = rows[..., 2], rows[..., 4], rows[..., 7]
    assert 1.5 < np.abs(torque).max() <= 2  # newton metres
    # Every transition is the pendulum's own, the last ones before a time limit as well.
    moved = (speed + 0.05 * (15 * rows[..., 1] + 3 * torque)).clip(-8, 8)
    assert after == pytest.approx(moved, abs=1e-4)
    ends = np.isin(np.arange(410), (199, 399))
    assert np.array_equal(rows[..., 11], np.broadcast_to(ends[:, None], (2, 410, 2)))
    goes_on = (rows[:, :-1, :, 5:8] == rows[:, 1:, :, :3]).all(axis=(0, 2, 3))
    assert np.array_equal(goes_on, ~ends[:-1])
    # Neither terminal nor a cost: the target bootstraps through the time limit.
    assert not rows[..., 9:11].any()


def test_a_resumed_run_begins_new_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = 0
    plain = deep.train.run._Run.advance

    def killed_once(self: deep.train.run._Run) -> Any:
        nonlocal steps
        steps += 1
        if steps == 300:
            raise KeyboardInterrupt
        return plain(self)

    monkeypatch.setattr(deep.train.run._Run, "advance", killed_once)
    with pytest.raises(KeyboardInterrupt):
        train(PENDULUM, tmp_path, quiet=True)
    found = train(PENDULUM, tmp_path, quiet=True)
    replay = Replay(tmp_path / "replay.bin", (0, 3), 2, 410, 205, 3, 1)
    rows = replay._rows.reshape(2, 615, 2, 12)[:, :410]
    # Other episodes than the first, and none of them across the seam.
    assert not (rows[:, 0, :, :3] == rows[:, 205, :, :3]).any()
    assert np.flatnonzero(rows[0, :, 0, 11]).tolist() == [199, 204, 404]
    # 205 steps before the checkpoint end one episode of each copy, 205 after it another.
    assert [entry.episodes for entry in found.seeds] == [4, 4]


RAILS = {"wide": (-30.0, 30.0, 0.01), "odd": (-0.1, 0.7, 0.5), "high": (99.9, 100.3, 0.004)}
"""Lower bound, upper bound, and how far a unit of force moves the cart."""


@pytest.mark.parametrize("rail", RAILS)
def test_one_unit_from_the_data_to_the_actuator(rail: str, tmp_path: Path) -> None:
    """Train, record, pretrain, train behind it, plug it in, wrap: newtons everywhere."""
    low, high, unit = RAILS[rail]
    kwargs = {"low": low, "high": high, "unit": unit}
    gymnasium.register("test/Rail-v0", entry_point=Rail, max_episode_steps=20, kwargs=kwargs)
    try:
        tiny = replace(PENDULUM, task="gym:test/Rail-v0", seeds=(0,), steps=410, replay=410)
        tiny = replace(tiny, checkpoint_every=410)
        train(tiny, tmp_path / "sac", quiet=True)
        log = offline_data(tiny.task, tmp_path / "sac", 0, 200, None, np.random.default_rng(0))
        moved = (log.next_observations - log.observations)[:, 0]
        assert moved == pytest.approx(unit * log.actions[:, 0], abs=1e-5)
        assert low <= log.actions.min() < low + 0.05 * (high - low)
        assert high >= log.actions.max() > high - 0.05 * (high - low)
        policy = TrainedPolicy.load(tmp_path / "sac" / "policies" / "seed0.safetensors")
        chosen = policy.act(log.observations)
        assert low - 1e-5 <= chosen.min() < chosen.max() <= high + 1e-5
        write_hdf5(log, tmp_path / "log.hdf5")
        assert read_hdf5(tmp_path / "log.hdf5").actions.max() == log.actions.max()
        for method in (DeaRrlAnnealedSettings(hidden=(8,)), RrlSettings(hidden=(8,))):
            critics, behind = tmp_path / f"{type(method)}", tmp_path / f"behind{type(method)}"
            of_log = PretrainConfig(
                data=tmp_path / "log.hdf5", method=method, horizon=1, updates=30, seeds=(0,)
            )
            (safety,) = pretrain_in_folder(of_log, critics, quiet=True).filters
            wanted = Bounds((low,), (high,))
            assert safety.for_actions(wanted, "here").actions == wanted
            train(replace(tiny, safety=critics), behind, quiet=True)
            rows = Replay(behind / "replay.bin", (0,), 2, 205, 205, 1, 1)._rows[0, :410]
            assert rows[:, 3] - rows[:, 0] == pytest.approx(unit * rows[:, 2], abs=1e-5)
            assert (rows[:, 1:3] >= low - 1e-6).all()
            assert (rows[:, 1:3] <= high + 1e-6).all()
            evaluate_policies(tmp_path / "sac", critics, behind / "plugged", episodes=2)
            rail_env = gymnasium.make("test/Rail-v0")
            protected = BehaviorCorrection(rail_env, safety)
            for action in (low, high, (low + high) / 2, 1e9):
                protected.reset(seed=0)
                before = protected.unwrapped.place  # type: ignore[attr-defined]  # Rail's own
                seen, *_, info = protected.step(np.array([action]))
                assert seen[0] == pytest.approx(before + unit * info["executed_action"][0])
    finally:
        del gymnasium.registry["test/Rail-v0"]


def test_learners_see_actions_that_fill_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[float] = []
    plain = Sac.update

    def spy(self: Sac, batch: TaskBatch) -> TaskLosses:
        seen.extend(float(part.abs().max()) for part in (batch.action, batch.executed))
        return plain(self, batch)

    monkeypatch.setattr(Sac, "update", spy)
    train(replace(PENDULUM, steps=140, replay=140, checkpoint_every=140), tmp_path, quiet=True)
    assert seen
    assert 0.8 < min(seen) <= max(seen) <= 1 + 1e-6


def test_what_was_made_in_other_units_is_refused(tmp_path: Path) -> None:
    kwargs = {"low": -30.0, "high": 30.0}
    gymnasium.register("test/Rail-v0", entry_point=Rail, max_episode_steps=20, kwargs=kwargs)
    try:
        tiny = replace(PENDULUM, task="gym:test/Rail-v0", seeds=(0,), steps=410, replay=410)
        tiny = replace(tiny, checkpoint_every=410)
        train(tiny, tmp_path / "sac", quiet=True)
        log = offline_data(tiny.task, tmp_path / "sac", 0, 200, None, np.random.default_rng(0))
        write_hdf5(log, tmp_path / "log.hdf5")
        critics = PretrainConfig(
            data=tmp_path / "log.hdf5",
            method=DeaRrlAnnealedSettings(hidden=(8,)),
            horizon=1,
            updates=3,
        )
        pretrain_in_folder(critics, tmp_path / "critics", quiet=True)
        kwargs |= {"low": -3.0, "high": 3.0}
        gymnasium.registry["test/Rail-v0"].kwargs |= kwargs
        refused = r"gym:test/Rail-v0: its actions lie in \(-3\) to \(3\), the filter was trained on"
        with pytest.raises(ValueError, match=refused):
            train(replace(tiny, safety=tmp_path / "critics"), tmp_path / "behind", quiet=True)
        assert not (tmp_path / "behind").exists()
        refused = (
            r"its policies choose actions in \(-30\) to \(30\), those of gym:test/Rail-v0 lie in"
        )
        with pytest.raises(ValueError, match=refused):
            evaluate_policies(tmp_path / "sac", None, tmp_path / "plugged", episodes=2)
        with pytest.raises(ValueError, match=r"sac: it recorded actions in \(-30\) to \(30\), "):
            offline_data(tiny.task, tmp_path / "sac", 0, 0, None, np.random.default_rng(0))
        (tmp_path / "sac" / "result.json").unlink()  # as if it were still at work
        with pytest.raises(ValueError, match="not in the environment's units, within .-3. to .3."):
            train(tiny, tmp_path / "sac", quiet=True)
    finally:
        del gymnasium.registry["test/Rail-v0"]
