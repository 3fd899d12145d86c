"""What behavior correction needs: a critic, a recovery policy and a threshold, in numpy.

Equation (behavior_correction) of the paper, for n observations and actions at once:

    a = a_task if Q_c(s, a_task) < epsilon, else the mean of pi_rec(s)

Nothing here needs torch: a filter is deployed with numpy and safetensors alone.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep.perceptron import (
    Floats,
    Layers,
    check_layers,
    for_raw_inputs,
    forward,
    read_networks,
    write_networks,
)

__all__ = [
    "Correction",
    "Normalisation",
    "SafetyFilter",
]

FORMAT = "dead-ends safety filter 1"


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
            if not all(np.isfinite(centre)) or not all(np.isfinite(scale)) or min(scale) <= 0:
                raise ValueError(f"{name}: centres must be finite, scales positive and finite")
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
        return cls(**{name: tuple(values) for name, values in plain.items()})

    @classmethod
    def identity(cls, observation_dim: int, action_dim: int) -> Normalisation:
        """For observations and actions that lie in [-1, 1] already."""
        return cls(
            (0.0,) * observation_dim,
            (1.0,) * observation_dim,
            (0.0,) * action_dim,
            (1.0,) * action_dim,
        )


@dataclass(frozen=True)
class Correction:
    """What behavior correction did with n actions.

    Attributes:
        executed: float32 (n, action dim), the actions to take.
        intervened: bool (n,), where they are not the agent's.
        critic: float32 (n,), Q_c of the agent's actions.
    """

    executed: Floats
    intervened: NDArray[np.bool_]
    critic: Floats


@dataclass(frozen=True, eq=False)
class SafetyFilter:
    """A critic, a recovery policy and a threshold: all that behavior correction needs.

    Attributes:
        critic: layers (weights (M, in, out), biases (M, 1, out)) of the M members.
        recovery: layers (weights (in, out), biases (out,)); the outputs are the mean,
            then the log standard deviation.
        threshold: epsilon, in (0, 1].
        normalisation: of observations and actions.
        reach: the recovery action is reach * tanh(mean), cut off at the action range.
        gamma_safe, method, seed: where it comes from.
    """

    critic: Layers
    recovery: Layers
    threshold: float
    normalisation: Normalisation
    reach: float
    gamma_safe: float
    method: str
    seed: int
    # The same networks for raw observations and actions: what runs at every step.
    _raw_critic: Layers = field(init=False, repr=False)
    _raw_recovery: Layers = field(init=False, repr=False)
    _action_scale: Floats = field(init=False, repr=False)
    _action_centre: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.threshold <= 1:
            raise ValueError(f"threshold must lie in (0, 1], not {self.threshold}")
        o, a = self.observation_dim, self.action_dim
        check_layers("critic", self.critic, o + a, 1)
        check_layers("recovery", self.recovery, o, 2 * a)
        for weights, biases in (*self.critic, *self.recovery):
            weights.flags.writeable = biases.flags.writeable = False
        n = self.normalisation
        centre = np.array(n.observation_centre + n.action_centre)
        scale = np.array(n.observation_scale + n.action_scale)
        for name, value in (
            ("_raw_critic", for_raw_inputs(self.critic, centre, scale)),
            ("_raw_recovery", for_raw_inputs(self.recovery, centre[:o], scale[:o])),
            ("_action_scale", np.array(n.action_scale, dtype=np.float32)),
            ("_action_centre", np.array(n.action_centre, dtype=np.float32)),
        ):
            object.__setattr__(self, name, value)

    @property
    def observation_dim(self) -> int:
        """Coordinates of an observation."""
        return len(self.normalisation.observation_centre)

    @property
    def action_dim(self) -> int:
        """Coordinates of an action."""
        return len(self.normalisation.action_centre)

    def with_threshold(self, threshold: float) -> SafetyFilter:
        """The same networks behind another epsilon."""
        return SafetyFilter(
            self.critic,
            self.recovery,
            threshold,
            self.normalisation,
            self.reach,
            self.gamma_safe,
            self.method,
            self.seed,
        )

    def q(self, observations: NDArray[Any], actions: NDArray[Any]) -> Floats:
        """float32 (n,): Q_c(s, a), the most pessimistic member's, for (n, o) and (n, a)."""
        seen = self.normalisation.powered(observations)
        x = np.concatenate([seen, actions], axis=1, dtype=np.float32, casting="same_kind")
        logits = forward(self._raw_critic, x)[:, :, 0].max(axis=0)
        return _sigmoid(logits)

    def recovery_action(self, observations: NDArray[Any]) -> Floats:
        """float32 (n, a): the mean of pi_rec, in the environment's units."""
        seen = self.normalisation.powered(observations)
        mean = forward(self._raw_recovery, seen)[:, : self.action_dim]
        action = np.minimum(np.maximum(self.reach * np.tanh(mean), -1), 1)
        return np.asarray(action * self._action_scale + self._action_centre, dtype=np.float32)

    def correct(self, observations: NDArray[Any], actions: NDArray[Any]) -> Correction:
        """Equation (behavior_correction) for n observations and actions.

        An action at or above the threshold is replaced; so is one whose critic is NaN.
        """
        critic = self.q(observations, actions)
        intervened = ~(critic < self.threshold)
        executed = np.array(actions, dtype=np.float32)
        if intervened.any():
            recovery = self.recovery_action(observations)
            executed = np.where(intervened[:, None], recovery, executed)
        return Correction(executed, intervened, critic)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one safetensors file: arrays, and the rest as JSON in its header."""
        rest = {
            "threshold": self.threshold,
            "normalisation": asdict(self.normalisation),
            "reach": self.reach,
            "gamma_safe": self.gamma_safe,
            "method": self.method,
            "seed": self.seed,
        }
        write_networks(path, FORMAT, {"critic": self.critic, "recovery": self.recovery}, rest)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SafetyFilter:
        """Read what :meth:`save` wrote.

        Raises:
            ValueError: if the file is missing, broken, or something else.
        """
        layers, rest = read_networks(path, FORMAT, ("critic", "recovery"))
        try:
            normalisation = Normalisation.from_json(rest["normalisation"])
            return cls(
                layers["critic"],
                layers["recovery"],
                float(rest["threshold"]),
                normalisation,
                float(rest["reach"]),
                float(rest["gamma_safe"]),
                str(rest["method"]),
                int(rest["seed"]),
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"{path}: the safety filter lacks {error}") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _sigmoid(logits: Floats) -> Floats:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * logits)), dtype=np.float32)
