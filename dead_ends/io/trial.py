"""Trying an environment out without a trace: on copies, with the global generators put back."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from dead_ends.io.errors import optional_module

__all__ = [
    "copy_of",
    "copy_with_wrappers",
    "discrete_range",
    "global_generators_kept",
    "is_discrete",
    "numerals",
    "take_step",
    "use_randomness",
]


def copy_of(env: Any) -> Any:
    """A copy of what lies beneath the environment's wrappers, which draws no pictures.

    Raises:
        ValueError: if it cannot be copied.
    """
    trial = _copy(env.unwrapped, {})
    trial.render_mode = None
    return trial


def copy_with_wrappers(env: Any) -> Any:
    """A copy as of :func:`copy_of`, within those of its wrappers that may change what a step does.

    Wrappers of observations and rewards, and Gymnasium's for limits, records and pictures, are
    left out. None if there are no others.

    Raises:
        ValueError: if it cannot be copied.
    """
    gymnasium = optional_module("gymnasium", "an environment", "gym")
    harmless = gymnasium.ObservationWrapper, gymnasium.RewardWrapper
    wrappers = []
    while isinstance(env, gymnasium.Wrapper):
        if not isinstance(env, harmless) and type(env).__module__ not in _RECORDS:
            wrappers.append(env)
        env = env.env
    if not wrappers:
        return None
    trial = copied = copy_of(env)
    for wrapper in reversed(wrappers):
        trial = _copy(wrapper, {id(wrapper.env): trial, id(env): copied})
    return trial


_RECORDS = ("gymnasium.wrappers.common", "gymnasium.wrappers.rendering")


def _copy(env: Any, memo: dict[int, Any]) -> Any:
    try:
        return copy.deepcopy(env, memo)
    except Exception as error:  # whatever an environment's own __deepcopy__ raises
        raise ValueError(f"the environment cannot be copied: {error}") from None


def take_step(env: Any, action: int) -> tuple[Any, float, bool, bool]:
    """Observation, reward, whether the episode terminated, whether it was truncated.

    Raises:
        ValueError: if the step gives something else than Gymnasium's five.
    """
    result = env.step(action)
    if not isinstance(result, tuple) or len(result) != 5:
        raise ValueError(
            f"action {action}: a step must give observation, reward, terminated, truncated and "
            f"info, not {len(result) if isinstance(result, tuple) else type(result).__name__}"
            f"{' values' if isinstance(result, tuple) else ''}"
        )
    observation, *rest, _ = result
    try:
        reward, terminated, truncated = (np.asarray(value).item() for value in rest)
        return observation, float(reward), bool(terminated), bool(truncated)
    except (TypeError, ValueError):
        raise ValueError(
            f"action {action}: a step's reward, terminated and truncated must be one number and "
            f"two truth values, not {tuple(rest)}"
        ) from None


def is_discrete(space: Any) -> bool:
    """Whether it is one of Gymnasium's Discrete spaces."""
    spaces = optional_module("gymnasium", "an environment", "gym").spaces
    return isinstance(space, spaces.Discrete)


def discrete_range(space: Any, what: str) -> range:
    """The numbers of a Discrete space, k to k + n - 1.

    Raises:
        ValueError: for another space, naming it.
    """
    if not is_discrete(space):
        raise ValueError(f"the environment's {what} must be Discrete, not {space}")
    return range(int(space.start), int(space.start + space.n))


def numerals(numbers: range) -> tuple[str, ...] | None:
    """The environment's numbers as names, where ours, which start at 0, are others."""
    return tuple(map(str, numbers)) if numbers.start else None


@contextmanager
def global_generators_kept() -> Iterator[None]:
    """Leave the global generators of Python and NumPy as they were."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002  (what it keeps)
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002  (what it keeps)


def use_randomness(env: Any, rng: np.random.Generator) -> None:
    """Let all that the environment may draw from go on differently: the global generators (see
    :func:`global_generators_kept`) and its own, also those inside its parts, which are seeded
    anew."""
    seed = int(rng.integers(2**32))
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  (environments draw from it)
    env.np_random = rng
    for generator in _generators(env, {id(rng)}):
        if isinstance(generator, np.random.Generator):
            bits = generator.bit_generator
            bits.state = type(bits)(seed).state
        else:
            generator.seed(seed)


def _generators(whole: Any, seen: set[int]) -> Iterator[Any]:
    """The generators that can be reached through attributes, lists, tuples and dictionaries."""
    waiting = [whole]
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen or isinstance(thing, type | ModuleType | FunctionType):
            continue
        seen.add(id(thing))
        if isinstance(thing, np.random.Generator | np.random.RandomState | random.Random):
            yield thing
        elif isinstance(thing, Mapping):
            waiting.extend(thing.values())
        elif isinstance(thing, list | tuple):
            waiting.extend(thing)
        else:
            waiting.extend(getattr(thing, "__dict__", {}).values())
