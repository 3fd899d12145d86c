"""Statements on a user's model: what holds, where it fails, and the command that prints it."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dead_ends import SafeMDP, classify, evaluate_policy, value_iteration
from dead_ends.__main__ import main
from dead_ends.io.npz import save_npz
from dead_ends.paper import Verification, predicates, verify_statements

HALF = Fraction(1, 2)


def rrl_model() -> SafeMDP:
    """P: {d2, q}; q: {fail, q}; d2 -> d1 -> fail. RRL enters d2 from P."""
    table = np.array([[2, 1], [4, 1], [3, 3], [4, 4], [-1, -1]])
    names = ["P", "q", "d2", "d1", "fail"]
    return SafeMDP.deterministic(table, np.arange(5) == 4, state_names=names)


def risky_model() -> SafeMDP:
    """0 at risk; 1: {p -> fail; stay}; 2 dead without a horizon; 3 goal; 4 fail."""
    P = np.full((5, 2, 5), Fraction(0), dtype=object)
    P[0, :, 3] = P[0, :, 4] = HALF
    P[1, 0, 4], P[1, 0, 1], P[1, 1, 1] = Fraction(1, 10), Fraction(9, 10), Fraction(1)
    P[2, :, 4] = P[2, :, 2] = HALF
    position = np.arange(5)
    return SafeMDP.stochastic(P, position == 4, terminal=position == 3)


def verdicts(found: Verification) -> dict[str, bool | None]:
    return {statement.place: statement.holds for statement in found.statements}


def test_deterministic_model() -> None:
    found = verify_statements(rrl_model())
    assert (found.labelling.horizon, found.labelling.boundary_horizon) == (2, 2)
    assert found.interval.upper == 0.99**2
    assert 0.99**3 < found.epsilon_safe < 0.99**2
    assert verdicts(found) == {
        "Definition 2, Eq. eq_ssafe": True,
        "Assumption 1": True,
        "Lemma 1, first bullet": False,
        "Lemma 1, second bullet": True,
        "Lemma 1, third bullet": True,
        "Remark after Definition 1": False,
        "Preliminary": False,
        "Theorem 1": True,
        "Theorem 2": True,
        "Abstract, Figure 1": True,
        "After Theorem 2": False,
    }
    rrl = found.statements[-1]
    assert rrl.detail == "fails at state 0 (P), action 0"


def test_a_good_task_policy_makes_rrl_safe() -> None:
    found = verify_statements(rrl_model(), policy=np.array([1, 1, 0, 0, 0]))
    assert verdicts(found)["After Theorem 2"] is True


def test_a_threshold_that_is_too_large_breaks_theorem_2() -> None:
    found = verdicts(verify_statements(rrl_model(), HALF, epsilon_safe=HALF))
    assert found["Theorem 2"] is False
    assert found["Abstract, Figure 1"] is False
    assert verdicts(verify_statements(rrl_model(), HALF, epsilon_safe=HALF**2))["Theorem 2"] is True


def test_stochastic_model() -> None:
    found = verify_statements(risky_model(), Fraction(9, 10), epsilon_safe=HALF)
    held = verdicts(found)
    assert held["Assumption 1"] is False
    assert held["Lemma 1, third bullet"] is False
    assert held["Theorem 2"] is False
    assert held["Abstract, Figure 1"] is False
    assert "Lemma 1, second bullet" not in held  # there is no H
    details = {statement.place: statement.detail for statement in found.statements}
    assert details["Assumption 1"] == "fails at state 2"
    assert details["Theorem 2"] == "fails at state 1, action 0"
    assert found.interval.upper == Fraction(1, 10)


def test_the_recommended_threshold_works_on_the_states_without_risk() -> None:
    held = verdicts(verify_statements(risky_model(), Fraction(9, 10)))
    assert held["Theorem 2"] is True
    assert held["Abstract, Figure 1"] is True


def test_a_late_dead_end_is_no_worse_than_a_risk() -> None:
    """V* of the risk is 1/2; that of the dead-end, gamma = 1/2, is (1/2) / (1 - 1/4) = 2/3."""
    by_place = {s.place: s for s in verify_statements(risky_model(), HALF).statements}
    separation = by_place["Lemma 1 and Theorem 2"]
    assert separation.holds
    assert separation.detail == ("V_c* is at most 0.5 on S_safe, at least 0.666667 on S_dead")
    slower = Fraction(1, 10)
    P = np.full((4, 1, 4), Fraction(0), dtype=object)
    P[0, 0, 2] = P[0, 0, 3] = HALF
    P[1, 0, 1], P[1, 0, 3] = 1 - slower, slower
    position = np.arange(4)
    model = SafeMDP.stochastic(P, position == 3, terminal=position == 2)
    by_place = {s.place: s for s in verify_statements(model, HALF).statements}
    assert by_place["Lemma 1 and Theorem 2"].holds is False


def test_what_floats_leave_open_is_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    """With eps in the middle of the bounds of Q, nothing can be said."""
    monkeypatch.setattr("dead_ends.paper.verification.EXACT_PAIRS", 0)
    P = np.zeros((3, 1, 3))
    P[0, 0] = [0.0, 0.1, 0.9]
    P[1, 0] = [0.9, 0.0, 0.1]
    model = SafeMDP.stochastic(P, np.arange(3) == 2)
    Q = value_iteration(model, 0.9).Q[0, 0]
    found = verify_statements(model, 0.9, epsilon_safe=float(Q))
    theorem_1 = next(s for s in found.statements if s.place == "Theorem 1")
    assert theorem_1.holds is None
    assert "it is not certain whether it is below" in theorem_1.detail


def test_a_wrong_threshold_is_refused() -> None:
    with pytest.raises(ValueError, match="epsilon_safe must be positive, not 0"):
        verify_statements(rrl_model(), epsilon_safe=0)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.npz"
    save_npz(rrl_model(), path)
    np.save(tmp_path / "policy.npy", np.array([1, 1, 0, 0, 0]))
    assert main(["statements", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "FAILS  After Theorem 2" in printed
    assert "fails at state 0 (P), action 0" in printed
    assert "0 < epsilon_safe <= gamma_safe**2 = 0.9801\n" in printed
    policy = ["--policy", str(tmp_path / "policy.npy"), "--epsilon-safe", "0.9"]
    assert main(["statements", str(path), *policy]) == 0
    printed = capsys.readouterr().out
    assert "holds  After Theorem 2" in printed
    assert "0.9\n" in printed


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"no array", "not a policy in .npy form"), (None, "policy.npy: No such file")],
)
def test_a_policy_that_cannot_be_read(
    content: bytes | None, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.npz"
    save_npz(rrl_model(), path)
    policy = tmp_path / "policy.npy"
    if content is not None:
        policy.write_bytes(content)
    assert main(["statements", str(path), "--policy", str(policy)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_archive_is_no_policy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.npz"
    save_npz(rrl_model(), path)
    assert main(["statements", str(path), "--policy", str(path)]) == 2
    assert "not a policy in .npy form: it holds several arrays" in capsys.readouterr().err


def test_predicates_name_the_place() -> None:
    model = rrl_model()
    labelling = classify(model)
    safe = labelling.safe
    leaving = predicates.leaves(model, safe)
    assert np.argwhere(leaving).tolist() == [[0, 0], [1, 0]]
    assert np.flatnonzero(predicates.policy_stays(model, safe, model.available)).tolist() == [0, 1]
    time = labelling.survival_time - labelling.dead
    assert np.argwhere(predicates.assumption_1(model, labelling.dead, time)).tolist() == [
        [3, 0],
        [3, 1],
    ]
    best = value_iteration(model, HALF)
    own = evaluate_policy(model, [0, 0, 0, 0, 0], HALF)
    assert not predicates.lemma_1_dead(own.V, best.V, labelling.dead, HALF).any()
    assert predicates.lemma_1_dead(own.V, best.V, labelling.dead, 1).tolist() == [
        False,
        False,
        True,
        False,
        False,
    ]


def test_definition_2_on_wrong_masks() -> None:
    """A dead state with a way out, and a safe state without one, are both named."""
    model = rrl_model()
    dead = np.array([True, False, False, False, False])
    safe = np.array([False, True, True, False, False])
    assert predicates.definition_2(model, dead, safe).tolist() == [True, False, True, False, False]


def test_below_power_decides_ties_and_huge_exponents() -> None:
    gamma = Fraction(9, 10)
    assert not predicates.below_power(gamma**7, gamma, Fraction(7))
    assert predicates.below_power(gamma**7 * (1 - Fraction(1, 10**50)), gamma, Fraction(7))
    assert not predicates.below_power(gamma**7 * (1 + Fraction(1, 10**50)), gamma, Fraction(7))
    assert predicates.below_power(Fraction(0), gamma, Fraction(1))
    huge = Fraction(10**12 + 1, 7)
    assert predicates.below_power(Fraction(1, 10**9) ** 9999, gamma, huge) == (
        Decimal(-9) * 9999 * Decimal(10).ln() < Decimal(10**12 + 1) / 7 * Decimal("0.9").ln()
    )
