"""Models estimated from logged transitions: what data and guesses make of the labels."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dead_ends.certificates.certificate import certify
from dead_ends.certificates.checker import CertificateError, check_certificate
from dead_ends.envs.brake import BrakeLattice, brake
from dead_ends.envs.safe_mdp_env import SafeMDPEnv
from dead_ends.io import load_model, save_model
from dead_ends.io.estimation import Unseen, estimate_model
from dead_ends.io.gymnasium_table import load_gymnasium
from dead_ends.io.networkx_graph import from_networkx, to_networkx
from dead_ends.labels.classification import classify
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.paper.methods import conservatism, rrl_msdp
from dead_ends.safety.correction import corrected_model
from dead_ends.safety.guarantees import episode_guarantee, expected_survival, one_step_risk
from dead_ends.values.bellman import value_iteration

F = Fraction

FAIL = np.array([False, False, False, True])
# 0 -> 1 or 2; 1 stays; 2 -> fail.
DATA = np.array([[0, 0, 1], [0, 1, 2], [1, 0, 1], [2, 0, 3], [0, 0, 1]])


def log_of(model: SafeMDP) -> NDArray[np.int64]:
    """Every transition of a deterministic model once."""
    table = model.successors()
    return np.array([(s, a, table[s, a]) for s, a in np.argwhere(table >= 0)])


def test_what_was_tried_is_known_and_the_rest_is_guessed() -> None:
    pessimistic = estimate_model(4, 2, DATA, FAIL, deterministic=True)
    assert pessimistic.is_deterministic
    assert pessimistic.successors().tolist() == [[1, 2], [1, 3], [3, 3], [-1, -1]]
    optimistic = estimate_model(4, 2, DATA, FAIL, Unseen.OPTIMISTIC, deterministic=True)
    assert optimistic.successors().tolist() == [[1, 2], [1, 1], [3, 2], [-1, -1]]
    # State 2 is dead in truth, if its other action leads to failure too: the optimist errs.
    assert classify(pessimistic).safe.tolist() == [True, True, False, False]
    assert classify(optimistic).safe.tolist() == [True, True, True, False]


def test_without_data_everything_is_guessed() -> None:
    for none in (np.zeros((0, 3), dtype=np.int64), []):
        assert classify(estimate_model(4, 2, none, FAIL)).dead.tolist() == [True] * 3 + [False]
        optimistic = estimate_model(4, 2, none, FAIL, "optimistic", rewards=[])
        assert classify(optimistic).safe.tolist() == [True] * 3 + [False]
        assert optimistic.rewards is not None
        assert not optimistic.rewards.any()


def test_actions_that_do_not_exist_are_not_guessed() -> None:
    available = np.array([[True, True], [True, False], [True, False], [False, False]])
    for unseen in Unseen:
        model = estimate_model(4, 2, DATA, FAIL, unseen, deterministic=True, available=available)
        assert model.successors().tolist() == [[1, 2], [1, -1], [3, -1], [-1, -1]]


def test_an_end_that_is_no_failure_is_a_goal() -> None:
    data = np.array([[0, 0, 1], [0, 1, 3], [2, 0, 2]])
    ended = np.array([True, True, False])
    for deterministic in (True, False):
        model = estimate_model(4, 2, data, FAIL, terminated=ended, deterministic=deterministic)
        assert model.terminal.tolist() == [False, True, False, False]
        assert classify(model).safe.tolist() == [True, True, True, False]


def test_frequencies_are_exact() -> None:
    data = np.array([[0, 0, 1]] * 2 + [[0, 0, 3]] + [[0, 1, 0]] + [[1, 1, 2]] * 7)
    ended = data[:, 2] == 2
    model = estimate_model(4, 2, data, FAIL, deterministic=False, terminated=ended)
    P = model.transitions().toarray().reshape(4, 2, 4)
    assert P[0, 0].tolist() == [0, 2 / 3, 0, 1 / 3]
    assert P[0, 1].tolist() == [1, 0, 0, 0]
    assert P[1, 0].tolist() == [0, 0, 0, 1]  # never tried
    assert P[1, 1].tolist() == P[2, 0].tolist() == P[2, 1].tolist() == [0, 0, 1, 0]
    assert model.exact == (F(2, 3), F(1, 3), F(1), F(1), F(1), F(1), F(1))
    assert model.exact_probabilities() is model.exact
    assert [float(p) for p in model.exact] == model.transitions().data.tolist()
    optimistic = estimate_model(
        4, 2, data, FAIL, "optimistic", deterministic=False, terminated=ended
    )
    assert optimistic.transitions().toarray().reshape(4, 2, 4)[1, 0].tolist() == [0, 1, 0, 0]


def test_rewards_are_averaged_and_guessed() -> None:
    rewards = [1.0, 5.0, -2.0, 0.0, 2.0]
    for unseen, guess in ((Unseen.PESSIMISTIC, -2.0), (Unseen.OPTIMISTIC, 5.0)):
        model = estimate_model(4, 2, DATA, FAIL, unseen, rewards=rewards, initial=[0])
        assert model.rewards is not None
        assert model.rewards.tolist() == [[1.5, 5.0], [-2.0, guess], [0.0, guess], [0.0, 0.0]]
        assert model.initial is not None
        assert model.initial.tolist() == [1, 0, 0, 0]


def slippery_brake(cells: int, slide: float) -> SafeMDP:
    """A car that can brake or coast on a slope: its brakes let it slide on now and then."""
    P = np.zeros((cells + 1, 2, cells + 1))
    for s in range(cells):
        P[s, 0, s], P[s, 0, s + 1] = 1 - slide, slide
        P[s, 1, s + 1] = 1
    return SafeMDP.stochastic(P, np.arange(cells + 1) == cells)


def sampled(model: SafeMDP, times: int, seed: int) -> NDArray[np.int64]:
    """Each pair tried so many times."""
    rng = np.random.default_rng(seed)
    P = model.transitions().toarray().reshape((*model.available.shape, -1))
    pairs = np.argwhere(model.available)
    tries = [(s, a, t) for s, a in pairs for t in rng.choice(len(P), times, p=P[s, a])]
    return np.array(tries)


def test_twenty_samples_a_pair_promise_nothing() -> None:
    """Brakes that slide in a tenth of the steps: in some cells twenty tries did not show it."""
    task = slippery_brake(8, 0.1)
    estimate = estimate_model(9, 2, sampled(task, 20, seed=1), task.fail)
    assert estimate.estimate
    wrong = classify(estimate).safe & ~classify(task).safe
    assert wrong.sum() == 7
    last = int(np.flatnonzero(wrong)[-1])
    # What it would promise, were it the task: no failure in 100 steps.
    believed = replace(estimate, estimate=False)
    promised = episode_guarantee(value_iteration(believed, 1.0), 0.001, last).probability(100)
    assert promised > 0.9
    alive = (~task.fail).astype(float)
    for _ in range(100):
        alive = np.where(task.fail, 0.0, (task.transitions() @ alive).reshape(-1, 2).max(axis=1))
    assert alive[last] < 0.0004
    refused = "would be no promise about the task: the model is an estimate from a log"
    values = value_iteration(estimate, 1.0)
    with pytest.raises(ValueError, match=f"^a guarantee {refused}$"):
        episode_guarantee(values, 0.001, last)
    with pytest.raises(ValueError, match=f"^a bound of the risk {refused}$"):
        one_step_risk(values, expected_survival(estimate))
    with pytest.raises(ValueError, match=f"^a certificate {refused}$"):
        certify(estimate)
    with pytest.raises(CertificateError, match="^the model is an estimate from a log, so its"):
        check_certificate(estimate, certify(believed))


def test_the_mark_survives(tmp_path: Path) -> None:
    estimate = estimate_model(4, 2, DATA, FAIL, initial=[0])
    save_model(estimate, tmp_path / "model.npz")
    assert load_model(tmp_path / "model.npz").estimate
    assert from_networkx(to_networkx(estimate)).estimate
    assert corrected_model(estimate, value_iteration(estimate, 0.9), 0.5).estimate
    assert "an estimate" in repr(estimate)
    asserted = estimate_model(4, 2, DATA, FAIL, deterministic=True)
    save_model(asserted, tmp_path / "model.npz")
    assert not load_model(tmp_path / "model.npz").estimate
    assert not from_networkx(to_networkx(asserted)).estimate


@pytest.mark.parametrize("suffix", [".drn", ".tra"])
def test_formats_that_cannot_say_it_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"model{suffix}"
    message = f"^{path}: the format cannot say that the model is an estimate from a log; write .npz"
    with pytest.raises(ValueError, match=message):
        save_model(estimate_model(4, 2, DATA, FAIL), path)
    assert not list(tmp_path.iterdir())


def test_only_what_is_asserted_and_not_hoped_is_no_estimate() -> None:
    """Even one successor a pair: what was seen once may be one of many outcomes."""
    assert estimate_model(4, 2, DATA, FAIL).estimate
    assert not estimate_model(4, 2, DATA, FAIL, deterministic=True).estimate
    assert estimate_model(4, 2, DATA, FAIL, "optimistic", deterministic=True).estimate
    complete = [*DATA, (1, 1, 1), (2, 1, 2)]
    assert not estimate_model(4, 2, complete, FAIL, "optimistic", deterministic=True).estimate


@st.composite
def models_with_nested_data(draw: st.DrawFn) -> tuple[SafeMDP, list[NDArray[np.int64]]]:
    """A deterministic model and two growing parts of its log."""
    n, m = draw(st.integers(2, 6)), draw(st.integers(1, 3))
    rows = st.lists(st.integers(0, n - 1), min_size=m, max_size=m)
    table = np.array(draw(st.lists(rows, min_size=n, max_size=n)), dtype=np.int32)
    model = SafeMDP.deterministic(table, np.arange(n) >= draw(st.integers(1, n - 1)))
    log = log_of(model)
    order = np.array(draw(st.permutations(range(len(log)))))
    sizes = sorted(draw(st.tuples(*[st.integers(0, len(log))] * 2)))
    return model, [log[order[:size]] for size in sizes]


@settings(deadline=None)  # the first labelling compiles
@given(models_with_nested_data())
def test_the_pessimist_is_never_wrong_and_learns(
    case: tuple[SafeMDP, list[NDArray[np.int64]]],
) -> None:
    model, parts = case
    truth = classify(model).safe
    shape = (model.num_states, model.num_actions)
    some, more = (
        classify(estimate_model(*shape, part, model.fail, deterministic=True)).safe
        for part in parts
    )
    assert not (some & ~more).any()
    assert not (more & ~truth).any()
    hopes = [
        classify(estimate_model(*shape, part, model.fail, "optimistic", deterministic=True)).safe
        for part in parts
    ]
    assert not (hopes[1] & ~hopes[0]).any()
    assert not (truth & ~hopes[1]).any()
    for unseen in Unseen:
        complete = estimate_model(*shape, log_of(model), model.fail, unseen, deterministic=True)
        assert np.array_equal(complete.successors(), model.successors())


def test_conservatism_shrinks_as_coverage_grows_on_the_brake() -> None:
    """Pessimists block what they do not know; optimists let the dead-ends through."""
    model = brake(BrakeLattice(max_distance=60, max_speed=8, max_braking=2, max_acceleration=2))
    log = np.random.default_rng(0).permutation(log_of(model))
    blocked, missed = [], []
    for share in (0.25, 0.5, 0.75, 1.0):
        data = log[: int(share * len(log))]
        for unseen, counts in ((Unseen.PESSIMISTIC, blocked), (Unseen.OPTIMISTIC, missed)):
            estimate = estimate_model(
                *model.available.shape, data, model.fail, unseen, deterministic=True
            )
            result = conservatism(model, rrl_msdp(estimate).critic, 0.99**3.5)
            counts.append(result)
    shares = [each.blocked_safe_actions_share for each in blocked]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.5
    assert shares[-1] == 0
    assert [each.missed_unsafe_actions for each in blocked] == [0] * 4
    lets_through = [each.missed_unsafe_actions for each in missed]
    assert lets_through == sorted(lets_through, reverse=True)
    assert lets_through[0] > 0
    assert lets_through[-1] == 0
    assert [each.blocked_safe_actions for each in missed] == [0] * 4


def test_where_frequencies_hide_a_risk_the_pessimist_errs_too() -> None:
    fail = np.array([False, True])
    data = [[0, 0, 0]] * 5  # in truth it fails now and then
    model = estimate_model(2, 1, data, fail, deterministic=False)
    assert classify(model).safe.tolist() == [True, False]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"transitions": [[0, 0, 1], [0, 0, 2]], "deterministic": True},
            r"state 0, action 0 leads to state 1 \(transition 0\) and to state 2, so the task is "
            r"not deterministic; leave out deterministic=True",
        ),
        ({"transitions": [[0, 0, 1], [4, 0, 1]]}, r"transition 1: state 4 is not one of 0 to 3"),
        ({"transitions": [[0, 2, 1]]}, r"transition 0: action 2 is not one of 0 to 1"),
        ({"transitions": [[0, 0, -1]]}, r"transition 0: successor -1 is not one of 0 to 3"),
        (
            {"transitions": [[0, 0, 1], [3, 0, 1]]},
            r"transition 1: starts in fail state 3, where the episode has ended",
        ),
        (
            {"transitions": [[0, 0, 1], [1, 0, 1]], "terminated": np.array([True, False])},
            r"transition 1: starts in terminal state 1, where the episode has ended",
        ),
        (
            {"available": np.array([[False, True]] * 4)},
            r"transition 0: action 0 is not available in state 0",
        ),
        (
            {"transitions": [[0.0, 0.0, 1.0]]},
            r"transitions must be integers of shape \(N, 3\), a row \(s, a, s'\) each, not "
            r"float64 of shape \(1, 3\)",
        ),
        ({"transitions": [[0, 0]]}, r"transitions must be integers of shape \(N, 3\).*"),
        ({"rewards": [1.0]}, r"rewards must have shape \(5,\), not \(1,\)"),
        ({"rewards": [1.0, math.nan, 0, 0, 0]}, r"transition 1: reward nan is not finite"),
        (
            {"terminated": np.array([1, 0, 0, 0, 0])},
            r"terminated must be a boolean mask of shape \(5,\), not int64 of shape \(5,\)",
        ),
        ({"fail": FAIL[:2]}, r"fail must be a boolean mask of shape \(4,\), not bool of .*"),
        (
            {"fail": np.zeros(4, dtype=np.bool_)},
            r"state 1, action 1 was never tried, and no state is marked in `fail` for it to "
            r"lead to; add a fail state, or take unseen actions optimistically",
        ),
        ({"num_states": 0}, r"a model needs at least one state and one action, not 0 and 2"),
        ({"unseen": "hopeful"}, r"'hopeful' is not a valid Unseen"),
    ],
)
def test_bad_logs_are_named(changes: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {
        "num_states": 4,
        "num_actions": 2,
        "transitions": DATA,
        "fail": FAIL,
        **changes,
    }
    with pytest.raises(ValueError, match=f"^{message}$"):
        estimate_model(**arguments)


def test_no_fail_state_is_needed_where_nothing_is_guessed() -> None:
    data = np.array([[0, 0, 0], [0, 1, 0]])
    model = estimate_model(1, 2, data, np.array([False]))
    assert classify(model).safe.tolist() == [True]


def test_the_mark_survives_being_stepped() -> None:
    """The environment of an estimate, read as a table with other failures."""
    env = SafeMDPEnv(estimate_model(4, 2, DATA, FAIL, initial=[0]))
    assert load_gymnasium(env).estimate
    assert load_gymnasium(env, fail_states=[2]).estimate


@pytest.mark.parametrize("name", ["transitions", "fail", "rewards", "terminated"])
def test_nothing_may_be_masked(name: str) -> None:
    """What is masked is not known; read as if it were, it would be a transition."""
    log: dict[str, Any] = {
        "transitions": np.array([[0, 0, 1], [0, 1, 0]]),
        "fail": np.array([False, True]),
        "rewards": np.zeros(2),
        "terminated": np.zeros(2, dtype=bool),
    }
    mask = np.zeros(log[name].shape, dtype=bool)
    mask[1] = True
    log[name] = np.ma.array(log[name], mask=mask)
    with pytest.raises(ValueError, match=rf"^{name}\[1(, 0)?\] is masked"):
        estimate_model(2, 2, **log)
