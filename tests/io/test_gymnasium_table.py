"""The installed Gymnasium's tables: their rules are the oracle."""

import sys
import threading
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

from dead_ends.io import load_model
from dead_ends.io.environment_model import EnvironmentModel
from dead_ends.io.errors import MissingDependencyError
from dead_ends.io.gymnasium_table import load_gymnasium
from dead_ends.labels.classification import classify

HOLES = [5, 7, 11, 12]


@pytest.mark.parametrize("slippery", [False, True])
@pytest.mark.parametrize("map_name", ["4x4", "8x8"])
def test_frozen_lake_has_no_dead_ends(slippery: bool, map_name: str) -> None:
    arguments = {"is_slippery": slippery, "map_name": map_name}
    model = load_gymnasium("FrozenLake-v1", arguments=arguments)
    labelling = classify(model)
    assert not labelling.dead.any()
    assert not labelling.safe.all()
    assert labelling.horizon == 0
    assert model.is_deterministic is not slippery
    assert model.terminal.tolist() == [False] * (model.num_states - 1) + [True]
    if map_name == "4x4":
        assert np.flatnonzero(model.fail).tolist() == HOLES


def test_frozen_lake_slippery_safe_states_by_brute_force() -> None:
    """The greatest set in which some action surely stays, from Gymnasium's own table."""
    env = gymnasium.make("FrozenLake-v1")
    P: Any = env.unwrapped.P
    safe = set(range(16)) - set(HOLES)
    while kept := {s for s in safe if any(all(t[1] in safe for t in P[s][a]) for a in range(4))}:
        if kept == safe:
            break
        safe = kept
    labelling = classify(load_gymnasium(env))
    assert set(np.flatnonzero(labelling.safe).tolist()) == safe
    assert labelling.at_risk.sum() == 12 - len(safe)


def test_frozen_lake_agrees_with_its_own_table() -> None:
    env = gymnasium.make("FrozenLake-v1")
    model = load_gymnasium(env)
    P: Any = env.unwrapped.P
    kernel = model.transitions().toarray().reshape(16, 4, 16)
    for state in set(range(16)) - set(HOLES) - {15}:
        for action in range(4):
            row = np.zeros(16)
            for probability, successor, _, _ in P[state][action]:
                row[successor] += probability
            assert np.array_equal(kernel[state, action], row)
    assert model.rewards is not None
    assert model.rewards[14, 2] == pytest.approx(1 / 3)
    assert model.initial is not None
    assert model.initial.tolist() == [1.0] + [0.0] * 15
    assert model.action_names == ("left", "down", "right", "up")
    assert model.state_names is not None
    assert model.state_names[7] == "row 1, column 3"
    assert model.geometry is not None
    assert model.geometry.cell[7].tolist() == [3, 1]


@pytest.mark.parametrize("name", ["CliffWalking-v1", "CliffWalkingSlippery-v1"])
def test_cliff_walking_has_no_dead_ends(name: str) -> None:
    model = load_gymnasium(name)
    labelling = classify(model)
    assert model.num_states == 49
    assert np.flatnonzero(model.fail).tolist() == [48]
    assert not labelling.dead.any()
    assert np.flatnonzero(model.terminal).tolist() == [47]
    # The cliff's cells are states of the table though no episode enters them; who starts there
    # walks off safely, but for a slip to the side.
    cliff = np.arange(37, 47)
    assert np.flatnonzero(labelling.at_risk).tolist() == (
        [] if model.is_deterministic else cliff.tolist()
    )


def test_cliff_walking_violations_are_the_cliffs_edge() -> None:
    model = load_gymnasium("CliffWalking-v1")
    assert model.next_state is not None
    entering = np.argwhere(model.successors() == 48).tolist()
    # Down from the row above the cliff, right from the start, and within the cliff itself.
    above = [[state, 2] for state in range(25, 35)]
    assert [pair for pair in entering if pair[0] < 36] == above
    assert [36, 1] in entering
    assert {state for state, _ in entering} == {*range(25, 35), *range(36, 48)} - {47}
    assert load_gymnasium("CliffWalking-v1", fail_if=lambda *row: row[2] == -100).fail[48]


def test_taxi_loads() -> None:
    """Its goals lie on the way of other trips: the episode ends in a state of its own."""
    model = load_gymnasium("Taxi-v4", fail_if="r <= -10")
    assert model.num_states == 502
    assert np.flatnonzero(model.fail).tolist() == [500]
    assert np.flatnonzero(model.terminal).tolist() == [501]
    assert model.action_names is not None
    assert model.action_names[5] == "drop off"
    assert not classify(model).dead.any()


def test_fail_states_replace_the_rules() -> None:
    model = load_gymnasium("FrozenLake-v1", fail_states=[5])
    assert np.flatnonzero(model.fail).tolist() == [5]
    assert set(np.flatnonzero(model.terminal).tolist()) == {7, 11, 12, 15}
    mask = np.arange(16) == 7
    assert np.array_equal(load_gymnasium("FrozenLake-v1", fail_states=mask).fail, mask)
    both = load_gymnasium("FrozenLake-v1", fail_states=[5], fail_if="s2 == 7")
    assert np.flatnonzero(both.fail).tolist() == [5, 16]


def environment(P: Any, **more: Any) -> Any:
    return SimpleNamespace(unwrapped=SimpleNamespace(P=P, **more))


def test_any_object_with_a_table() -> None:
    model = load_gymnasium(
        environment([[[(1.0, 1, 0.0, False)]], {0: [(1.0, 1, 0, True)], 2: [(1.0, 0, 0, False)]}]),
        fail_states=[0],
    )
    assert model.successors().tolist() == [[-1, -1, -1], [2, -1, 0], [2, 2, 2]]


@pytest.mark.filterwarnings("ignore::dead_ends.io.NoFailureWarning")  # none fails, as we say
@pytest.mark.parametrize(
    ("P", "message"),
    [
        ({}, "the transition table P is empty"),
        ({1: {0: [(1.0, 0, 0, False)]}}, "the keys of P must be 0 to 0"),
        ({0: {-1: [(1.0, 0, 0, False)]}}, "state 0: P lists action -1, but actions are 0 and more"),
        ({0: {"go": []}}, r"state 0: the keys of P\[0\] must be numbers of actions"),
        ({0: {0: [(0.9, 0, 0, False)]}}, "state 0, action 0: probabilities sum to 0.9, not 1"),
        ({0: {0: [(1.0, 3, 0, False)]}}, "state 0, action 0: successor 3 does not exist"),
    ],
)
def test_bad_tables(P: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_gymnasium(environment(P), fail_states=[])


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("FrozenLake-v99", {}, "FrozenLake-v99: .*"),
        ("NoSuchLake-v1", {}, "NoSuchLake-v1: .*doesn't exist"),
        ("nosuch:Lake-v1", {}, "nosuch:Lake-v1: "),
        ("FrozenLake-v1", {"arguments": {"colour": "red"}}, "FrozenLake-v1: .*colour"),
        ("CartPole-v1", {}, "CartPole-v1: the environment has no transition table P"),
        ("Taxi-v4", {}, "Taxi-v4: which states fail is not known"),
        ("FrozenLake-v1", {"fail_if": "x"}, "FrozenLake-v1: condition 'x': unknown name"),
        ("FrozenLake-v1", {"fail_states": [16]}, "FrozenLake-v1: fail states: 16 is not"),
    ],
)
def test_what_is_wrong_is_said(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_gymnasium(name, **options)


@pytest.mark.parametrize("probability", [0.3, 0.1])
def test_a_fickle_passenger_is_noticed(probability: float) -> None:
    """He changes the destination, and Taxi's table knows nothing of it."""
    arguments = {"fickle_passenger": True, "fickle_probability": probability}
    with pytest.raises(
        ValueError, match=r"Taxi-v4: state \d+, action \d: a step leads to state \d+ "
    ):
        load_gymnasium("Taxi-v4", fail_states=[], arguments=arguments)


def test_what_a_table_includes_is_no_contradiction() -> None:
    """However rare it is; and the environment, with its generators, stays as it was."""
    for arguments in ({"is_rainy": True}, {"is_rainy": True, "rainy_probability": 0.999}):
        assert load_gymnasium("Taxi-v4", fail_states=[0], arguments=arguments).num_states == 501
    env = gymnasium.make("Taxi-v4", is_rainy=True)
    env.reset(seed=0)
    before = np.random.get_state()[1].tolist()  # type: ignore[index, union-attr]  # noqa: NPY002
    numbers, state = env.np_random.bit_generator.state, env.unwrapped.s  # type: ignore[attr-defined]
    load_gymnasium(env, fail_states=[0])
    assert env.np_random.bit_generator.state == numbers
    assert env.unwrapped.s == state  # type: ignore[attr-defined]
    assert np.random.get_state()[1].tolist() == before  # type: ignore[index, union-attr]  # noqa: NPY002


class Claims(gymnasium.Env[int, int]):
    """Action 1 stays in 0 or 1, action 2 goes to the other; from 1 to 2, the end, now and then."""

    action_space = gymnasium.spaces.Discrete(2, start=1)
    observation_space = gymnasium.spaces.Discrete(3)

    def __init__(self, P: Any) -> None:
        self.P = P

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.s = 0
        return self.s, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        assert action in (1, 2)
        if action == 2:
            self.s = 2 if self.s == 1 and self.np_random.random() < 0.05 else 1 - self.s
        return self.s, -1.0, self.s == 2, False, {}


def claimed(**others: Any) -> dict[int, Any]:
    """What is true of the environment, but for the outcomes of action 2 in state 1."""
    ends = [(0.05, 2, -1.0, True)]
    fickle = others.get("fickle", [(0.95, 0, -1.0, False), *ends])
    end = {1: [(1.0, 2, 0.0, True)]}
    stay = [[(1.0, s, -1.0, False)] for s in range(2)]
    return {0: {1: stay[0], 2: [(1.0, 1, -1.0, False)]}, 1: {1: stay[1], 2: fickle}, 2: end}


def test_a_true_table_with_actions_from_1() -> None:
    model = load_gymnasium(Claims(claimed()), fail_if="a == 2 and s2 == 2")
    rows = model.transitions().toarray()[[1, 3], :4]
    assert rows.tolist() == [[0, 1, 0, 0], [0.95, 0, 0, 0.05]]
    assert np.flatnonzero(model.fail).tolist() == [3]
    assert model.action_names == ("1", "2")
    listed = [list(row.values()) for row in claimed().values()]
    assert load_gymnasium(Claims(listed), fail_states=[2]).num_actions == 2


@pytest.mark.parametrize(
    ("fickle", "message"),
    [
        (
            [(1.0, 0, -1.0, False)],
            r"state 1, action 2: a step leads to state 2 with reward -1, where",
        ),
        (
            [(0.95, 0, -1.0, False), (0.05, 2, -1.0, False)],
            "to state 2 with reward -1, where the ep",
        ),
        (
            [(0.95, 0, -1.0, True), (0.05, 2, -1.0, True)],
            "to state 0 with reward -1 and the table P",
        ),
        (
            [(0.95, 0, -1.0, False), (0.05, 2, -2.0, True)],
            "to state 2 with reward -1, where the ep",
        ),
        (
            [(1.0, 0, -1.0, False), (0.0, 2, -1.0, True)],
            "to state 2 with reward -1, where the epis",
        ),
    ],
)
def test_a_false_table_is_refused(fickle: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_gymnasium(Claims(claimed(fickle=fickle)), fail_states=[2])


def test_environments_that_show_pictures_or_cannot_be_copied() -> None:
    env = gymnasium.make("CliffWalking-v1", render_mode="human")
    assert load_gymnasium(env).num_states == 49  # and no window is opened
    assert (env.render_mode, env.unwrapped.window_surface) == ("human", None)  # type: ignore[attr-defined]
    env.unwrapped.lock = threading.Lock()  # type: ignore[attr-defined]
    with pytest.raises(
        ValueError, match="CliffWalking-v1: the environment cannot be copied: cannot"
    ):
        load_gymnasium(env)


def test_actions_and_starts_that_the_environment_does_not_have() -> None:
    table = claimed() | {0: {0: [(1.0, 0, -1.0, False)]}}
    with pytest.raises(ValueError, match="state 0: P lists action 0, but actions are 1 to 2"):
        load_gymnasium(Claims(table), fail_states=[2])
    env = Claims(claimed())
    env.initial_state_distrib = [0.0, 1.0, 0.0]  # type: ignore[attr-defined]
    with pytest.raises(
        ValueError, match="an episode starts in state 0, which has probability 0 of"
    ):
        load_gymnasium(env, fail_states=[2])
    env.action_space = gymnasium.spaces.MultiDiscrete([2])  # type: ignore[assignment]
    with pytest.raises(ValueError, match=r"actions must be Discrete, not MultiDiscrete\(\[2\]\)"):
        load_gymnasium(env, fail_states=[2])


def test_a_map_that_is_drawn_each_time() -> None:
    """The model would be that of an environment which nobody gets again."""
    with pytest.raises(ValueError, match="FrozenLake-v1: the table P is another each time the env"):
        load_model("FrozenLake-v1", arguments={"map_name": None})
    env = gymnasium.make("FrozenLake-v1", map_name=None)
    assert load_model(env).num_states == 64


def test_which_observation_is_which_state() -> None:
    model = load_gymnasium("CliffWalking-v1")
    assert isinstance(model, EnvironmentModel)
    assert model.keys == tuple(range(48))
    assert model.state_of(np.int64(47)) == 47


def test_without_gymnasium(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(MissingDependencyError, match=r"gymnasium: pip install 'dead-ends\[gym\]'"):
        load_gymnasium("FrozenLake-v1")
