"""Powers, means and scales of offline data, on columns whose moments are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from deep.data import normalisation as module
from deep.data.normalisation import (
    Normalisation,
    TensorNormalisation,
    centre_and_scale,
    normalisation_of,
    normalisation_of_observations,
    normalise,
)
from deep.data.transitions import Transitions


def column(*values: float) -> NDArray[np.float32]:
    return np.array(values, dtype=np.float32)[:, None]


def transitions(observations: NDArray[np.float32], actions: NDArray[np.float32]) -> Transitions:
    """One episode with a violation at its end; each observation follows the one before it."""
    n = len(observations)
    last = np.arange(n) == n - 1
    return Transitions(
        observations=observations,
        actions=actions,
        next_observations=np.roll(observations, -1, axis=0),
        rewards=np.arange(n),
        costs=last,
        terminals=last,
        timeouts=np.zeros(n),
    )


def test_mean_and_standard_deviation_of_each_coordinate() -> None:
    x = np.concatenate((column(1, 5, 1, 5), column(-2, -2, -2, 10)), axis=1)
    centre, scale = centre_and_scale(x)
    assert centre == (3.0, 1.0)
    assert scale == pytest.approx((2.0, np.sqrt(27)))


def test_more_rows_than_are_read_at_once() -> None:
    """In float64: squares of float32 around a mean of 1000 would lose their last digits."""
    rng = np.random.default_rng(1)
    for n in (1, module.ROWS, module.ROWS + 1, 2 * module.ROWS + 5):
        x = (1000 + rng.normal(size=(n, 2))).astype(np.float32)
        centre, scale = centre_and_scale(x)
        assert centre == pytest.approx(x.astype(np.float64).mean(axis=0), rel=1e-12)
        expected = x.astype(np.float64).std(axis=0) if n > 1 else (1, 1)
        assert scale == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("mean", "deviation", "constant"),
    [
        (0, 9e-7, True),
        (0, 1.1e-6, False),
        (0.5, 9e-7, True),
        (100, 9e-5, True),
        (-100, 9e-5, True),
        (100, 1.1e-4, False),
        (-100, 1.1e-4, False),
        (2e6, 2, True),  # exactly at the limit
        (2e6, 3, False),
    ],
)
def test_what_varies_by_rounding_only_is_not_scaled(
    mean: float, deviation: float, constant: bool
) -> None:
    (centre,), (scale,) = centre_and_scale(column(mean - deviation, mean + deviation))
    assert centre == pytest.approx(mean, abs=1e-6)
    assert scale == (1.0 if constant else pytest.approx(deviation, rel=0.05))


def test_actions_fill_their_range_whatever_their_mean() -> None:
    actions = np.concatenate((column(2, 4, 3.5), column(-1, 0, -1), column(7, 7, 7)), axis=1)
    found = normalisation_of(transitions(column(0, 1, 2), actions))
    assert found.action_centre == (3.0, -0.5, 7.0)
    assert found.action_scale == (1.0, 0.5, 1.0)  # a constant is only centred
    assert found.observation_centre == (1.0,)
    assert found.observation_scale == pytest.approx((np.sqrt(2 / 3),))


def test_observations_alone_leave_actions_as_they_are() -> None:
    found = normalisation_of_observations(column(1, 5), 2)
    assert found == Normalisation((3.0,), (2.0,), (0.0, 0.0), (1.0, 1.0))


def test_only_closenesses_are_sharpened() -> None:
    columns = {
        (0.0, 1.0): 3.0,  # the ends belong to it
        (0.25, 0.5): 3.0,
        (-0.01, 0.5): 1.0,
        (0.5, 1.01): 1.0,
        (0.5, 0.5): 1.0,  # does not vary
    }
    x = np.array(list(columns), dtype=np.float32).T.copy()
    found = normalisation_of(transitions(x, column(-1, 1)), 3.0)
    assert found.observation_power == tuple(columns.values())
    assert normalisation_of_observations(x, 1, 3.0).observation_power == found.observation_power
    assert found.observation_centre[0] == 0.5
    # The moments are those of the powers: 1/64 and 1/8.
    assert found.observation_centre[1] == pytest.approx(9 / 128)
    assert found.observation_scale[1] == pytest.approx(7 / 128)
    assert normalisation_of(transitions(x, column(-1, 1))).observation_power == ()


def test_networks_see_powers_centred_and_scaled() -> None:
    data = transitions(column(0.5, 1.0, 0.0), column(1, 3, 5))
    n = Normalisation((0.25,), (0.5,), (3.0,), (2.0,), (2.0,))
    seen = normalise(data, n)
    assert seen.observations.tolist() == [[0.0], [1.5], [-0.5]]
    assert seen.next_observations.tolist() == [[1.5], [-0.5], [0.0]]
    assert seen.actions.tolist() == [[-1.0], [0.0], [1.0]]
    for name in ("rewards", "costs", "terminals", "timeouts"):
        assert getattr(seen, name) is getattr(data, name)
    # In float32 and read-only, so that nothing copies them.
    scaled = module._scaled(data.actions, (3.0,), (2.0,))
    assert replace(data, actions=scaled).actions is scaled
    assert data.observations.tolist() == [[0.5], [1.0], [0.0]]
    assert normalise(data, replace(n, observation_power=())).observations.tolist() == [
        [0.5],
        [1.5],
        [-0.5],
    ]


def test_what_is_normalised_by_its_own_has_mean_0_and_deviation_1() -> None:
    rng = np.random.default_rng(2)
    x = (5 + 3 * rng.normal(size=(1000, 2))).astype(np.float32)
    data = transitions(x, rng.uniform(2, 7, (1000, 1)).astype(np.float32))
    seen = normalise(data, normalisation_of(data))
    assert seen.observations.mean(axis=0) == pytest.approx([0, 0], abs=1e-5)
    assert seen.observations.std(axis=0) == pytest.approx([1, 1], abs=1e-5)
    assert (seen.actions.min(), seen.actions.max()) == pytest.approx((-1, 1), abs=1e-6)


def test_tensors_are_normalised_as_arrays_are() -> None:
    rng = np.random.default_rng(3)
    units = [
        Normalisation((0.5, -2.0), (0.1, 3.0), (1.0,), (2.0,), power)
        for power in ((), (8.0, 1.0), (1.0, 2.5))
    ]
    raw = rng.normal(size=(3, 50, 2)).astype(np.float32)
    raw[:, :3, 0] = np.nan, np.inf, -np.inf
    action = rng.normal(size=(3, 50, 1)).astype(np.float32)
    both = TensorNormalisation(units)
    found = both.observation(torch.from_numpy(raw)).numpy()
    for k, n in enumerate(units):
        centre, scale = (
            np.array(x, np.float32) for x in (n.observation_centre, n.observation_scale)
        )
        expected = (n.powered(raw[k]) - centre) / scale
        assert np.allclose(found[k], expected, rtol=1e-5, equal_nan=True)
    inner = both.action(torch.from_numpy(action))
    assert np.allclose(inner.numpy(), (action - 1) / 2)
    assert np.allclose(both.raw_action(inner).numpy(), action, atol=1e-6)
