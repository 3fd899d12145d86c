"""Exploring environments by copying and stepping them."""

import random
import sys
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

from dead_ends.envs.safe_mdp_env import SafeMDPEnv
from dead_ends.io import NoFailureWarning, load_model
from dead_ends.io.environment_model import EnvironmentModel
from dead_ends.io.errors import MissingDependencyError
from dead_ends.io.estimation import estimate_model
from dead_ends.io.explore import explore, explore_minigrid, minigrid_key
from dead_ends.io.gymnasium_table import make_environment
from dead_ends.labels.classification import classify


def position(env: Any) -> int:
    return int(env.s)


class Line(gymnasium.Env[int, int]):
    """Places 0, 1, ...; how an action moves is said by the subclass. Beyond 9 it is over."""

    action_space: gymnasium.spaces.Space[Any] = gymnasium.spaces.Discrete(2)
    observation_space = gymnasium.spaces.Discrete(10)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.s = self.steps = self.speed = 0
        return 0, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.s = max(0, self.s + self.move(int(action)))
        return self.s, 0.0, self.s > 9, False, {}

    def move(self, action: int) -> int:
        return 2 * action - 1


def lake(**arguments: Any) -> Any:
    return gymnasium.make("FrozenLake-v1", is_slippery=False, **arguments)


def test_exploring_finds_the_table() -> None:
    """FrozenLake's own table is the oracle: all its states can be reached."""
    env = lake()
    explored = explore(env, position, fail_if="done and r <= 0", name=str)
    table = load_model(env)
    assert explored.state_names is not None
    order = [int(name) for name in explored.state_names]
    assert sorted(order) == list(range(16))
    assert np.array_equal(explored.fail, table.fail[order])
    assert np.array_equal(explored.terminal, table.terminal[order])
    theirs = table.successors()[order]
    ours = np.where(explored.successors() < 0, -1, np.array(order)[explored.successors()])
    assert np.array_equal(ours, theirs)
    assert explored.initial is not None
    assert np.flatnonzero(explored.initial).tolist() == [0]


def test_the_environment_is_left_alone() -> None:
    env = lake()
    env.reset(seed=3)
    env.step(2)
    explore(env, position, fail_if="done and r <= 0")
    assert env.unwrapped.s == 1


def test_violations_that_do_not_end_the_episode() -> None:
    model = explore(gymnasium.make("CliffWalking-v1"), position, fail_if="r <= -100")
    # 48 cells without the ten of the cliff, which are never entered, and the fail state.
    assert model.num_states == 39
    assert model.fail.sum() == 1
    assert model.terminal.sum() == 1
    assert not classify(model).dead.any()


def test_without_a_condition_nothing_fails() -> None:
    model = explore(lake(), position)
    assert not model.fail.any()
    assert model.terminal.sum() == 5


def test_a_progress_bar(capsys: pytest.CaptureFixture[str]) -> None:
    explore(lake(), position, progress=True)
    assert "15 states" in capsys.readouterr().err


def test_what_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"FrozenLake-v1: more than 7 states \(max_states\)"):
        explore(lake(), position, max_states=7)
    with pytest.raises(ValueError, match="action .: two tries differ; the environment is stoch"):
        explore(gymnasium.make("FrozenLake-v1"), position)
    with pytest.raises(ValueError, match=r"Pendulum-v1: .* actions must be Discrete, not Box"):
        explore(gymnasium.make("Pendulum-v1"), lambda env: env.state)
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with pytest.raises(MissingDependencyError, match=r"tqdm: pip install 'dead-ends\[explore\]'"):
        explore(lake(), position, progress=True)


class FromOne(Line):
    """Actions are numbered from 1; action 2 falls."""

    action_space = gymnasium.spaces.Discrete(2, start=1)

    def move(self, action: int) -> int:
        return {1: 0, 2: 10}[action]


def test_actions_that_do_not_start_at_0() -> None:
    model = explore(FromOne(), position, fail_if="done and a == 2")
    assert model.successors().tolist() == [[0, 1], [-1, -1]]
    assert model.fail.tolist() == [False, True]
    assert model.action_names == ("1", "2")
    with pytest.warns(NoFailureWarning, match="no transition satisfies 'done and a == 1'"):
        assert not explore(FromOne(), position, fail_if="done and a == 1").fail.any()


@pytest.mark.parametrize(
    "space", [gymnasium.spaces.MultiDiscrete([2, 2]), gymnasium.spaces.MultiBinary(2)]
)
def test_other_action_spaces_are_named(space: gymnasium.spaces.Space[Any]) -> None:
    env = Line()
    env.action_space = space
    with pytest.raises(ValueError, match=r"actions must be Discrete, not Multi(Discrete|Binary)\("):
        explore(env, position)


class Sled(Line):
    """Actions change the speed."""

    action_space = gymnasium.spaces.Discrete(3)

    def move(self, action: int) -> int:
        self.speed = int(np.clip(self.speed + action - 1, -3, 3))
        return self.speed


class Battery(Line):
    """Nothing moves any more after 60 steps."""

    def move(self, action: int) -> int:
        return 0 if self.steps > 60 else super().move(action)


class FarAway(Line):
    """From place 150, farther than any random walk comes, the way on depends on the way there."""

    def move(self, action: int) -> int:
        jumps = self.s == 150 and self.speed == 0
        self.speed = action
        return 3 if jumps else super().move(action)

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        *_, info = super().step(action)
        return self.s, 0.0, self.s > 155, False, info


class Toll(Line):
    """Going back to 0 ends the episode, on the second visit at a price."""

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        *_, info = super().step(action)
        self.speed += self.s == 1
        return self.s, -1.0 * (self.speed > 1), self.s > 2, False, info


@pytest.mark.parametrize(
    ("env", "fail_if", "message"),
    [
        (
            Sled(),
            None,
            r"state . \(.\), action .: leads to state . \(.\) on one path and to .* on another",
        ),
        (
            Battery(),
            None,
            r"to state . \(.\) on one path and to state . \(.\) on another; the key d",
        ),
        (
            FarAway(),
            None,
            r"state 150 \(150\), action 0: leads to state .* and to a new state .* on",
        ),
        (Toll(), "r < 0", r"state . \(.\), action .: a violation on one path and none on another"),
    ],
)
def test_a_key_that_forgets_something_is_refused(env: Any, fail_if: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        explore(env, position, fail_if=fail_if)


def test_the_whole_key_is_accepted() -> None:
    assert explore(Sled(), lambda env: (env.s, env.speed), fail_if="done").fail.sum() == 6
    assert explore(Battery(), lambda env: (env.s, min(env.steps, 60))).num_states > 60
    assert explore(Toll(), position).terminal.sum() == 1


@pytest.mark.parametrize(
    "key",
    [
        lambda env: np.array([env.s, env.speed]),
        lambda env: np.array([env.s + 1, env.speed], dtype=float if env.steps else int),
        lambda env: [env.s, [float(env.speed)]],
        lambda env: {"place": np.array(env.s), "others": [{"speed": np.float32(env.speed)}]},
    ],
)
def test_keys_of_arrays(key: Callable[[Any], Any]) -> None:
    env = Sled()
    model = explore(env, key, fail_if="done")
    reference = explore(env, lambda env: (env.s, env.speed), fail_if="done")
    assert np.array_equal(model.successors(), reference.successors())
    env.reset()
    assert model.state_of(key(env)) == 0
    env.step(2)
    assert model.state_of(key(env)) == model.successors()[0, 2]


def test_a_key_without_a_value_is_refused() -> None:
    with pytest.raises(
        ValueError, match="something of type object, which is not told apart by its"
    ):
        explore(Line(), lambda env: (env.s, object()))


def test_which_key_is_which_state() -> None:
    model = explore(lake(), position, fail_if="done and r <= 0")
    running = np.flatnonzero(~model.fail & ~model.terminal)
    assert [model.state_of(model.keys[state]) for state in running] == running.tolist()
    table = load_model(lake())
    for state in running:
        place = model.keys[state]
        ours = [model.keys[s] for s in model.successors()[state]]
        assert [getattr(key, "key", key) for key in ours] == table.successors()[place].tolist()
    with pytest.raises(ValueError, match="no state has the key 5"):  # a hole: the episode is over
        model.state_of(5)


class PythonsDraw(Line):
    def move(self, action: int) -> int:
        return random.choice((action, 1))


class NumPysDraw(Line):
    def move(self, action: int) -> int:
        return int(np.random.randint(2)) * action  # noqa: NPY002  (as careless environments do)


class OwnDraw(Line):
    def __init__(self) -> None:
        self.draw = np.random.default_rng(0)

    def move(self, action: int) -> int:
        return int(self.draw.integers(2)) * action


class PartsDraw(Line):
    """The first draw alone would always be the same, and a walk always begins with it."""

    def __init__(self) -> None:
        self.parts = [{"weather": SimpleNamespace(draw=np.random.default_rng(0))}]

    def move(self, action: int) -> int:
        chance = self.s == 9 and self.parts[0]["weather"].draw.random() < 0.3
        return 0 if chance else 1 + action


SHARED = np.random.default_rng(0)


class SharedDraw(Line):
    def move(self, action: int) -> int:
        return int(SHARED.integers(2)) * action


@pytest.mark.parametrize("env", [PythonsDraw(), NumPysDraw(), OwnDraw(), PartsDraw(), SharedDraw()])
def test_chance_is_noticed_wherever_it_comes_from(env: Any) -> None:
    ours = random.getstate(), np.random.get_state()[1].tolist()  # type: ignore[index, union-attr]  # noqa: NPY002
    with pytest.raises(ValueError, match="the environment is stochastic"):
        explore(env, position)
    theirs = random.getstate(), np.random.get_state()[1].tolist()  # type: ignore[index, union-attr]  # noqa: NPY002
    assert ours == theirs


class DrawnStart(Line):
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.s = random.randrange(10)
        return self.s, {}


def test_a_first_state_that_no_seed_gives_again() -> None:
    env = DrawnStart()
    with pytest.raises(ValueError, match="two resets with seed 0 differ, so that something else"):
        explore(env, position)
    env.reset()
    env.s = 4
    model = explore(env, position, seed=None)
    assert (model.state_of(4), model.seed, env.s) == (0, None, 4)


@pytest.mark.parametrize("name", ["LavaGapS5", "LavaCrossingS9N1", "DistShift1"])
def test_minigrids_lava_maps_have_no_dead_ends(name: str) -> None:
    model = load_model(f"MiniGrid-{name}-v0")
    labelling = classify(model)
    assert labelling.fail.any()
    assert not labelling.dead.any()
    assert model.terminal.any()
    assert model.state_names is not None
    assert model.state_names[0] == "column 1, row 1, facing right"
    # Lava is entered from the side one faces, and from nowhere else.
    entering = np.argwhere(np.isin(model.successors(), np.flatnonzero(model.fail)))
    assert {int(action) for _, action in entering} == {2}


def test_the_seed_of_a_layout() -> None:
    seeds = (0, 1)
    models = [load_model("MiniGrid-LavaGapS5-v0", seed=seed) for seed in seeds]
    assert [repr(model)[-18:] for model in models] == [f"reset with seed {n})" for n in seeds]
    assert isinstance(models[0], EnvironmentModel)
    env = make_environment("MiniGrid-LavaGapS5-v0")
    env.reset(seed=0)
    assert models[0].state_of(minigrid_key(env.unwrapped)) == 0
    env.reset(seed=1)
    with pytest.raises(ValueError, match="no state has the key"):
        models[0].state_of(minigrid_key(env.unwrapped))
    here = explore_minigrid(env, seed=None)
    assert np.array_equal(here.successors(), models[1].successors())
    with pytest.raises(ValueError, match=r"FrozenLake-v1: seed \(--seed\) means nothing for this"):
        load_model("FrozenLake-v1", seed=1)


def test_minigrid_options() -> None:
    with pytest.warns(NoFailureWarning, match="v0: no transition satisfies 'r > 2'"):
        nothing = load_model("MiniGrid-LavaGapS5-v0", fail_if="r > 2")
    assert not nothing.fail.any()
    with pytest.raises(ValueError, match=r"fail_states \(--fail-states\) means nothing"):
        load_model("MiniGrid-LavaGapS5-v0", fail_states=[0])
    with pytest.raises(ValueError, match="the environment is stochastic"):
        explore_minigrid(gymnasium.make("MiniGrid-Dynamic-Obstacles-5x5-v0"))


class Twice(gymnasium.Wrapper[Any, int, Any, int]):
    """Each action is done twice."""

    def step(self, action: int) -> Any:
        self.env.step(action)
        return self.env.step(action)


class EndsEarly(gymnasium.Wrapper[Any, int, Any, int]):
    """The episode is over beyond 5."""

    def step(self, action: int) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated or observation > 5, truncated, info


@pytest.mark.parametrize("wrapper", [Twice, EndsEarly])
def test_a_wrapper_that_changes_the_steps_is_refused(wrapper: Any) -> None:
    """Or a filter made from the model would promise what the environment does not keep."""
    with pytest.raises(
        ValueError, match=rf"with its wrapper {wrapper.__name__} the environment mo"
    ):
        explore(gymnasium.wrappers.TimeLimit(wrapper(Line()), 100), position)


def test_wrappers_that_change_no_step() -> None:
    reward = gymnasium.wrappers.TransformReward(Line(), lambda reward: reward - 1)
    env = gymnasium.wrappers.TimeLimit(gymnasium.wrappers.FlattenObservation(reward), 1)
    assert explore(gymnasium.Wrapper(env), position).num_states == 11


@pytest.mark.parametrize("limit", [0, 1, 10])
def test_the_limit_of_states(limit: int) -> None:
    with pytest.raises(ValueError, match=rf"more than {limit} states \(max_states\)"):
        explore(Line(), position, max_states=limit)
    assert explore(Line(), position, max_states=11).num_states == 11


class NoCopies(Line):
    def __deepcopy__(self, memo: Any) -> Any:
        raise RuntimeError("a camera is open")


class OldStep(Line):
    def step(self, action: int) -> Any:
        observation, reward, terminated, _, info = super().step(action)
        return observation, reward, terminated, info


class ManyRewards(Line):
    def step(self, action: int) -> Any:
        observation, _, *rest = super().step(action)
        return observation, np.zeros(2), *rest


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (NoCopies(), "the environment cannot be copied: a camera is open"),
        (OldStep(), "action 0: a step must give observation, .* and info, not 4 values"),
        (ManyRewards(), "action 0: a step's reward, terminated and truncated must be one number"),
    ],
)
def test_environments_that_are_not_gymnasiums(env: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        explore(env, position)


def test_what_steps_an_estimate_is_an_estimate() -> None:
    log = [(0, 0, 1), (1, 0, 1)]
    model = estimate_model(2, 2, log, np.zeros(2, bool), "optimistic", deterministic=True)
    env = SafeMDPEnv(replace(model, initial=np.array([1.0, 0.0])))
    assert explore(env, lambda env: env.state).estimate
