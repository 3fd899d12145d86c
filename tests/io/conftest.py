"""How round trips are judged."""

from collections.abc import Callable

import numpy as np
import pytest

from dead_ends.model.safe_mdp import SafeMDP


def assert_same_dynamics(first: SafeMDP, second: SafeMDP) -> None:
    """Equal transitions, probabilities, ends and names of actions."""
    assert first.is_deterministic == second.is_deterministic
    assert np.array_equal(first.available, second.available)
    ours, theirs = first.transitions(), second.transitions()
    for part in ("indptr", "indices", "data"):
        assert np.array_equal(getattr(ours, part), getattr(theirs, part)), part
    assert first.exact == second.exact
    assert np.array_equal(first.fail, second.fail)
    assert np.array_equal(first.terminal, second.terminal)
    assert first.state_names == second.state_names


@pytest.fixture(name="assert_same_dynamics")
def same_dynamics() -> Callable[[SafeMDP, SafeMDP], None]:
    return assert_same_dynamics
