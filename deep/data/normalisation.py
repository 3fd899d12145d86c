"""How offline data become the networks' inputs: powers, means, deviations; and what they cover.

:class:`Normalisation` holds the numbers and needs no torch: filters carry one.
:class:`TensorNormalisation` applies those of K seeds to tensors, while they are trained.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deep.data.transitions import Transitions
from deep.tasks.bounds import CONSTANT, LARGEST, LEAST, ROUNDING, Bounds

if TYPE_CHECKING:
    from torch import Tensor

__all__ = [
    "Normalisation",
    "Ranges",
    "TensorNormalisation",
    "centre_and_scale",
    "columns",
    "normalisation_of",
    "normalisation_of_observations",
    "normalise",
    "ranges_of",
    "with_action_bounds",
]

ROWS = 1 << 14


class Ranges(NamedTuple):
    """What a filter is trained on, in the environment's units.

    Attributes:
        actions: bounds of the actions.
        observations: the least and the greatest in which an action was taken.
    """

    actions: Bounds
    observations: Bounds


def ranges_of(data: Transitions, actions: Bounds | None = None) -> Ranges:
    """The ranges of the data; ``actions`` are the environment's bounds, where they are known.

    Raises:
        ValueError: naming the row of an action outside of ``actions``.
    """
    observations = Bounds.covered(data.observations)
    if actions is None:
        return Ranges(Bounds.covered(data.actions), observations)
    if len(actions.low) != data.actions.shape[1]:
        raise ValueError(
            f"actions lie in R^{data.actions.shape[1]}, their bounds in R^{len(actions.low)}"
        )
    low, high = actions.widened(ROUNDING)
    outside = ((data.actions < low) | (data.actions > high)).any(axis=1)
    if outside.any():
        row = int(np.argmax(outside))
        values = ", ".join(f"{x:.6g}" for x in data.actions[row])
        raise ValueError(f"actions: row {row} is ({values}), outside of their bounds {actions}")
    return Ranges(actions, observations)


@dataclass(frozen=True)
class Normalisation:
    """How observations and actions enter the networks: (x ** power - centre) / scale.

    Attributes:
        observation_centre, observation_scale: one number a coordinate.
        action_centre, action_scale: so that actions fill [-1, 1].
        observation_power: one number a coordinate, at least 1; where it is not 1, what is
            negative counts as 0; empty: 1 everywhere. Of a closeness in [0, 1], such as a
            lidar's, a high power spreads the last centimetres and forgets the rest.
    """

    observation_centre: tuple[float, ...]
    observation_scale: tuple[float, ...]
    action_centre: tuple[float, ...]
    action_scale: tuple[float, ...]
    observation_power: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("observation", "action"):
            centre, scale = getattr(self, f"{name}_centre"), getattr(self, f"{name}_scale")
            if len(centre) != len(scale):
                raise ValueError(f"{name}: {len(centre)} centres for {len(scale)} scales")
            fits = all(abs(x) <= LARGEST for x in centre)
            if not scale or not fits or not all(LEAST <= x <= LARGEST for x in scale):
                raise ValueError(
                    f"{name}: centres must be finite, scales positive and finite, in single "
                    "precision"
                )
        power = self.observation_power
        if len(power) not in (0, len(self.observation_centre)):
            raise ValueError(
                f"observation: {len(power)} powers for {len(self.observation_centre)} centres"
            )
        if not all(np.isfinite(power)) or min(power, default=1) < 1:
            raise ValueError("observation: powers must be finite and at least 1")

    @cached_property
    def _sharpened(self) -> NDArray[np.int64]:
        return np.flatnonzero(np.array(self.observation_power) != 1)

    def powered(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """x ** power, for observations (..., o)."""
        x = np.asarray(observations, dtype=np.float32)
        if not len(self._sharpened):
            return x
        power = np.array(self.observation_power, dtype=np.float32)[self._sharpened]
        x = x.copy()
        x[..., self._sharpened] = np.maximum(x[..., self._sharpened], 0) ** power
        return x

    @classmethod
    def from_json(cls, plain: dict[str, list[float]]) -> Normalisation:
        """What ``asdict`` gave, after JSON has made lists of its tuples."""
        return cls(**{name: tuple(map(float, values)) for name, values in plain.items()})

    @classmethod
    def identity(cls, observation_dim: int, action_dim: int) -> Normalisation:
        """For observations and actions that lie in [-1, 1] already."""
        return cls(
            (0.0,) * observation_dim,
            (1.0,) * observation_dim,
            (0.0,) * action_dim,
            (1.0,) * action_dim,
        )


def normalisation_of(data: Transitions, sharpness: float = 1.0) -> Normalisation:
    """Observations to mean 0 and standard deviation 1, actions by their range to [-1, 1].

    Coordinates that stay in [0, 1], closenesses, are first raised to the power ``sharpness``.

    Sensors have spikes that a range would be made of: with it an accelerometer's usual
    values would fill a small part of [-1, 1], the smaller the longer it was recorded. A
    coordinate that is constant up to rounding is only centred.
    """
    seen = normalisation_of_observations(data.observations, data.actions.shape[1], sharpness)
    return with_action_bounds(seen, Bounds.covered(data.actions))


def normalisation_of_observations(
    x: NDArray[np.float32], action_dim: int, sharpness: float = 1.0
) -> Normalisation:
    """As :func:`normalisation_of`, of observations (n, o); actions stay as they are."""
    identity = Normalisation.identity(x.shape[1], action_dim)
    sharpened = replace(identity, observation_power=_powers(x, sharpness))
    centre, scale = centre_and_scale(sharpened.powered(x))
    return replace(sharpened, observation_centre=centre, observation_scale=scale)


def with_action_bounds(n: Normalisation, actions: Bounds) -> Normalisation:
    """The same for observations, with actions by their bounds to [-1, 1]."""
    low, high = np.array(actions.low), np.array(actions.high)
    half = (high - low) / 2
    return replace(
        n,
        action_centre=tuple(((low + high) / 2).tolist()),
        action_scale=tuple(np.where(half > 0, half, 1.0).tolist()),
    )


def _powers(x: NDArray[np.float32], sharpness: float) -> tuple[float, ...]:
    """``sharpness`` for coordinates in [0, 1] that vary, 1 for others; () if it is 1."""
    if sharpness == 1:
        return ()
    low, high = x.min(axis=0), x.max(axis=0)
    closeness = (low >= 0) & (high <= 1) & (low < high)
    return tuple(np.where(closeness, sharpness, 1.0).tolist())


def centre_and_scale(x: NDArray[np.float32]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Of observations (n, o): mean, and standard deviation or 1 where they do not vary."""
    mean, deviation = _moments(x)
    constant = deviation <= CONSTANT * np.maximum(1, np.abs(mean))
    return tuple(mean.tolist()), tuple(np.where(constant, 1.0, deviation).tolist())


def _moments(x: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of each column, in float64 without a copy in it."""
    mean = x.mean(axis=0, dtype=np.float64)
    blocks = (x[first : first + ROWS] for first in range(0, len(x), ROWS))
    squares = sum(((block - mean) ** 2).sum(axis=0) for block in blocks)
    return mean, np.sqrt(squares / len(x))


def normalise(data: Transitions, n: Normalisation) -> Transitions:
    """The data with observations and actions as networks see them."""
    return replace(
        data,
        observations=_observed(data.observations, n),
        next_observations=_observed(data.next_observations, n),
        actions=_scaled(data.actions, n.action_centre, n.action_scale),
    )


def _observed(x: NDArray[np.float32], n: Normalisation) -> NDArray[np.float32]:
    return _scaled(n.powered(x), n.observation_centre, n.observation_scale)


def _scaled(
    x: NDArray[np.float32], centre: tuple[float, ...], scale: tuple[float, ...]
) -> NDArray[np.float32]:
    """(x - centre) / scale as one new read-only array."""
    scaled = x - np.array(centre, dtype=np.float32)
    scaled /= np.array(scale, dtype=np.float32)
    scaled.flags.writeable = False
    return scaled


class TensorNormalisation:
    """The same for tensors (K, B, .) of K seeds, each with its own numbers.

    Args:
        normalisation: one a seed.
    """

    def __init__(self, normalisation: Sequence[Normalisation]) -> None:
        self.of_seeds = tuple(normalisation)
        self._centre = columns(n.observation_centre for n in normalisation)
        self._scale = columns(n.observation_scale for n in normalisation)
        self._action_centre = columns(n.action_centre for n in normalisation)
        self._action_scale = columns(n.action_scale for n in normalisation)
        ones = (1.0,) * self._centre.shape[-1]
        self._power = columns(n.observation_power or ones for n in normalisation)
        self._sharp = bool((self._power != 1).any())

    def observation(self, raw: Tensor) -> Tensor:
        """(raw ** power - centre) / scale, as :meth:`Normalisation.powered` has it."""
        if self._sharp:
            raw = raw.where(self._power == 1, raw.clamp(min=0) ** self._power)
        return (raw - self._centre) / self._scale

    def action(self, raw: Tensor) -> Tensor:
        """(raw - centre) / scale."""
        return (raw - self._action_centre) / self._action_scale

    def raw_action(self, action: Tensor) -> Tensor:
        """The inverse of :meth:`action`."""
        return action * self._action_scale + self._action_centre


def columns(rows: Iterable[Sequence[float]]) -> Tensor:
    """float32 (K, 1, n), a tensor, from K rows."""
    import torch  # here, as filters run without it

    return torch.tensor(list(rows), dtype=torch.float32)[:, None]
