"""The benchmark of stand-offs: what it counts, with a policy and a filter made by hand."""

from __future__ import annotations

import itertools
from typing import cast

import numpy as np
import pytest

from benchmarks.stand_off import COPIES, STEPS, watched
from deep.data.normalisation import Normalisation
from deep.filter.safety_filter import SafetyFilter
from deep.filter.task_policy import TrainedPolicy
from deep.tasks import PointGoal1
from deep.tasks.bounds import Bounds
from deep.tasks.task import Floats


class Repeating:
    """Full thrust or full reverse, over and over in this order."""

    def __init__(self, thrusts: list[int]) -> None:
        self.thrusts = itertools.cycle(thrusts)

    def act(self, observation: Floats) -> Floats:
        """The same for every copy."""
        action = np.array([next(self.thrusts), 0.3], dtype=np.float32)
        return np.tile(action, (len(observation), 1))


def thrust_is_danger() -> SafetyFilter:
    """Q = sigmoid(2 a_0); the recovery action is a slow turn backwards."""
    o = PointGoal1.observation_dim
    weights = np.zeros((1, o + 2, 1), dtype=np.float32)
    weights[0, o] = 2.0
    recovery = np.arctanh(np.array([-0.5, -0.25, 0, 0], dtype=np.float32))
    return SafetyFilter(
        critic=((weights, np.zeros((1, 1, 1), dtype=np.float32)),),
        recovery=((np.zeros((o, 4), dtype=np.float32), recovery),),
        threshold=0.5,
        normalisation=Normalisation.identity(o, 2),
        actions=Bounds.unit(2),
        observations=Bounds.unit(o),
        reach=1.0,
        gamma_safe=0.99,
        method="by hand",
        seed=0,
    )


@pytest.mark.parametrize(
    ("thrusts", "alone"), [([1], 0.0), ([1, -1], 1.0), ([1, -1, -1], 1.0), ([1, 1, -1], 0.0)]
)
def test_taking_turns_is_told_from_correction_that_goes_on(
    thrusts: list[int], alone: float
) -> None:
    found = watched(cast(TrainedPolicy, Repeating(thrusts)), thrust_is_danger())
    arr = thrusts.count(1) / len(thrusts)
    assert STEPS % len(thrusts) == 0
    assert COPIES > 1
    assert found["arr"] == pytest.approx(arr)
    assert found["alone"] == alone
    assert (found["thrust"], found["turn"]) == pytest.approx((-0.5, 0.25), abs=1e-6)
    assert 0 < found["speed"] < 1.6
