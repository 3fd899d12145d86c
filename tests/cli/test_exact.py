"""``--exact``, what is said where floats do not decide, and what is said of estimates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dead_ends.__main__ import main
from dead_ends.cli.export import cut_off
from dead_ends.io import save_model
from dead_ends.io.estimation import estimate_model
from dead_ends.labels.classification import classify, safe_actions
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.filter_table import load_filter


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def slow_chain(n: int) -> SafeMDP:
    """From the middle n lucky flips in a row lead to fail (0) or to a goal (2 n)."""
    P = np.zeros((2 * n + 1, 1, 2 * n + 1))
    for s in range(1, 2 * n):
        outward = [s - 1, s + 1] if s == n else [s + int(np.sign(s - n)), n]
        P[s, 0, outward] = 0.5
    states = np.arange(2 * n + 1)
    return SafeMDP.stochastic(P, states == 0, terminal=states == 2 * n)


def long_corridor(horizon: int) -> SafeMDP:
    """State 0 may stay or enter a corridor that fails after so many steps."""
    states = np.arange(horizon + 2)
    after = np.minimum(states + 1, horizon + 1)
    return SafeMDP.deterministic(
        np.stack((after, np.where(states == 0, 0, after)), axis=1), states == horizon + 1
    )


def test_a_slow_chain_has_an_answer(capsys: pytest.CaptureFixture[str]) -> None:
    save_model(slow_chain(20), "chain.npz")
    export = ["export", "chain.npz", "--gamma-safe", "1", "--epsilon-safe", "0.4", "--out", "f.npz"]
    assert main(export) == 2
    err = capsys.readouterr().err
    assert err.endswith(": use --exact, or a --gamma-safe below 1\n")
    assert main([*export, "--exact"]) == 0
    table = load_filter("f.npz")
    # k steps before the goal it fails with probability (1 - 2**-k) / 2.
    assert np.flatnonzero(table.allowed[:, 0]).tolist() == [38, 39, 40]
    assert table.metadata["exact"] is True
    capsys.readouterr()
    save_model(slow_chain(30), "longer.npz")
    assert main(["explain", "longer.npz", "30"]) == 2
    assert capsys.readouterr().err.endswith("]: use --exact\n")
    assert main(["explain", "longer.npz", "30", "--exact"]) == 0
    assert "fails with probability 0.5, " in capsys.readouterr().out
    assert main(["statements", "longer.npz"]) == 0


def test_labels_are_told_even_if_the_threshold_is_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A slow chain that need not be entered: state 41 may stay, or go to its middle."""
    kernel = np.zeros((42, 2, 42))
    chain = slow_chain(20)
    kernel[:41, :, :41] = chain.transitions().toarray()[:, None]
    kernel[41, 0, 41] = kernel[41, 1, 20] = 1
    ends = np.arange(42)
    save_model(SafeMDP.stochastic(kernel, ends == 0, terminal=ends == 40), "entered.npz")
    label = ["label", "entered.npz", "--gamma-safe", "1"]
    assert main([*label, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["safe"], summary["at_risk"]) == (2, 39)
    assert summary["threshold"]["text"].startswith("not known: after 10000 sweeps")
    assert summary["threshold"]["text"].endswith("use --exact, or a --gamma-safe below 1")
    assert main([*label, "--exact"]) == 0
    assert "0 < epsilon_safe <= 1/2, for example 0.25\n" in capsys.readouterr().out


@pytest.mark.parametrize("exact", [[], ["--exact"]])
def test_no_false_equality_is_printed(capsys: pytest.CaptureFixture[str], exact: list[str]) -> None:
    save_model(long_corridor(1200), "long.npz")
    label = ["label", "long.npz", "--gamma-safe", "0.5", *exact]
    assert main(label) == 0
    text = "0 < epsilon_safe <= gamma_safe**1200, about 5.80771e-362, which is smaller than every "
    assert f"{text}float\n" in capsys.readouterr().out
    assert main([*label, "--json"]) == 0
    threshold = json.loads(capsys.readouterr().out)["threshold"]
    assert (threshold["at_most"], threshold["recommended"]) == (None, None)
    assert threshold["exponent"] == 1200
    assert main(["statements", "long.npz", "--gamma-safe", "0.5"]) == 2
    assert capsys.readouterr().err.endswith("which is smaller than every float: use --exact\n")
    assert main(["statements", "long.npz", "--gamma-safe", "0.5", "--exact"]) == 0
    out = capsys.readouterr().out
    assert "holds  Theorem 2" in out
    assert "gamma_safe^(H-1) is about 1.16154e-361" in out
    assert "epsilon_safe      5.80771e-362" in out


def test_exactly_decimals_are_what_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    save_model(long_corridor(2), "corridor.npz")
    assert main(["label", "corridor.npz", "--gamma-safe", "0.9", "--exact"]) == 0
    assert "gamma_safe**2 = 81/100, for example" in capsys.readouterr().out
    assert main(["label", "FrozenLake-v1", "--exact"]) == 2
    assert capsys.readouterr().err.endswith(
        "not exactly 1; normalise=True (--normalise) divides such probabilities by their sum "
        "(exactly, a float is its shortest decimal)\n"
    )
    assert main(["label", "FrozenLake-v1", "--exact", "--normalise"]) == 0


def test_an_estimate_is_called_one(capsys: pytest.CaptureFixture[str]) -> None:
    log = [(0, 0, 0), (0, 1, 1), (0, 1, 0)]
    save_model(estimate_model(2, 2, log, np.array([False, True]), initial=[0]), "log.npz")
    assert main(["label", "log.npz", "--out", "labels.json"]) == 0
    assert "an estimate from a log: its labels are no guarantee" in capsys.readouterr().out
    assert json.loads(Path("labels.json").read_text())["summary"]["estimate"] is True
    assert main(["explain", "log.npz", "0"]) == 0
    assert "This is said of an estimate from a log" in capsys.readouterr().out
    assert main(["statements", "log.npz"]) == 0
    assert "SafeMDP(stochastic, an estimate, " in capsys.readouterr().out
    assert main(["export", "log.npz", "--out", "filter.json"]) == 0
    assert "the filter is of an estimate from a log" in capsys.readouterr().err
    assert load_filter("filter.json").metadata["estimate"] is True
    assert main(["page", "log.npz", "--out", "page.html"]) == 0
    assert '"estimate":true' in Path("page.html").read_text()
    capsys.readouterr()
    assert main(["certify", "log.npz", "--out", "c.json"]) == 2
    refusal = (
        "a certificate would be no promise about the task: the model is an estimate from a log"
    )
    assert capsys.readouterr().err == f"dead-ends: {refusal}\n"
    assert not Path("c.json").exists()


def crossing(initial: list[int] | None, goal: bool = True) -> SafeMDP:
    """0 stays, or crosses to goal 2 past failure 3; 1 walks to the goal."""
    P = np.zeros((4, 2, 4))
    P[0, 0, 0] = P[1, 0, 1] = P[1, 1, 2] = P[2, :, 2] = 1
    P[0, 1, [2, 3]] = 0.9, 0.1
    ends = np.arange(4) == 2 if goal else None
    return SafeMDP.stochastic(P, np.arange(4) == 3, terminal=ends, initial=initial)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (crossing([0]), "no start reaches a goal behind this filter (state 0 could without it)"),
        (crossing([0, 1]), "behind this filter state 0 of 2 can no longer reach a goal"),
        (crossing([1]), ""),
        (crossing([2]), ""),
        (crossing(None), ""),
        (crossing([0], goal=False), ""),
    ],
)
def test_a_filter_that_cuts_starts_off_from_the_goal(
    capsys: pytest.CaptureFixture[str], model: SafeMDP, said: str
) -> None:
    save_model(model, "crossing.npz")
    assert main(["export", "crossing.npz", "--out", "filter.npz"]) == 0
    assert capsys.readouterr().err == (f"dead-ends: {said}\n" if said else "")
    assert main(["export", "crossing.npz", "--epsilon-safe", "0.2", "--out", "filter.npz"]) == 0
    assert capsys.readouterr().err == ""


def test_a_start_that_never_could_reach_a_goal_is_not_lamented() -> None:
    model = SafeMDP.deterministic(
        [[0, 2], [1, 1], [2, 2]],
        np.array([False, False, True]),
        terminal=np.array([False, True, False]),
        initial=[0],
    )
    stays = safe_actions(model, classify(model))
    assert cut_off(model, stays, np.zeros(3, dtype=np.int64)) == ""


def test_the_recovery_policy_may_lead_to_the_goal() -> None:
    """What is blocked is replaced: the way on may be the recovery action's."""
    model = crossing([0])
    nothing = np.zeros((4, 2), dtype=np.bool_)
    assert cut_off(model, nothing, np.array([1, 0, 0, 0])) == ""
    assert cut_off(model, nothing, np.array([0, 0, 0, 0])).startswith("no start reaches a goal")
