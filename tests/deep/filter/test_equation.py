"""Equation (behavior_correction): numpy, torch and ONNX block the same, a NaN critic always."""

from __future__ import annotations

import doctest
from itertools import product
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from deep.filter import equation
from deep.filter.equation import blocks, corrected
from deep.filter.onnx_export import export_onnx
from deep.train.correction import corrected_tensors
from tests.deep.filters import linear_filter

WIDTH = {"width": 32}
HOSTILE = [0.0, -0.0, 1.0, 1e-45, 1e38, -1e38, np.nan, np.inf, -np.inf]
CRITICS = arrays.arrays(np.float32, 8, elements=st.floats(**WIDTH) | st.floats(0, 1, **WIDTH))


@given(CRITICS, st.floats(2**-20, 1, width=32), st.integers(0, 7))
def test_numpy_and_torch_agree_on_hostile_critics(
    critic: np.ndarray, threshold: float, at: int
) -> None:
    critic[at] = threshold
    proposed, recovery = np.arange(16.0).reshape(8, 2), -np.arange(16.0).reshape(8, 2)
    executed, intervened = corrected(proposed, critic, threshold, lambda: recovery)
    expected = np.array([not c < threshold for c in critic.tolist()])
    assert np.array_equal(intervened, expected)
    assert np.array_equal(executed, np.where(expected[:, None], recovery, proposed))
    tensors = (proposed, critic, np.array([threshold], dtype=np.float32), recovery)
    found = corrected_tensors(*(torch.from_numpy(np.array(x))[None] for x in tensors))
    assert np.array_equal(found[0][0].numpy(), executed)
    assert np.array_equal(found[1][0].numpy(), intervened)


def test_what_is_no_number_or_at_the_threshold_is_blocked() -> None:
    critic = np.array([0.1, np.nextafter(np.float32(0.5), 0), 0.5, 0.6, 1, np.nan, np.inf, -np.inf])
    expected = [False, False, True, True, True, True, True, False]
    assert blocks(critic.astype(np.float32), 0.5).tolist() == expected


def test_the_recovery_policy_is_asked_only_if_needed() -> None:
    def never() -> np.ndarray:
        raise AssertionError

    proposed = np.ones((3, 1))
    executed, intervened = corrected(proposed, np.zeros(3), 0.5, never)
    assert executed is proposed
    assert not intervened.any()


@pytest.mark.parametrize(("weight", "bias"), [(0.0, 0.0), (1.0, 0.0), (1e30, 0.0), (-1e30, 0.0)])
def test_numpy_and_onnx_agree_on_hostile_input(weight: float, bias: float, tmp_path: Path) -> None:
    """Q_c is at the threshold, spread around it, or overflows."""
    safety = linear_filter([weight], weight, bias, 0.3)
    export_onnx(safety, tmp_path / "filter.onnx")
    pairs = np.array(list(product(HOSTILE, HOSTILE)), dtype=np.float32)
    session = onnxruntime.InferenceSession(str(tmp_path / "filter.onnx"))
    names = ("executed", "intervened", "critic")
    found = session.run(list(names), {"observation": pairs[:, :1], "action": pairs[:, 1:]})
    expected = safety.correct(pairs[:, :1], pairs[:, 1:])
    assert np.array_equal(found[1], expected.intervened)
    assert found[1][~np.isfinite(pairs).all(axis=1)].all()
    assert found[0] == pytest.approx(expected.executed, abs=1e-6)
    assert found[2] == pytest.approx(expected.critic, abs=1e-6)


def test_its_examples_run() -> None:
    assert doctest.testmod(equation) == (0, 2)
