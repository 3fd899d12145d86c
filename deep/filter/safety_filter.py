"""What behavior correction needs: a critic, a recovery policy and a threshold, in numpy.

Equation (behavior_correction) of the paper, for n observations and actions at once:

    a = a_task if Q_c(s, a_task) < epsilon, else the mean of pi_rec(s)

What leaves a filter is finite and within its action bounds, whatever enters it:

* an action outside the bounds is first moved to the nearest bound;
* where an observation or an action holds a NaN or an infinity, nothing can be judged: Q_c
  counts as 1 and the recovery policy acts;
* the recovery policy sees such a coordinate of an observation at its mean over the
  training data, and where its networks overflow it acts in the middle of its range.

Nothing here needs torch: a filter is deployed with numpy and safetensors alone.
"""

from __future__ import annotations

import base64
import os
import warnings
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep.data.normalisation import Normalisation
from deep.filter.equation import corrected
from deep.filter.perceptron import (
    Floats,
    Layers,
    check_layers,
    for_raw_inputs,
    forward,
    networks_from_bytes,
    networks_to_bytes,
    read_networks,
    write_networks,
)
from deep.tasks.bounds import LARGEST, ROUNDING, Bounds

__all__ = [
    "Correction",
    "SafetyFilter",
    "Watch",
]

Bools = NDArray[np.bool_]

FORMAT = "dead-ends safety filter 2"
FAR = 0.1
"""An observation is far outside if it leaves its range by more than this share of it."""
UNSEEN = 0.05
"""The share of a filter's action range by which an environment's may be wider at an end: the
ends of the range are seldom among the logged actions."""


@dataclass(frozen=True)
class Correction:
    """What behavior correction did with n actions.

    Attributes:
        executed: float32 (n, action dim), the actions to take: finite and within bounds.
        intervened: bool (n,), where the recovery policy acts. Elsewhere it is the agent's
            own action, moved to the nearest bound where it lies outside.
        critic: float32 (n,), Q_c of the agent's actions; 1 where it cannot be computed.
        out_of_range: bool (n,), where an observation lies far outside of the training data.
        not_finite: bool (n,), where an observation or an action holds a NaN or an infinity.
    """

    executed: Floats
    intervened: Bools
    critic: Floats
    out_of_range: Bools
    not_finite: Bools


@dataclass(frozen=True, eq=False)
class SafetyFilter:
    """A critic, a recovery policy and a threshold: all that behavior correction needs.

    Attributes:
        critic: layers (weights (M, in, out), biases (M, 1, out)) of the M members.
        recovery: layers (weights (in, out), biases (out,)); the outputs are the mean,
            then the log standard deviation.
        threshold: epsilon, in (0, 1].
        normalisation: of observations and actions.
        actions: the bounds of the actions that it was trained on, in the environment's units.
        observations: the range of the observations that it was trained on.
        reach: the recovery action is reach * tanh(mean), cut off at the action range.
        gamma_safe, method, seed: where it comes from.

    >>> safety = pretrain(log, horizon=3, updates=3, quiet=True).filters[0]
    >>> safety.save("filter.safetensors")
    >>> loaded = SafetyFilter.load("filter.safetensors").with_threshold(0.01)
    >>> done = loaded.correct(np.array([[1.0], [np.nan]]), np.array([[1.0], [0.0]]))
    >>> done.intervened, done.not_finite
    (array([ True,  True]), array([False,  True]))
    """

    critic: Layers
    recovery: Layers
    threshold: float
    normalisation: Normalisation
    actions: Bounds
    observations: Bounds
    reach: float
    gamma_safe: float
    method: str
    seed: int
    # The same networks for raw observations and actions: what runs at every step.
    _raw_critic: Layers = field(init=False, repr=False)
    _raw_recovery: Layers = field(init=False, repr=False)
    _observation_centre: Floats = field(init=False, repr=False)
    _action_scale: Floats = field(init=False, repr=False)
    _action_centre: Floats = field(init=False, repr=False)
    _action_ends: tuple[Floats, Floats] = field(init=False, repr=False)
    _near: tuple[Floats, Floats] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.threshold <= 1:
            raise ValueError(f"threshold must lie in (0, 1], not {self.threshold}")
        if not 0 < self.reach < np.inf:
            raise ValueError(f"reach must be positive and finite, not {self.reach}")
        if not 0 <= self.gamma_safe <= 1:
            raise ValueError(f"gamma_safe must lie in [0, 1], not {self.gamma_safe}")
        o, a = self.observation_dim, self.action_dim
        if (len(self.observations.low), len(self.actions.low)) != (o, a):
            raise ValueError(
                f"the bounds are those of {len(self.observations.low)} observations and "
                f"{len(self.actions.low)} actions, expected {o} and {a}"
            )
        check_layers("critic", self.critic, o + a, 1, several=True)
        check_layers("recovery", self.recovery, o, 2 * a)
        for weights, biases in (*self.critic, *self.recovery):
            weights.flags.writeable = biases.flags.writeable = False
        n = self.normalisation
        centre = np.array(n.observation_centre + n.action_centre)
        scale = np.array(n.observation_scale + n.action_scale)
        low, high = np.clip(self.observations.widened(FAR), -LARGEST, LARGEST)
        for name, value in (
            ("_raw_critic", for_raw_inputs("critic", self.critic, centre, scale)),
            ("_raw_recovery", for_raw_inputs("recovery", self.recovery, centre[:o], scale[:o])),
            ("_observation_centre", np.array(n.observation_centre, dtype=np.float32)),
            ("_action_scale", np.array(n.action_scale, dtype=np.float32)),
            ("_action_centre", np.array(n.action_centre, dtype=np.float32)),
            ("_action_ends", inner_ends(self.actions)),
            ("_near", (low.astype(np.float32), high.astype(np.float32))),
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
        return replace(self, threshold=threshold)

    def for_actions(self, bounds: Bounds, where: str) -> SafetyFilter:
        """The same filter for an environment whose actions have these bounds.

        They may be wider than the filter's by 5% of its range at each end, because the ends
        are seldom among logged actions; not narrower.

        Args:
            bounds: the environment's, in its own units.
            where: the environment, for the message.

        Raises:
            ValueError: if they are other bounds than those it was trained on.
        """
        low, high = np.array(self.actions.low), np.array(self.actions.high)
        least, most = np.array(bounds.low), np.array(bounds.high)
        width = high - low
        fits = (
            (low - UNSEEN * width <= least)
            & (least <= low + ROUNDING * width)
            & (high - ROUNDING * width <= most)
            & (most <= high + UNSEEN * width)
        )
        if not fits.all():
            wider = (least <= low).all() and (most >= high).all()
            hint = (
                "; if the log merely shows no others, state the environment's bounds in "
                "pretraining (--action-low, --action-high)"
            )
            raise ValueError(
                f"{where}: its actions lie in {bounds}, the filter was trained on actions in "
                f"{self.actions}{hint if wider else ''}"
            )
        return replace(self, actions=bounds)

    def q(self, observations: NDArray[Any], actions: NDArray[Any]) -> Floats:
        """float32 (n,): Q_c(s, a), the most pessimistic member's, for (n, o) and (n, a).

        1 where an observation or an action is not finite, or the networks overflow.

        Raises:
            ValueError: for other shapes, and for what are no real numbers.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            seen, proposed = self._pairs(observations, actions)
            critic = self._judged(seen, proposed)
        critic[~(_finite(seen) & _finite(proposed))] = 1
        return critic

    def _judged(self, seen: Floats, proposed: Floats) -> Floats:
        """Q_c for finite observations and actions."""
        powered = self.normalisation.powered(seen)
        logits = forward(self._raw_critic, np.concatenate([powered, proposed], axis=1))[:, :, 0]
        critic = _sigmoid(logits.max(axis=0))
        critic[~np.isfinite(logits).all(axis=0)] = 1  # minus infinity is no proof of safety
        if powered is not seen:
            critic[~_finite(powered)] = 1
        return critic

    def recovery_action(self, observations: NDArray[Any]) -> Floats:
        """float32 (n, a): the mean of pi_rec, in the environment's units and within bounds.

        A coordinate of an observation that is not finite is taken to be at its mean; where the
        networks overflow, the action is the middle of the policy's range.

        Raises:
            ValueError: for other shapes, and for what are no real numbers.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._recovered(_rows("observations", observations, self.observation_dim))

    def _pairs(self, observations: NDArray[Any], actions: NDArray[Any]) -> tuple[Floats, Floats]:
        """The same in single precision, n of each."""
        seen = _rows("observations", observations, self.observation_dim)
        proposed = _rows("actions", actions, self.action_dim)
        if len(seen) != len(proposed):
            raise ValueError(f"there are {len(seen)} observations and {len(proposed)} actions")
        return seen, proposed

    def _recovered(self, observations: Floats) -> Floats:
        seen = self.normalisation.powered(observations)
        lost = ~(np.isfinite(seen) & np.isfinite(observations))
        if lost.any():
            seen = np.where(lost, self._observation_centre, seen)
        unit = self.reach * np.tanh(forward(self._raw_recovery, seen)[:, : self.action_dim])
        unit[np.isnan(unit)] = 0
        action = _within(unit, -1, 1) * self._action_scale + self._action_centre
        return np.asarray(_within(action, *self._action_ends), dtype=np.float32)

    def correct(self, observations: NDArray[Any], actions: NDArray[Any]) -> Correction:
        """Equation (behavior_correction) for n observations and actions.

        Actions are first moved to the nearest bound. One at or above the threshold is
        replaced; so is one that cannot be judged, see the head of this module.

        Raises:
            ValueError: for other shapes, and for what are no real numbers.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            seen, proposed = self._pairs(observations, actions)
            low, high = self._near
            near = (seen >= low) & (seen <= high)  # and finite
            executed = _within(proposed, *self._action_ends)
            critic = self._judged(seen, executed)
            if near.all() and (executed == proposed).all():  # nearly always
                out_of_range = not_finite = np.zeros(len(seen), dtype=np.bool_)
            else:
                out_of_range = self.out_of_range(seen)
                not_finite = ~(_finite(seen) & _finite(proposed))
                critic[not_finite] = 1
            executed, intervened = corrected(
                executed, critic, self.threshold, lambda: self._recovered(seen)
            )
        return Correction(executed, intervened, critic, out_of_range, not_finite)

    def out_of_range(self, observations: NDArray[Any]) -> Bools:
        """bool (n,): observations (n, o) that lie far outside of the training data.

        By more than a tenth of the range of a coordinate; a NaN lies nowhere, and counts not.
        """
        return np.asarray(self._strays(observations).any(axis=1))

    def _strays(self, observations: NDArray[Any]) -> Bools:
        low, high = self._near
        return np.asarray((observations < low) | (observations > high))

    def stray(self, observation: NDArray[Any]) -> str:
        """Which coordinate of an observation (o,) lies far outside, and of what range."""
        j = int(self._strays(observation[None])[0].argmax())
        low, high = self.observations.low[j], self.observations.high[j]
        return (
            f"coordinate {j} is {observation[j]:.4g}, the data reach from {low:.4g} to {high:.4g}"
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one safetensors file: arrays, and the rest as JSON in its header."""
        write_networks(path, FORMAT, self._networks(), self._rest())

    def to_text(self) -> str:
        """The content of the file that :meth:`save` writes, in base64: for JSON."""
        content = networks_to_bytes(FORMAT, self._networks(), self._rest())
        return base64.b64encode(content).decode()

    def _networks(self) -> dict[str, Layers]:
        return {"critic": self.critic, "recovery": self.recovery}

    def _rest(self) -> dict[str, Any]:
        return {
            "threshold": self.threshold,
            "normalisation": asdict(self.normalisation),
            "actions": asdict(self.actions),
            "observations": asdict(self.observations),
            "reach": self.reach,
            "gamma_safe": self.gamma_safe,
            "method": self.method,
            "seed": self.seed,
        }

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SafetyFilter:
        """Read what :meth:`save` wrote.

        Raises:
            ValueError: if the file is missing, broken, or something else.
        """
        layers, rest = read_networks(path, FORMAT, ("critic", "recovery"))
        try:
            return cls._from_parts(layers, rest)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def from_text(cls, text: str) -> SafetyFilter:
        """What :meth:`to_text` gave.

        Raises:
            ValueError: if it is broken, or something else.
        """
        try:
            content = base64.b64decode(text, validate=True)
        except ValueError as error:
            raise ValueError(
                "not a safety filter as text, which SafetyFilter.to_text gives; SafetyFilter.load "
                f"reads a file ({error})"
            ) from error
        return cls._from_parts(*networks_from_bytes(content, FORMAT, ("critic", "recovery")))

    @classmethod
    def _from_parts(cls, layers: dict[str, Layers], rest: dict[str, Any]) -> SafetyFilter:
        try:
            ranges = {
                name: Bounds(*(tuple(map(float, rest[name][end])) for end in ("low", "high")))
                for name in ("actions", "observations")
            }
            return cls(
                critic=layers["critic"],
                recovery=layers["recovery"],
                threshold=float(rest["threshold"]),
                normalisation=Normalisation.from_json(rest["normalisation"]),
                **ranges,
                reach=float(rest["reach"]),
                gamma_safe=float(rest["gamma_safe"]),
                method=str(rest["method"]),
                seed=int(rest["seed"]),
            )
        except KeyError as error:
            raise ValueError(f"the safety filter lacks {error}") from error
        except (TypeError, AttributeError, OverflowError) as error:
            raise ValueError(f"the safety filter's header is damaged ({error})") from error


class Watch:
    """Counts what a filter does and should not meet; warns of each of the latter once.

    Attributes:
        steps, interventions, out_of_range, not_finite: counts of actions.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.interventions = 0
        self.out_of_range = 0
        self.not_finite = 0

    def add(self, safety: SafetyFilter, observations: NDArray[Any], correction: Correction) -> None:
        """Count a correction of the filter in these observations (n, o)."""
        self.steps += len(correction.intervened)
        self.interventions += int(correction.intervened.sum())
        if correction.out_of_range.any():
            if not self.out_of_range:
                first = observations[int(correction.out_of_range.argmax())]
                warnings.warn(
                    "an observation lies far outside of what the safety filter was trained on "
                    f"({safety.stray(first)}): its answers there are guesses; further ones are "
                    "counted, not warned of",
                    stacklevel=3,
                )
            self.out_of_range += int(correction.out_of_range.sum())
        if correction.not_finite.any():
            if not self.not_finite:
                warnings.warn(
                    "an observation or an action holds a NaN or an infinity: the recovery policy "
                    "acts instead; further ones are counted, not warned of",
                    stacklevel=3,
                )
            self.not_finite += int(correction.not_finite.sum())


def inner_ends(bounds: Bounds) -> tuple[Floats, Floats]:
    """The bounds in float32, where rounding must not widen them."""
    low, high = np.array(bounds.low), np.array(bounds.high)
    least, most = low.astype(np.float32), high.astype(np.float32)
    up, down = np.float32(np.inf), np.float32(-np.inf)
    return (
        np.where(least < low, np.nextafter(least, up), least),
        np.where(most > high, np.nextafter(most, down), most),
    )


def _rows(name: str, given: NDArray[Any], width: int) -> Floats:
    """(n, width) in single precision; what is too large for it becomes infinite."""
    try:
        rows = np.asarray(given)
    except ValueError as error:
        raise ValueError(f"{name}: the rows differ in length ({error})") from error
    if rows.dtype.kind not in "biuf":
        raise ValueError(f"{name} are of type {rows.dtype}, not real numbers")
    if rows.ndim != 2 or rows.shape[1] != width:
        raise ValueError(f"{name} have shape {rows.shape}, expected (n, {width})")
    return rows.astype(np.float32, copy=False)


def _within(x: NDArray[Any], low: Floats | float, high: Floats | float) -> Floats:
    return np.asarray(np.minimum(np.maximum(x, low), high))


def _finite(rows: NDArray[Any]) -> Bools:
    """bool (n,): which of the rows (n, d) hold finite numbers only."""
    return np.asarray(np.isfinite(rows).all(axis=1))


def _sigmoid(logits: Floats) -> Floats:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * logits)), dtype=np.float32)
