"""Exploring environments by copying and stepping them."""

import sys
from typing import Any

import gymnasium
import numpy as np
import pytest

from dead_ends.io import NoFailureWarning, load_model
from dead_ends.io.errors import MissingDependencyError
from dead_ends.io.explore import explore, explore_minigrid
from dead_ends.labels import classify


def position(env: Any) -> int:
    return int(env.s)


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
    with pytest.raises(ValueError, match=r"Pendulum-v1: the action space Box.* is not discrete"):
        explore(gymnasium.make("Pendulum-v1"), lambda env: env.state)
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with pytest.raises(MissingDependencyError, match=r"tqdm: pip install 'dead-ends\[explore\]'"):
        explore(lake(), position, progress=True)


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


def test_minigrid_options() -> None:
    with pytest.warns(NoFailureWarning, match="v0: no transition satisfies 'r > 2'"):
        nothing = load_model("MiniGrid-LavaGapS5-v0", fail_if="r > 2")
    assert not nothing.fail.any()
    with pytest.raises(ValueError, match=r"fail_states \(--fail-states\) means nothing"):
        load_model("MiniGrid-LavaGapS5-v0", fail_states=[0])
    with pytest.raises(ValueError, match="the environment is stochastic"):
        explore_minigrid(gymnasium.make("MiniGrid-Dynamic-Obstacles-5x5-v0"))
