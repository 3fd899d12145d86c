"""Trying an environment out without a trace: on copies, with the global generators put back."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from dead_ends.io.errors import optional_module

__all__ = [
    "copy_of",
    "discrete_range",
    "global_generators_kept",
    "is_discrete",
    "numerals",
    "use_randomness",
]


def copy_of(env: Any) -> Any:
    """A copy of what lies beneath the environment's wrappers, which draws no pictures.

    Raises:
        ValueError: if it cannot be copied.
    """
    try:
        trial = copy.deepcopy(env.unwrapped)
    except (TypeError, NotImplementedError) as error:
        raise ValueError(f"the environment cannot be copied: {error}") from None
    trial.render_mode = None
    return trial


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
    """Let all that the environment may draw from go on differently: its own generators, which
    are replaced or seeded anew, and the global ones (see :func:`global_generators_kept`)."""
    seed = int(rng.integers(2**32))
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  (environments draw from it)
    env.np_random = rng
    for name, value in list(vars(env).items()):
        if isinstance(value, np.random.Generator):
            setattr(env, name, rng)
        elif isinstance(value, random.Random | np.random.RandomState):
            value.seed(seed)
