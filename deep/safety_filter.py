"""What behavior correction needs: a critic, a recovery policy and a threshold, in numpy.

Equation (behavior_correction) of the paper, for n observations and actions at once:

    a = a_task if Q_c(s, a_task) < epsilon, else the mean of pi_rec(s)

Nothing here needs torch: a filter is deployed with numpy and safetensors alone.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path

__all__ = [
    "Correction",
    "Normalisation",
    "SafetyFilter",
]

Floats = NDArray[np.float32]
Layers = tuple[tuple[Floats, Floats], ...]
FORMAT = "dead-ends safety filter 1"


@dataclass(frozen=True)
class Normalisation:
    """How observations and actions enter the networks: (x - centre) / scale.

    Attributes:
        observation_centre, observation_scale: one number a coordinate.
        action_centre, action_scale: so that actions fill [-1, 1].
    """

    observation_centre: tuple[float, ...]
    observation_scale: tuple[float, ...]
    action_centre: tuple[float, ...]
    action_scale: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("observation", "action"):
            centre, scale = getattr(self, f"{name}_centre"), getattr(self, f"{name}_scale")
            if len(centre) != len(scale):
                raise ValueError(f"{name}: {len(centre)} centres for {len(scale)} scales")
            if not all(np.isfinite(centre)) or not all(np.isfinite(scale)) or min(scale) <= 0:
                raise ValueError(f"{name}: centres must be finite, scales positive and finite")

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
        _check_layers("critic", self.critic, o + a, 1)
        _check_layers("recovery", self.recovery, o, 2 * a)
        for weights, biases in (*self.critic, *self.recovery):
            if not (np.isfinite(weights).all() and np.isfinite(biases).all()):
                raise ValueError("the filter's weights hold a NaN or an infinity")
            weights.flags.writeable = biases.flags.writeable = False
        n = self.normalisation
        centre = np.array(n.observation_centre + n.action_centre)
        scale = np.array(n.observation_scale + n.action_scale)
        for name, value in (
            ("_raw_critic", _for_raw_inputs(self.critic, centre, scale)),
            ("_raw_recovery", _for_raw_inputs(self.recovery, centre[:o], scale[:o])),
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
        x = np.concatenate([observations, actions], axis=1, dtype=np.float32, casting="same_kind")
        logits = _forward(self._raw_critic, x)[:, :, 0].max(axis=0)
        return _sigmoid(logits)

    def recovery_action(self, observations: NDArray[Any]) -> Floats:
        """float32 (n, a): the mean of pi_rec, in the environment's units."""
        x = np.asarray(observations, dtype=np.float32)
        mean = _forward(self._raw_recovery, x)[:, : self.action_dim]
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
        from safetensors.numpy import save_file

        arrays = {
            f"{part}.{i}.{kind}": np.ascontiguousarray(array)
            for part, layers in (("critic", self.critic), ("recovery", self.recovery))
            for i, pair in enumerate(layers)
            for kind, array in zip(("weights", "biases"), pair, strict=True)
        }
        rest = {
            "format": FORMAT,
            "threshold": self.threshold,
            "normalisation": asdict(self.normalisation),
            "reach": self.reach,
            "gamma_safe": self.gamma_safe,
            "method": self.method,
            "seed": self.seed,
        }
        with atomic_path(path) as temporary:
            save_file(arrays, temporary, metadata={"filter": json.dumps(rest)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SafetyFilter:
        """Read what :meth:`save` wrote.

        Raises:
            ValueError: if the file is missing, broken, or something else.
        """
        arrays, rest = _read(Path(path))
        try:
            layers = {part: _layers(arrays, part) for part in ("critic", "recovery")}
            normalisation = Normalisation(
                **{name: tuple(values) for name, values in rest["normalisation"].items()}
            )
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


def _read(path: Path) -> tuple[dict[str, Floats], dict[str, Any]]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (no mapping)
    except SafetensorError as error:
        raise ValueError(f"{path}: not a safetensors file ({error})") from error
    rest = json.loads(metadata.get("filter", "{}"))
    if rest.get("format") != FORMAT:
        raise ValueError(f"{path}: not a safety filter of this version ({FORMAT!r})")
    return arrays, rest


def _layers(arrays: dict[str, Floats], part: str) -> Layers:
    count = sum(name.startswith(f"{part}.") for name in arrays) // 2
    return tuple(
        (arrays[f"{part}.{i}.weights"], arrays[f"{part}.{i}.biases"]) for i in range(count)
    )


def _check_layers(part: str, layers: Layers, inputs: int, outputs: int) -> None:
    if not layers:
        raise ValueError(f"{part}: there are no layers")
    if (layers[0][0].shape[-2], layers[-1][0].shape[-1]) != (inputs, outputs):
        raise ValueError(
            f"{part}: the network maps R^{layers[0][0].shape[-2]} to R^{layers[-1][0].shape[-1]}, "
            f"expected R^{inputs} to R^{outputs}"
        )
    if any(a[0].shape[-1] != b[0].shape[-2] for a, b in pairwise(layers)):
        raise ValueError(f"{part}: the layers do not fit each other")


def _forward(layers: Layers, x: Floats) -> Floats:
    """A perceptron with ReLU, or M of them at once if the layers have a leading axis."""
    *hidden, (last, bias) = layers
    for weights, biases in hidden:
        x = np.maximum(x @ weights + biases, 0)
    return np.asarray(x @ last + bias)


def _for_raw_inputs(layers: Layers, centre: NDArray[Any], scale: NDArray[Any]) -> Layers:
    """The same function of x where ``layers`` take (x - centre) / scale."""
    (weights, biases), *rest = layers
    scaled = weights.astype(np.float64) / scale[:, None]
    shifted = biases - centre @ scaled if biases.ndim == 1 else biases - (centre @ scaled)[:, None]
    return ((scaled.astype(np.float32), shifted.astype(np.float32)), *rest)


def _sigmoid(logits: Floats) -> Floats:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * logits)), dtype=np.float32)
