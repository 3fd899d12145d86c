"""The registered environments against Gymnasium's checker and against their models."""

import subprocess
import sys
from dataclasses import fields

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dead_ends import SafeMDP, classify
from dead_ends.envs import registration
from dead_ends.envs.bridge import bridge
from dead_ends.envs.safe_mdp_env import SafeMDPEnv
from dead_ends.io import load_model
from dead_ends.io.environment_model import EnvironmentModel

IDS = ["dead_ends/Brake-v0", "dead_ends/IceGrid-v0"]


def model_of(env: gymnasium.Env[int, int]) -> SafeMDP:
    assert isinstance(env.unwrapped, SafeMDPEnv)
    return env.unwrapped.model


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasium_checks_it(env_id: str) -> None:
    check_env(gymnasium.make(env_id, render_mode="rgb_array").unwrapped)
    check_env(gymnasium.make(env_id, render_mode="ansi").unwrapped)


@pytest.mark.parametrize("env_id", IDS)
def test_it_has_dead_ends_and_starts_safe(env_id: str) -> None:
    model = model_of(gymnasium.make(env_id))
    labelling = classify(model)
    assert labelling.reachable_horizon
    assert model.initial is not None
    assert labelling.safe[model.initial > 0].all()


@pytest.mark.parametrize("env_id", IDS)
def test_it_steps_the_model(env_id: str) -> None:
    env = gymnasium.make(env_id)
    model = model_of(env)
    successors, rng = model.successors(), np.random.default_rng(0)
    assert model.rewards is not None
    for episode in range(20):
        state, info = env.reset(seed=episode)
        ended = False
        while not ended:
            assert info["action_mask"].all()
            action = int(rng.integers(model.num_actions))
            expected = successors[state, action], model.rewards[state, action]
            state, reward, terminated, truncated, info = env.step(action)
            assert (state, reward) == expected
            assert info["violation"] == model.fail[state]
            assert info["cost"] == float(info["violation"])
            assert terminated == (model.fail[state] or model.terminal[state])
            ended = terminated or truncated


def test_time_limit_truncates() -> None:
    env = gymnasium.make("dead_ends/Brake-v0")
    env.reset(seed=0)
    for step in range(1, 101):
        _, _, terminated, truncated, _ = env.step(0)  # brake, then stand
        assert not terminated
        assert truncated == (step == 100)


@pytest.mark.parametrize("slip", [0.0, 0.2])
def test_table_is_the_model(slip: float) -> None:
    """A model built back from ``P``, as other tools read it, is the same."""
    env = gymnasium.make("dead_ends/IceGrid-v0", slip=slip).unwrapped
    assert isinstance(env, SafeMDPEnv)
    model = env.model
    P = np.zeros((model.num_states, 4, model.num_states))
    for state, actions in env.P.items():
        for action, outcomes in actions.items():
            for probability, successor, reward, terminated in outcomes:
                P[state, action, successor] += probability
                assert terminated == (model.fail | model.terminal)[successor]
                if not terminated or state != successor:
                    assert model.rewards is not None
                    assert reward == model.rewards[state, action]
    going = np.repeat(~model.fail, 4)
    kernel = model.transitions().toarray()
    np.testing.assert_array_equal(P.reshape(kernel.shape)[going], kernel[going])
    assert all(env.P[s][0] == [(1.0, s, 0.0, True)] for s in np.flatnonzero(model.fail).tolist())


@pytest.mark.parametrize("env_id", IDS)
def test_load_model_gives_the_model_that_is_stepped(env_id: str) -> None:
    env = gymnasium.make(env_id)
    with_keys = load_model(env)
    for field in fields(SafeMDP):
        assert getattr(with_keys, field.name) is getattr(model_of(env), field.name)
    assert isinstance(with_keys, EnvironmentModel)
    assert with_keys.keys == tuple(range(with_keys.num_states))
    loaded = load_model(env_id)
    np.testing.assert_array_equal(loaded.next_state, model_of(env).next_state)
    np.testing.assert_array_equal(loaded.fail, model_of(env).fail)
    assert loaded.geometry is not None


def test_load_model_takes_other_fail_states_from_the_table() -> None:
    loaded = load_model("dead_ends/IceGrid-v0", fail_states=[0])
    np.testing.assert_array_equal(np.flatnonzero(loaded.fail), [0])


def test_stochastic_steps_have_the_models_frequencies() -> None:
    """Jumping off the bridge: two falls with the same probability; 2000 draws."""
    env = SafeMDPEnv(bridge(5))
    env.reset(seed=1)
    falls = 0
    for _ in range(2000):
        env.reset(options={"state": 2})
        state, _, terminated, _, info = env.step(2)
        assert state in (5, 6)
        assert not terminated
        assert not info["violation"]
        falls += state == 5
    assert abs(falls - 1000) < 4 * np.sqrt(500)


def test_an_unavailable_action_is_refused() -> None:
    model = SafeMDP.deterministic(
        np.array([[0, -1], [1, 1]]), np.array([False, True]), initial=0, action_names=["a", "b"]
    )
    env = SafeMDPEnv(model)
    _, info = env.reset()
    np.testing.assert_array_equal(info["action_mask"], [1, 0])
    assert list(env.P[0]) == [0]
    assert env.step(0)[1] == 0.0  # a model without rewards
    with pytest.raises(ValueError, match=r"state 0: action 1 \(b\) is not available"):
        env.step(1)


def test_pictures_show_the_agent_where_it_is() -> None:
    env = registration.ice_grid_env(["S.", "L#"], render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (480, 480, 3)
    cells = picture[::240, ::240].reshape(4, 3)
    assert len(np.unique(cells, axis=0)) == 4  # agent, floor, lava, wall
    env.step(2)
    moved = env.render()
    assert isinstance(moved, np.ndarray)
    np.testing.assert_array_equal(moved[0, 240], picture[0, 0])


def test_pictures_show_ice_and_currents() -> None:
    env = registration.ice_grid_env(["S~><"], render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    agent, ice, current, other_current = picture[0, ::120].tolist()
    assert agent != ice != current == other_current


def test_pictures_of_diagrams_have_their_origin_below() -> None:
    env = registration.brake_env(render_mode="rgb_array")
    lattice = registration.BRAKE_LATTICE
    env.reset(options={"state": lattice.state(60, 8)})
    fast = env.render()
    env.reset(options={"state": lattice.state(60, 0)})
    slow = env.render()
    assert isinstance(fast, np.ndarray)
    assert isinstance(slow, np.ndarray)
    np.testing.assert_array_equal(fast[0, -1], slow[-1, -1])
    assert (fast[0, -1] != fast[-1, -1]).any()


def test_text_names_the_state() -> None:
    env = registration.ice_grid_env(["S.", "L#"], render_mode="ansi")
    env.reset(seed=0)
    assert env.render() == "state 0 (row 0, column 0)"
    silent = registration.ice_grid_env(["S.", "L#"])
    silent.reset(seed=0)
    assert silent.render() is None


def test_what_cannot_be_stepped_or_drawn_is_refused() -> None:
    bare = SafeMDP.deterministic(np.array([[0]]), np.array([False]))
    with pytest.raises(ValueError, match=r"the model has no initial states to start"):
        SafeMDPEnv(bare)
    started = SafeMDP.deterministic(np.array([[0]]), np.array([False]), initial=0)
    with pytest.raises(ValueError, match=r"the model has no geometry to draw"):
        SafeMDPEnv(started, render_mode="rgb_array")
    with pytest.raises(ValueError, match=r"unknown render mode 'human'; known are"):
        SafeMDPEnv(started, render_mode="human")
    for wrong in (1, -1, 0.5, float("nan"), "0"):
        with pytest.raises(ValueError, match=rf"reset: state {wrong!r} is not one of 0 to 0"):
            SafeMDPEnv(started).reset(options={"state": wrong})
        with pytest.raises(ValueError, match=rf"action {wrong!r} is not one of 0 to 0"):
            SafeMDPEnv(started).step(wrong)  # type: ignore[arg-type]  # what a caller may do wrong


def test_gymnasium_finds_the_module_by_itself() -> None:
    """The form module:id needs no import, in a fresh interpreter."""
    code = (
        "import gymnasium; "
        "print(gymnasium.make('dead_ends.envs.registration:dead_ends/Brake-v0').spec.id)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "dead_ends/Brake-v0"


def test_the_builders_do_not_need_gymnasium() -> None:
    code = (
        "import sys; sys.modules['gymnasium'] = None; "
        "import dead_ends, dead_ends.envs.brake, dead_ends.envs.gridworld; "
        "print(dead_ends.envs.brake.brake().num_actions)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "6"
