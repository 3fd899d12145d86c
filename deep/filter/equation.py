"""Equation (behavior_correction) of the paper, for n actions at once; its one definition in numpy.

    a = a_task if Q_c(s, a_task) < epsilon, else the recovery policy's action

What cannot be compared is not below epsilon: an action whose critic is a NaN is blocked. In
torch it is :func:`deep.train.correction.corrected_tensors`, in ONNX
:func:`deep.filter.onnx_export.export_onnx`; tests hold the three against each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["blocks", "corrected"]

Bools = NDArray[np.bool_]
Number = TypeVar("Number", bound=np.floating)


def blocks(critic: NDArray[np.floating], threshold: float) -> Bools:
    """bool, of the critic's shape: where Q_c is not below the threshold.

    >>> blocks(np.array([0.2, 0.5, 0.9, np.nan], dtype=np.float32), 0.5)
    array([False,  True,  True,  True])
    """
    return np.asarray(~(critic < threshold))


def corrected(
    proposed: NDArray[Number],
    critic: NDArray[np.floating],
    threshold: float,
    recovery: Callable[[], NDArray[Number]],
) -> tuple[NDArray[Number], Bools]:
    """The actions to execute (n, a), and where they are not the agent's, (n,).

    Args:
        proposed: (n, a), the agent's.
        critic: (n,), Q_c of these.
        threshold: epsilon.
        recovery: gives the actions (n, a) of the recovery policy; called only if needed.

    >>> corrected(np.array([[1.0], [2.0]]), np.array([0.1, 0.6]), 0.5, lambda: np.zeros((2, 1)))
    (array([[1.],
           [0.]]), array([False,  True]))
    """
    intervened = blocks(critic, threshold)
    if not intervened.any():
        return proposed, intervened
    return np.where(intervened[:, None], recovery(), proposed), intervened
