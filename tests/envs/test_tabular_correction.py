"""Behavior correction on real environments: what the tables promise is what happens."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import dead_ends.envs.registration
from dead_ends import (
    SafeMDP,
    behavior_correction,
    classify,
    evaluate_policy,
    value_iteration,
)
from dead_ends.envs.safe_mdp_env import SafeMDPEnv
from dead_ends.envs.tabular_correction import TabularCorrection
from dead_ends.io.filter_table import FilterTable, load_filter, save_filter
from dead_ends.policies import allowed_actions, recovery_policy
from dead_ends.thresholds import threshold_interval

assert dead_ends.envs.registration.__name__  # importing it registers the environments

IDS = ["dead_ends/Brake-v0", "dead_ends/IceGrid-v0"]
EPISODES = 10_000


def make(env_id: str, **keywords: Any) -> gymnasium.Env[int, int]:
    """The environment without Gymnasium's per-step checks, which cost most of the time."""
    return gymnasium.make(env_id, disable_env_checker=True, **keywords)


def uniform_actions(count: int, rng: np.random.Generator) -> Iterator[int]:
    while True:
        yield from rng.integers(count, size=10_000).tolist()


def random_episodes(
    env: gymnasium.Env[int, int], episodes: int, rng: np.random.Generator
) -> Iterator[list[int]]:
    """The states entered in each episode of a uniformly random policy."""
    assert isinstance(env.action_space, gymnasium.spaces.Discrete)
    actions = uniform_actions(int(env.action_space.n), rng)
    env.reset(seed=int(rng.integers(2**31)))
    for _ in range(episodes):
        env.reset()
        path: list[int] = []
        ended = False
        while not ended:
            state, _, terminated, truncated, _ = env.step(next(actions))
            path.append(state)
            ended = terminated or truncated
        yield path


def exact_filter(model: SafeMDP) -> FilterTable:
    """The gate on Q* at a threshold inside its interval, with a greedy recovery policy."""
    critic = value_iteration(model)
    epsilon = threshold_interval(model).recommended
    assert epsilon is not None
    return FilterTable(allowed_actions(critic, epsilon), recovery_policy(critic))


@pytest.mark.parametrize("env_id", IDS)
def test_uncorrected_agents_enter_dead_ends_and_fail(env_id: str) -> None:
    env = make(env_id)
    assert isinstance(env.unwrapped, SafeMDPEnv)
    labelling = classify(env.unwrapped.model)
    entered = failed = 0
    for path in random_episodes(env, 300, np.random.default_rng(1)):
        entered += any(labelling.dead[state] for state in path)
        failed += labelling.fail[path[-1]]
    assert entered > 100
    assert failed > 100


@pytest.mark.parametrize("env_id", IDS)
def test_corrected_agents_never_fail(env_id: str) -> None:
    """10,000 episodes; none enters a dead-end either."""
    env = make(env_id, max_episode_steps=40)
    assert isinstance(env.unwrapped, SafeMDPEnv)
    safe = classify(env.unwrapped.model).safe.tolist()
    corrected = TabularCorrection(env, exact_filter(env.unwrapped.model))
    for path in random_episodes(corrected, EPISODES, np.random.default_rng(2)):
        assert all(safe[state] for state in path)
    assert corrected.interventions > EPISODES
    assert corrected.steps > 10 * EPISODES


def frozen_lake_model(env: gymnasium.Env[int, int]) -> SafeMDP:
    """FrozenLake's table with its holes as failures and its goal as terminal."""
    table: dict[int, dict[int, list[tuple[float, int, float, bool]]]] = env.unwrapped.P  # type: ignore[attr-defined]  # toy text has P, gymnasium.Env not
    P = np.zeros((16, 4, 16))
    for state, actions in table.items():
        for action, outcomes in actions.items():
            for probability, successor, _, _ in outcomes:
                P[state, action, successor] += probability
    symbols = env.unwrapped.desc.ravel()  # type: ignore[attr-defined]  # FrozenLake's map
    return SafeMDP.stochastic(P, symbols == b"H", terminal=symbols == b"G", initial=symbols == b"S")


@pytest.mark.parametrize("epsilon", [0.05, 0.3])
def test_frozen_lake_fails_as_often_as_predicted(epsilon: float, tmp_path: Path) -> None:
    """A 99.99% interval around the probability of V^pi at gamma = 1, from a table in a file."""
    env = make("FrozenLake-v1", is_slippery=True, max_episode_steps=100_000)
    model = frozen_lake_model(env)
    critic = value_iteration(model, 1.0)
    recovery = recovery_policy(critic)
    save_filter(tmp_path / "lake.npz", allowed_actions(critic, epsilon), recovery)
    uniform = np.full((16, 4), 0.25)
    policy: NDArray[Any] = behavior_correction(uniform, critic, epsilon, recovery)
    predicted = evaluate_policy(model, policy, 1.0).V[0]
    assert 0.1 < predicted < 0.9
    corrected = TabularCorrection(env, load_filter(tmp_path / "lake.npz"))
    episodes = 2000
    failures = sum(
        bool(model.fail[path[-1]])
        for path in random_episodes(corrected, episodes, np.random.default_rng(3))
    )
    spread = math.sqrt(predicted * (1 - predicted) / episodes)
    assert abs(failures / episodes - predicted) < 3.9 * spread


GO_LEFT = np.zeros(3, dtype=np.int64)
"""In the map "S.L": always left, towards the wall."""


def small_env() -> gymnasium.Env[int, int]:
    return make("dead_ends/IceGrid-v0", text=["S.L"])


def test_info_says_what_was_done() -> None:
    table = FilterTable(np.array([[True] * 4, [True, True, False, True], [False] * 4]), GO_LEFT)
    env = TabularCorrection(small_env(), table)
    _, info = env.reset(seed=0)
    assert "intervened" not in info
    state, _, _, _, info = env.step(2)
    assert (state, info["intervened"], info["task_action"], info["executed_action"]) == (
        1,
        False,
        2,
        2,
    )
    state, _, terminated, _, info = env.step(2)  # into the lava, if it were allowed
    assert (state, terminated) == (0, False)
    assert (info["intervened"], info["task_action"], info["executed_action"]) == (True, 2, 0)
    assert info["interventions"] == 1
    assert not info["violation"]  # the environment's own entries are kept
    env.reset()
    assert env.step(2)[4]["interventions"] == 0
    assert (env.steps, env.interventions) == (3, 1)


def test_step_needs_a_reset() -> None:
    env = TabularCorrection(small_env(), FilterTable(np.ones((3, 4), dtype=bool), GO_LEFT))
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"call reset before step"):
        env.step(0)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((4, 4), r"the environment's observations are Discrete\(3\), but the table has 4"),
        ((3, 5), r"the environment's actions are Discrete\(4\), but the table has 5"),
    ],
)
def test_tables_of_another_environment_are_refused(shape: tuple[int, int], message: str) -> None:
    table = FilterTable(np.ones(shape, dtype=bool), np.zeros(shape[0], dtype=int))
    with pytest.raises(ValueError, match=message):
        TabularCorrection(small_env(), table)


def test_other_spaces_are_refused() -> None:
    table = FilterTable(np.ones((3, 4), dtype=bool), GO_LEFT)
    with pytest.raises(ValueError, match=r"observations must be Discrete, not Box"):
        TabularCorrection(gymnasium.make("CartPole-v1"), table)
