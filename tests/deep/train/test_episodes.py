"""Metrics on whole episodes, and the environments that they are run in."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from deep.filter.safety_filter import SafetyFilter
from deep.tasks import Brake, TaskEnv, TaskVectorEnv, make_task
from deep.tasks.vectorised import Fleet, environment_seed, make_vector_env
from deep.train.episodes import EVALUATION_STREAM, Episodes, run_episodes
from tests.deep.online_runs import blocking_filter, braking_filter

Floats = NDArray[np.float32]


def careless_near(observations: Floats) -> Floats:
    """Accelerates in the nearer half of the road, brakes beyond."""
    return np.where(observations[:, :1] < 0, 1.0, -1.0).astype(np.float32)


def arrays(episodes: Episodes) -> list[NDArray[np.generic]]:
    return [episodes.returns, episodes.lengths, episodes.violated, episodes.interventions]


@pytest.fixture(autouse=True)
def _short_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Brake, "time_limit", 12)


def one_after_the_other(safety: SafetyFilter | None, episodes: int, seed: int) -> list[list[float]]:
    """Return, length, violated and interventions of each, in a single environment."""
    env = TaskEnv(make_task("brake"))
    found = []
    seeds = [environment_seed(seed, EVALUATION_STREAM), *[None] * (episodes - 1)]
    for first in seeds:
        observation, _ = env.reset(seed=first)
        total, length, interventions, over = 0.0, 0, 0, False
        while not over:
            action = careless_near(observation[None])
            if safety is not None:
                correction = safety.correct(observation[None], action)
                action = correction.executed
                interventions += int(correction.intervened[0])
            observation, reward, terminated, truncated, info = env.step(action[0])
            total, length, over = total + reward, length + 1, terminated or truncated
        found.append([total, length, info["cost"] > 0, interventions])
    return found


@pytest.mark.parametrize("safety", [None, braking_filter()], ids=["open", "corrected"])
def test_one_copy_is_a_plain_loop(safety: SafetyFilter | None) -> None:
    episodes = run_episodes("brake", careless_near, safety, 30, seed=5, copies=1)
    expected = np.array(one_after_the_other(safety, 30, 5)).T
    assert 0 < expected[2].sum() < 30
    assert (expected[3].sum() > 0) == (safety is not None)
    for found, column in zip(arrays(episodes), expected, strict=True):
        assert np.array_equal(found, column)
    assert episodes.acr == pytest.approx(expected[0].mean())
    assert episodes.avr == expected[2].mean()
    assert episodes.arr == pytest.approx(expected[3].sum() / expected[1].sum())
    assert episodes.length == expected[1].mean()


@pytest.mark.parametrize("threshold", [0.5, 0.98])
@pytest.mark.parametrize("copies", [None, 1, 3, 4, 10, 25])
def test_every_copy_runs_its_share_of_whole_episodes(copies: int | None, threshold: float) -> None:
    safety = braking_filter(threshold)
    episodes = run_episodes("brake", careless_near, safety, 10, seed=3, copies=copies)
    n = min(copies or 10, 10)
    env = TaskVectorEnv(make_task("brake"), n)
    observation, _ = env.reset(seed=environment_seed(3, EVALUATION_STREAM))
    running = np.zeros((4, n))
    ended: list[list[NDArray[np.float64]]] = [[] for _ in range(n)]
    while any(len(done) < 10 for done in ended):
        correction = safety.correct(observation, careless_near(observation))
        observation, reward, terminal, timeout, info = env.step(correction.executed)
        running += np.stack([reward, np.ones(n), info["cost"], correction.intervened])
        for i in np.flatnonzero(terminal | timeout):
            ended[i].append(running[:, i].copy())
            running[:, i] = 0
    expected = np.array([ended[i % n][i // n] for i in range(10)]).T
    for found, column in zip(arrays(episodes), expected, strict=True):
        assert found.shape == (10,)
        assert found == pytest.approx(column)
    whole = episodes.violated | (episodes.lengths == 12)
    assert whole.all()
    if threshold == 0.98:  # episodes of different lengths
        assert 0 < episodes.violated.sum() < 10


def test_the_first_to_finish_are_those_that_failed() -> None:
    true = run_episodes("brake", careless_near, None, 4000, seed=0).avr
    assert 0.3 < true < 0.7
    share = run_episodes("brake", careless_near, None, 800, seed=1, copies=100).avr
    deviation = np.sqrt(true * (1 - true) / 800)
    assert abs(share - true) < 4 * deviation
    env = TaskVectorEnv(make_task("brake"), 100)
    observation, _ = env.reset(seed=1)
    first: list[bool] = []
    while len(first) < 100:
        observation, _, terminal, timeout, info = env.step(careless_near(observation))
        first.extend((info["cost"] > 0)[terminal | timeout].tolist())
    assert np.mean(first[:100]) > true + 4 * np.sqrt(true * (1 - true) / 100)


def test_everything_or_nothing_is_corrected() -> None:
    assert run_episodes("brake", careless_near, blocking_filter(5, 0.5), 8, 0).arr == 1
    assert run_episodes("brake", careless_near, blocking_filter(5, 1.0), 8, 0).arr == 0
    certain = blocking_filter(100, 1.0)  # Q = 1 is not below a threshold of 1
    assert run_episodes("brake", careless_near, certain, 8, 0).arr == 1


def test_episodes_are_a_function_of_the_seed() -> None:
    first, again, other = (run_episodes("brake", careless_near, None, 6, s) for s in (1, 1, 2))
    assert np.array_equal(first.returns, again.returns)
    assert not np.array_equal(first.returns, other.returns)
    assert environment_seed(1, 5) != environment_seed(1, 6) != environment_seed(2, 6)


def test_the_metrics_by_hand() -> None:
    episodes = Episodes(
        returns=np.array([1.0, -3.0]),
        lengths=np.array([2, 6]),
        violated=np.array([True, False]),
        interventions=np.array([2, 0]),
    )
    assert (episodes.acr, episodes.avr) == (-1.0, 0.5)
    assert (episodes.arr, episodes.length) == (0.25, 4.0)


@pytest.mark.parametrize(("episodes", "copies"), [(0, None), (3, 0), (-1, 2)])
def test_no_episodes_are_refused(episodes: int, copies: int | None) -> None:
    with pytest.raises(ValueError, match="^episodes and copies must be at least 1$"):
        run_episodes("brake", careless_near, None, episodes, 0, copies)


def test_unknown_tasks_are_refused() -> None:
    with pytest.raises(ValueError, match="^there is no task 'bike'; there are brake, "):
        make_vector_env("bike", 2)
    with pytest.raises(ValueError, match="^there is no real task 'bike'; there are "):
        make_vector_env("real:bike", 2)


def test_a_fleet_is_each_seeds_own_environments() -> None:
    fleet, alone = Fleet("brake", (4, 9), 3), Fleet("brake", (9,), 3)
    assert (fleet.observation_dim, fleet.action_dim) == (2, 1)
    observation = fleet.reset()
    assert np.array_equal(observation[1:], alone.reset())
    assert not np.array_equal(observation[0], observation[1])
    ended = 0
    for _ in range(40):
        action = np.stack([careless_near(part) for part in observation])
        arrived, one = fleet.step(action), alone.step(action[1:])
        for both, own in zip(arrived, one, strict=True):
            assert np.array_equal(both[1:], own)
        over = arrived.terminal | arrived.timeout
        assert np.array_equal(arrived.last[~over], arrived.observation[~over])
        # A car that hit the obstacle stands at it; its next episode starts elsewhere.
        assert (arrived.last[arrived.cost > 0, 0] == -1).all()
        assert (arrived.observation[..., 0] > -1).all()
        assert np.array_equal(arrived.cost > 0, arrived.terminal)
        ended += int(over.sum())
        observation = arrived.observation
    assert ended > 10
    kept = fleet.snapshot()
    assert kept is not None
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 2, 3, 1)).astype(np.float32)
    first = [fleet.step(action) for action in actions]
    other = Fleet("brake", (4, 9), 3)
    assert np.array_equal(other.restore(kept), observation)
    for before, action in zip(first, actions, strict=True):
        for old, new in zip(before, other.step(action), strict=True):
            assert np.array_equal(old, new)
    fleet.close()
