"""A trained task policy in numpy: the mean action of one seed, kept without pickle."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep.data.normalisation import Normalisation
from deep.filter.perceptron import (
    Floats,
    Layers,
    check_layers,
    for_raw_inputs,
    forward,
    read_networks,
    write_networks,
)
from deep.tasks.bounds import Bounds

__all__ = ["TrainedPolicy"]

FORMAT = "dead-ends task policy 1"


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """pi_task of one seed, executed as its mean.

    Attributes:
        layers: (weights (in, out), biases (out,)); the outputs are the mean before the
            squashing, then the log standard deviation.
        normalisation: of observations and actions.
        method, seed: where it comes from.
    """

    layers: Layers
    normalisation: Normalisation
    method: str
    seed: int
    _raw: Layers = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = self.normalisation
        o, a = len(n.observation_centre), len(n.action_centre)
        check_layers("policy", self.layers, o, 2 * a)
        raw = for_raw_inputs(
            "policy", self.layers, np.array(n.observation_centre), np.array(n.observation_scale)
        )
        object.__setattr__(self, "_raw", raw)

    def act(self, observations: NDArray[Any]) -> Floats:
        """float32 (n, a): the mean actions, in the environment's units."""
        n = self.normalisation
        output = forward(self._raw, n.powered(observations))
        action = np.tanh(output[:, : len(n.action_centre)])
        return np.asarray(action * n.action_scale + np.array(n.action_centre), dtype=np.float32)

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: Any = None,  # noqa: ARG002  (the signature of Stable-Baselines3)
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Any]:
        """As a Stable-Baselines3 model: the mean action of one observation or of many."""
        observation = np.asarray(observation)
        single = observation.ndim == 1
        action = self.act(observation[None] if single else observation)
        return (action[0] if single else action), state

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one safetensors file."""
        rest = {
            "normalisation": asdict(self.normalisation),
            "method": self.method,
            "seed": self.seed,
        }
        write_networks(path, FORMAT, {"policy": self.layers}, rest)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> TrainedPolicy:
        """Read what :meth:`save` wrote.

        Raises:
            ValueError: if the file is missing, broken, or something else.
        """
        networks, rest = read_networks(path, FORMAT, ("policy",))
        try:
            return cls(
                networks["policy"],
                Normalisation.from_json(rest["normalisation"]),
                str(rest["method"]),
                int(rest["seed"]),
            )
        except KeyError as error:
            raise ValueError(f"{path}: the task policy lacks {error}") from error
        except (TypeError, AttributeError, OverflowError) as error:
            raise ValueError(f"{path}: the task policy's header is damaged ({error})") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def check_units(what: str, made: Normalisation, task: str, bounds: Bounds) -> None:
    """Refuse task policies that were made for actions with other bounds than the task's.

    Args:
        what: the beginning of the message, up to its verb or colon.
        made: the policies' normalisation.
        task: the task's name.
        bounds: the task's, in the environment's units.

    Raises:
        ValueError: naming both.
    """
    centre, scale = np.array(made.action_centre), np.array(made.action_scale)
    found = Bounds.of(centre - scale, centre + scale)
    same = np.allclose((found.low, found.high), (bounds.low, bounds.high), rtol=1e-5, atol=1e-8)
    if not same:
        raise ValueError(f"{what} actions in {found}, those of {task} lie in {bounds}")
