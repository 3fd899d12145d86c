"""Bridge: its fall is a clean case of Assumption 1, with H = 3."""

from fractions import Fraction

import numpy as np
import pytest

from dead_ends import classify, value_iteration
from dead_ends.envs.bridge import ACTIONS, bridge
from dead_ends.labels.labelling import INFINITE


@pytest.mark.parametrize("length", [2, 5, 7, 9, 11])
def test_a_fall_lasts_at_most_three_steps(length: int) -> None:
    model = bridge(length)
    labelling = classify(model)
    assert model.num_states == length + 4
    assert labelling.horizon == 3
    assert labelling.boundary_horizon == 3
    np.testing.assert_array_equal(labelling.survival_time, [INFINITE] * length + [3, 2, 1, 0])
    np.testing.assert_array_equal(np.flatnonzero(model.terminal), [length - 1])
    assert labelling.safe[:length].all()  # walking back is safe for ever


def test_transitions_of_the_first_cells() -> None:
    model = bridge(5)
    assert model.action_names == ACTIONS
    kernel, exact = model.transitions(), model.exact_probabilities()

    def row(state: int, action: int) -> dict[int, Fraction]:
        entries = range(*kernel.indptr[3 * state + action : 3 * state + action + 2])
        return {int(kernel.indices[entry]): exact[entry] for entry in entries}

    half, fall = Fraction(1, 2), Fraction(1, 200)
    assert row(0, 0) == {1: Fraction(99, 100), 5: fall, 6: fall}
    assert row(0, 1) == {0: 1}
    assert row(2, 1) == {1: 1}
    assert row(2, 2) == {5: half, 6: half}
    assert all(row(5, action) == {6: 1} for action in range(3))
    assert all(row(7, action) == {8: 1} for action in range(3))


def test_values_have_the_closed_form() -> None:
    """Falling: gamma^(k - 1); jumping: (gamma^3 + gamma^2) / 2; walking back: 0."""
    gamma = Fraction(9, 10)
    values = value_iteration(bridge(7), gamma)
    np.testing.assert_array_equal(values.V, [0] * 7 + [gamma**2, gamma, 1, 0])
    jump = (gamma**3 + gamma**2) / 2
    np.testing.assert_array_equal(values.Q[:6], [[jump / 100, 0, jump]] * 6)


def test_rewards() -> None:
    model = bridge(5)
    assert model.rewards is not None
    np.testing.assert_array_equal(model.rewards[3], [99.0, 0, 0])
    np.testing.assert_array_equal(model.rewards[7], [-1.0] * 3)
    np.testing.assert_array_equal(model.rewards[[0, 1, 2, 4, 5, 6, 8]], 0)


@pytest.mark.parametrize(
    ("length", "fall", "message"),
    [
        (1, 0.01, r"length must be at least 2, not 1"),
        (9, 1.01, r"fall_probability must lie in 0 to 1, not 1\.01"),
    ],
)
def test_bad_parameters_are_refused(length: int, fall: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        bridge(length, fall)
