"""Behavior correction on real environments: what the tables promise is what happens."""

import itertools
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
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
    safety_filter,
    value_iteration,
)
from dead_ends.__main__ import main
from dead_ends.envs.safe_mdp_env import SafeMDPEnv
from dead_ends.io import load_model
from dead_ends.io.explore import explore, explore_minigrid, minigrid_key
from dead_ends.io.gymnasium_table import make_environment
from dead_ends.safety.filter_table import FilterTable, load_filter, save_filter
from dead_ends.safety.policies import allowed_actions, recovery_policy
from dead_ends.safety.tabular_correction import TabularCorrection
from dead_ends.safety.thresholds import threshold_interval

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
    table = FilterTable(allowed_actions(critic, epsilon), recovery)
    save_filter(table, tmp_path / "lake.npz")
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
    assert (info["intervened"], info["task_action"], info["executed_action"]) == (False, -1, -1)
    kinds = {key: type(value) for key, value in info.items()}
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
    assert {key: type(value) for key, value in info.items()} == kinds
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
    with pytest.raises(ValueError, match=r"actions must be Discrete, not Box"):
        TabularCorrection(gymnasium.make("Pendulum-v1"), table)
    table = FilterTable(np.ones((3, 2), dtype=bool), GO_LEFT)
    with pytest.raises(ValueError, match=r"observations must be Discrete, not Box"):
        TabularCorrection(gymnasium.make("CartPole-v1"), table)


@pytest.mark.parametrize(
    ("name", "words", "violations"),
    [
        ("FrozenLake-v1", ["--env-arg", "is_slippery=False"], [(s, 0.0) for s in (5, 7, 11, 12)]),
        ("CliffWalking-v1", [], [(36, -100.0)]),
        ("Taxi-v4", ["--fail-if", "r <= -10"], [(s, -10.0) for s in range(500)]),
    ],
)
@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_exported_tables_of_gymnasiums_environments(
    name: str,
    words: list[str],
    violations: list[tuple[int, float]],
    suffix: str,
    tmp_path: Path,
) -> None:
    """The added states of violations and ends are none of the environment's observations."""
    path = tmp_path / f"filter{suffix}"
    assert main(["export", name, *words, "--out", str(path)]) == 0
    table = load_filter(path)
    arguments = {"is_slippery": False} if "Lake" in name else {}
    env = TabularCorrection(make(name, **arguments), table)
    env.action_space.seed(0)
    state, _ = env.reset(seed=0)
    for _ in range(3000):
        state, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert (state, reward) not in violations
        if terminated or truncated:
            env.reset()
    assert env.interventions > 100
    assert table.action_names is not None
    assert (table.state_names is None) == (name == "Taxi-v4")


class FromOne(gymnasium.Env[int, int]):
    """Observations 5 and 6, actions 1 and 2; 2 falls."""

    observation_space = gymnasium.spaces.Discrete(2, start=5)
    action_space = gymnasium.spaces.Discrete(2, start=1)
    taken: int

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.place = 5
        return 5, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.taken, self.place = action, 5 + (action == 2)
        return self.place, 0.0, action == 2, False, {}


@pytest.mark.parametrize("explored", [True, False])
def test_actions_that_do_not_start_at_0_are_not_confused(explored: bool) -> None:
    if explored:
        model: SafeMDP = explore(FromOne(), lambda env: env.place, fail_if="a == 2")
        env = TabularCorrection(FromOne(), safety_filter(model), key=lambda env: env.place)
    else:
        model = SafeMDP.deterministic([[0, 1], [-1, -1]], np.array([False, True]))
        env = TabularCorrection(FromOne(), safety_filter(model))
    _, info = env.reset()
    assert (info["task_action"], info["executed_action"]) == (0, 0)
    for action in (1, 2):
        info = env.step(action)[-1]
        assert (info["intervened"], info["task_action"]) == (action == 2, action)
        assert info["executed_action"] == env.unwrapped.taken == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "action", [4, -1, np.int64(7), 1.0, math.nan, np.float32(1), "1", None, [1], np.array([1, 2])]
)
def test_task_actions_that_are_none(action: Any) -> None:
    env = TabularCorrection(small_env(), FilterTable(np.ones((3, 4), dtype=bool), GO_LEFT))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"the task action .* is none of .* actions, 0 to 3$"):
        env.step(action)
    assert (env.steps, env.step(np.array(2))[0]) == (0, 1)


def lava() -> Any:
    pytest.importorskip("minigrid", reason="minigrid is not installed")
    return make_environment("MiniGrid-LavaGapS5-v0")


def table_of(env: gymnasium.Env[Any, int]) -> FilterTable:
    """The filter for the layout that was drawn."""
    return safety_filter(explore_minigrid(env, seed=None))


def crash(env: TabularCorrection, steps: int, rng: np.random.Generator) -> bool:
    """Whether random actions end the episode without a reward, mostly going forward."""
    for action in rng.choice([0, 1, 2, 2], size=steps).tolist():
        _, reward, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return terminated and not reward
    return False


def test_a_filter_of_an_explored_layout(tmp_path: Path) -> None:
    """It protects in that layout, and is refused in another."""
    env = lava()
    path = tmp_path / "lava.npz"
    assert main(["export", "MiniGrid-LavaGapS5-v0", "--seed", "1", "--out", str(path)]) == 0
    assert load_filter(path).metadata["seed"] == 1
    env = TabularCorrection(env, load_filter(path), key=minigrid_key)
    rng = np.random.default_rng(0)
    for _ in range(5):
        env.reset(seed=1)
        assert not crash(env, 100, rng)
    assert env.interventions > 5
    with pytest.raises(
        ValueError, match=r"state that the table \(MiniGrid-LavaGapS5-v0, seed 1\) d"
    ):
        env.reset(seed=0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)


def test_a_table_is_made_again_for_each_layout() -> None:
    made: list[FilterTable] = []

    def make_table(env: gymnasium.Env[Any, int]) -> FilterTable:
        made.append(table_of(env))
        return made[-1]

    env = TabularCorrection(lava(), make_table, key=minigrid_key)
    rng = np.random.default_rng(0)
    for seed in (0, 1, 1, 0):
        env.reset(seed=seed)
        assert env.table is made[-1]
        assert not crash(env, 100, rng)
    assert len(made) == 3
    assert env.interventions > 5


def test_what_is_made_or_keyed_wrongly() -> None:
    table = table_of_seed_0()
    with pytest.raises(ValueError, match="a table that is made at resets needs a key"):
        TabularCorrection(lava(), table_of)
    with pytest.raises(ValueError, match="observations must be Discrete, not Dict"):
        TabularCorrection(lava(), table)
    with pytest.raises(ValueError, match="the table has no keys: make it of what explore returns"):
        TabularCorrection(lava(), FilterTable(table.allowed, table.recovery), minigrid_key)
    lake = safety_filter(load_model("FrozenLake-v1"))
    keys = [str(state + 1) for state in range(16)]
    shifted = FilterTable(lake.allowed, lake.recovery, keys=keys)
    with pytest.raises(
        ValueError, match=r"keys of the table are not .* observations, Discrete\(16"
    ):
        TabularCorrection(make("FrozenLake-v1"), shifted)
    with pytest.raises(ValueError, match=r"observations are Discrete\(64\), but the table has 16"):
        TabularCorrection(make("FrozenLake-v1", map_name="8x8"), lake)


def test_another_map_is_refused() -> None:
    """Though its observations are numbered alike; so is the same map on other ice."""
    lake = safety_filter(load_model("FrozenLake-v1"))
    for arguments in ({"desc": ["SFFF", "FFFF", "FFFF", "FHFG"]}, {"is_slippery": False}):
        with pytest.raises(ValueError, match="from another transition table than the environ"):
            TabularCorrection(make("FrozenLake-v1", **arguments), lake)
    assert TabularCorrection(make("FrozenLake-v1"), lake).table is lake
    ice = safety_filter(load_model(make("dead_ends/IceGrid-v0", text=["S.L"])))
    assert TabularCorrection(small_env(), ice).table is ice
    with pytest.raises(ValueError, match="from another transition table than the environ"):
        TabularCorrection(make("dead_ends/IceGrid-v0", text=["SL."]), ice)


def test_wrappers_that_renumber_are_refused_beneath() -> None:
    lake = safety_filter(load_model("FrozenLake-v1"))
    env, space = make("FrozenLake-v1"), gymnasium.spaces.Discrete(4)
    for wrapped in (
        gymnasium.wrappers.TransformAction(env, lambda action: 3 - action, space),
        gymnasium.wrappers.TransformObservation(
            env, lambda state: 15 - state, env.observation_space
        ),
    ):
        with pytest.raises(ValueError, match=r"Transform\w+ changes what the table was made for"):
            TabularCorrection(wrapped, lake)


class DrawnLake(gymnasium.Wrapper[int, int, int, int]):
    """A new map at every other reset."""

    def __init__(self) -> None:
        super().__init__(make("FrozenLake-v1", is_slippery=False))
        self.maps = itertools.cycle([["SF", "HG"], ["SF", "HG"], ["SH", "FG"]])

    @property
    def unwrapped(self) -> Any:
        return self.env.unwrapped

    def reset(self, **keywords: Any) -> tuple[int, dict[str, Any]]:
        self.env = make("FrozenLake-v1", is_slippery=False, desc=next(self.maps))
        return self.env.reset(**keywords)


def test_a_table_of_maps_that_are_drawn_at_the_reset() -> None:
    drawn = DrawnLake()
    drawn.reset()
    fixed = TabularCorrection(drawn, safety_filter(load_model(drawn)))
    fixed.reset()
    with pytest.raises(ValueError, match="from another transition table than the environ"):
        fixed.reset()
    made: list[SafeMDP] = []

    def make_table(env: gymnasium.Env[Any, int]) -> FilterTable:
        made.append(load_model(env))
        return safety_filter(made[-1])

    env = TabularCorrection(DrawnLake(), make_table)
    for _ in range(6):
        env.reset()
    assert [np.flatnonzero(model.fail).tolist() for model in made] == [[2], [1], [2], [1]]


def table_of_seed_0() -> FilterTable:
    return safety_filter(explore_minigrid(lava()))


def remade(spec: gymnasium.envs.registration.EnvSpec | None) -> TabularCorrection:
    assert spec is not None
    env = gymnasium.make(spec)
    assert isinstance(env, TabularCorrection)
    env.reset(seed=0)
    return env


def test_the_spec_makes_the_wrapper_again(tmp_path: Path) -> None:
    table = safety_filter(load_model("FrozenLake-v1"))
    assert remade(TabularCorrection(make("FrozenLake-v1"), table).spec).table is table
    keyed = TabularCorrection(lava(), table_of, key=minigrid_key)
    assert remade(keyed.spec).key is minigrid_key
    save_filter(table, tmp_path / "lake.json")
    named = TabularCorrection(make("FrozenLake-v1"), str(tmp_path / "lake.json")).spec
    assert named is not None
    again = remade(gymnasium.envs.registration.EnvSpec.from_json(named.to_json())).table
    assert again is not None
    assert np.array_equal(again.allowed, table.allowed)


def tree_map(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """As of jax, which Minari's collector needs: the same keys everywhere, or an error."""
    if not isinstance(tree, dict):
        return function(tree, *others)
    assert all(tree.keys() == other.keys() for other in others)
    return {key: tree_map(function, tree[key], *(other[key] for other in others)) for key in tree}


def test_minari_records_every_info(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari", reason="minari is not installed")
    jax = ModuleType("jax")
    jax.tree_util = ModuleType("jax.tree_util")  # type: ignore[attr-defined]  # a stand-in
    jax.tree_util.tree_map = tree_map
    monkeypatch.setitem(sys.modules, "jax", jax)
    monkeypatch.setitem(sys.modules, "jax.tree_util", jax.tree_util)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    save_filter(safety_filter(load_model("FrozenLake-v1")), tmp_path / "lake.npz")
    env = TabularCorrection(make("FrozenLake-v1"), str(tmp_path / "lake.npz"))
    collector = minari.DataCollector(env, record_infos=True)
    for seed in range(3):
        collector.reset(seed=seed)
        for _ in range(10):
            if any(collector.step(2)[2:4]):
                break
    words = ("author", "author_email", "algorithm_name", "code_permalink", "description")
    about = dict.fromkeys(words, "a test")
    before = collector._tmp_dir
    dataset = collector.create_dataset("lake/filtered-v0", eval_env=env, **about)
    for folder in (before, collector._tmp_dir):  # which Minari leaves to the garbage collector
        folder.cleanup()
    infos = [episode.infos for episode in dataset]
    assert sum(int(info["intervened"].sum()) for info in infos) == env.interventions > 0
    assert all(
        info["task_action"][1:].tolist() == [2] * (len(info["intervened"]) - 1) for info in infos
    )
    assert isinstance(dataset.recover_environment(), gymnasium.Env)


def test_a_model_is_no_filter() -> None:
    env = make("FrozenLake-v1")
    model: Any = load_model(env)
    message = "a filter is needed, as safety_filter makes of a model, not EnvironmentModel"
    with pytest.raises(ValueError, match=message):
        TabularCorrection(env, model)
    with pytest.raises(ValueError, match=message):
        TabularCorrection(env, lambda _: model).reset()
