"""Interquartile mean over seeds, with a 95% interval by the stratified bootstrap.

The interquartile mean (IQM) is the mean without the lowest and the highest quarter,
floor(n / 4) values at either end: with 4 seeds the mean of the middle two, with fewer than 4 the
plain mean. The interval holds the 2.5% and 97.5% percentiles of the IQMs of resampled seeds. Over
several tasks the seeds of each task are resampled among themselves (the tasks are the strata)
and the IQM is over all of them. With a handful of seeds such an interval is coarse and rather
too narrow; with one seed there is none.

Source: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
2021, section 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import trim_mean

from deep.runs.bootstrap import Floats, percentile_interval

__all__ = ["Band", "Estimate", "Floats", "band", "estimate"]

BOOTSTRAP_STREAM = 104


@dataclass(frozen=True)
class Estimate:
    """An IQM and the ends of its interval, None with fewer than two seeds in a stratum."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, eq=False)
class Band:
    """IQMs along a curve, each float (n,); NaN where a seed has no value, or no interval."""

    value: Floats
    low: Floats
    high: Floats


def _iqm(*strata: Floats, axis: int = 0) -> Floats:
    return np.asarray(trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis))


def estimate(*strata: Sequence[float]) -> Estimate:
    """The IQM of the seeds' numbers, one sequence a task, with its interval."""
    arrays = [np.asarray(stratum, dtype=np.float64) for stratum in strata]
    value = float(_iqm(*arrays))
    if min(len(array) for array in arrays) < 2:
        return Estimate(value, None, None)
    low, high = percentile_interval(arrays, _iqm, BOOTSTRAP_STREAM)
    return Estimate(value, float(low), float(high))


def band(values: Floats) -> Band:
    """The IQM over the seeds, float (k, n), of each of n numbers.

    Where a seed has no value the curve has a gap: the IQM of the others would jump there.
    """
    value, low, high = (np.full(values.shape[1], np.nan) for _ in range(3))
    whole = np.isfinite(values).all(axis=0)
    if whole.any():
        value[whole] = _iqm(values[:, whole])
        if len(values) > 1:
            low[whole], high[whole] = percentile_interval(
                [values[:, whole]], _iqm, BOOTSTRAP_STREAM
            )
    return Band(value, low, high)
