"""Percentile intervals over seeds: how far a number hangs on which seeds there were.

The interval holds the middle 95% of the statistic's values on resampled seeds (Efron, 1979).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

__all__ = ["Floats", "percentile_interval"]

Floats = NDArray[np.float64]
RESAMPLES = 2000


def percentile_interval(
    strata: Sequence[Floats], statistic: Callable[..., Any], stream: int
) -> tuple[Floats, Floats]:
    """Both ends of the 95% interval.

    Args:
        strata: each has its seeds along axis 0, at least two; they are resampled among themselves.
        statistic: of the strata, along ``axis``.
        stream: of the random numbers.
    """
    found = bootstrap(
        tuple(strata),
        statistic,
        n_resamples=RESAMPLES,
        vectorized=True,
        axis=0,
        method="percentile",
        rng=np.random.default_rng(stream),
    ).confidence_interval
    return np.asarray(found.low), np.asarray(found.high)
