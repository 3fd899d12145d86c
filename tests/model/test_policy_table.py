"""Policies as they are given: what counts as a policy that takes one action a state."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from dead_ends.model.policy_table import check_policy, single_actions
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.values.bellman import evaluate_policy


def stay_or_fail() -> SafeMDP:
    return SafeMDP.deterministic(np.array([[0, 1], [1, 1]]), np.array([False, True]))


def test_a_small_probability_beside_a_one_is_not_lost() -> None:
    """The row sums to 1 within the tolerance, and the policy fails in the end."""
    model = stay_or_fail()
    policy = np.array([[1.0, 1e-10], [0.0, 0.0]])
    assert single_actions(model, check_policy(model, policy)) is None
    values = evaluate_policy(model, policy, 0.5)
    # V = 1e-10 + V / 2
    assert 0 < values.V_lower[0] <= 2e-10 <= values.V_upper[0]


def test_rows_with_a_single_one_are_actions() -> None:
    model = stay_or_fail()
    for rows in ([[0.0, 1.0], [0.3, 0.3]], [[Fraction(0), Fraction(1)], [Fraction(0)] * 2]):
        actions = single_actions(model, check_policy(model, np.array(rows)))
        assert actions is not None
        assert actions[0] == 1
    assert single_actions(model, check_policy(model, [[0.5, 0.5], [0, 0]])) is None
