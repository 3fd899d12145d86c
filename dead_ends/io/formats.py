"""One door for all formats: the suffix, or an environment id, says which reader is meant."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from dead_ends.io.compressed import plain_path
from dead_ends.io.transitions import Condition
from dead_ends.model.safe_mdp import SafeMDP, require_type

if TYPE_CHECKING:
    from dead_ends.io.explicit import Failure

__all__ = ["ModelOptions", "load_model", "save_model"]

_ENVIRONMENT_ID = re.compile(r"([\w.]+:)?([\w.-]+/)?[\w.-]+-v\d+")


@dataclass(frozen=True)
class ModelOptions:
    """What a source cannot say by itself. A reader refuses options that mean nothing to it.

    Attributes:
        fail_label: the label of the fail states, or several, in formats with labels.
        fail_states: a mask (S,) or numbers of states.
        fail_if: a condition on (s, a, r, s'), or on the model's variables; see
            :mod:`dead_ends.io.condition`.
        arguments: for making an environment.
        constants: values of a symbolic model's constants, such as "N=4,K=2".
        seed: of an environment's reset that draws a layout, 0 if nothing is said.
        normalise: divide probabilities that miss 1 by their rounding, such as those of files with
            six digits, by their sum; see :meth:`dead_ends.SafeMDP.stochastic`.
    """

    fail_label: str | Sequence[str] | None = None
    fail_states: ArrayLike | None = None
    fail_if: Condition | None = None
    arguments: Mapping[str, Any] | None = None
    constants: str | None = None
    seed: int | None = None
    normalise: bool = False

    def failure(self) -> Failure:
        """The same for a model with labels."""
        from dead_ends.io.explicit import Failure

        return Failure(self.fail_label, self.fail_states, self.fail_if)

    def reject(self, source: str, *names: str) -> None:
        """Raise a ValueError if one of the named options is given."""
        for name in names:
            if getattr(self, name) is not None:
                option = "--" + ("env-arg" if name == "arguments" else name.replace("_", "-"))
                raise ValueError(
                    f"{source}: {name} ({option}) means nothing for this kind of model"
                )


def load_model(
    source: Any,
    *,
    fail_label: str | Sequence[str] | None = None,
    fail_states: ArrayLike | None = None,
    fail_if: Condition | None = None,
    arguments: Mapping[str, Any] | None = None,
    constants: str | None = None,
    seed: int | None = None,
    normalise: bool = False,
) -> SafeMDP:
    """The model in a file, or of a Gymnasium environment.

    Args:
        source: a path whose suffix says the format (of text formats also ``.tra.gz``, ...), an
            environment id such as "FrozenLake-v1", or an environment.
        fail_label, fail_states, fail_if, arguments, constants, normalise, seed: see
            :class:`ModelOptions`.

    Raises:
        ValueError: naming the file, and the place in it where something is wrong.
        OSError: if the file cannot be read.
        MissingDependencyError: if a package that the format needs is not installed.

    Warns:
        NoFailureWarning: if one of fail_label, fail_states and fail_if selects nothing, so that
            failure by it is impossible.
    """
    options = ModelOptions(fail_label, fail_states, fail_if, arguments, constants, seed, normalise)
    if not isinstance(source, str | os.PathLike):
        return _load_environment(source, options)
    path = Path(source)
    reader = _reader(path)
    if reader is not None:
        return reader(path, options)
    name = os.fspath(source)
    if not path.exists() and _ENVIRONMENT_ID.fullmatch(name):
        return _load_environment(name, options)
    if not path.exists() and not path.suffix:
        raise ValueError(f"{name}: neither a file nor an environment id such as FrozenLake-v1")
    raise ValueError(
        f"{name}: unknown format '{path.suffix}' (known: {', '.join(_READERS)}, text also "
        "compressed as .gz, or an environment id such as FrozenLake-v1)"
    )


def save_model(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    """Write a model in the format of the path's suffix.

    Raises:
        ValueError: if the format is unknown, cannot hold the model, or the folder does not
            exist.
        OSError: if the file cannot be written; then nothing is left behind.
    """
    require_type(model, SafeMDP, "save_model")
    writer = _WRITERS.get(Path(path).suffix.lower())
    if writer is None:
        raise ValueError(f"{path}: models are written as {', '.join(_WRITERS)}")
    writer(model, path)


def _reader(path: Path) -> _Reader | None:
    """What reads the file, by its suffix; of compressed files by the suffix before ``.gz``."""
    plain = plain_path(path)
    suffix = plain.suffix.lower()
    return None if plain != path and suffix in _BINARY else _READERS.get(suffix)


def _load_environment(environment: Any, options: ModelOptions) -> SafeMDP:
    """By its table, or a MiniGrid by exploring it."""
    from dead_ends.io.gymnasium_table import environment_name, load_gymnasium, make_environment

    name = environment_name(environment)
    options.reject(name, "fail_label", "constants")
    env = make_environment(environment, options.arguments)
    if hasattr(env.unwrapped, "agent_dir") and not hasattr(env.unwrapped, "P"):
        from dead_ends.io.explore import explore_minigrid

        options.reject(name, "fail_states")
        return explore_minigrid(
            env,
            fail_if=options.fail_if,
            progress=sys.stderr.isatty(),
            seed=options.seed or 0,
        )
    options.reject(name, "seed")
    return load_gymnasium(
        environment,
        fail_states=options.fail_states,
        fail_if=options.fail_if,
        arguments=options.arguments,
        normalise=options.normalise,
    )


def _load_npz(path: Path, options: ModelOptions) -> SafeMDP:
    from dead_ends.io.npz import load_npz

    options.reject(
        str(path), "fail_label", "fail_states", "fail_if", "arguments", "constants", "seed"
    )
    return load_npz(path, normalise=options.normalise)


def _load_prism(path: Path, options: ModelOptions) -> SafeMDP:
    from dead_ends.io.prism import load_prism

    options.reject(str(path), "arguments", "constants", "seed")
    return load_prism(path, options.failure(), normalise=options.normalise)


def _load_drn(path: Path, options: ModelOptions) -> SafeMDP:
    from dead_ends.io.drn import load_drn

    options.reject(str(path), "arguments", "constants", "seed")
    return load_drn(path, options.failure(), normalise=options.normalise)


def _load_with_storm(path: Path, options: ModelOptions) -> SafeMDP:
    from dead_ends.io.stormpy_models import load_with_storm

    options.reject(str(path), "arguments", "seed")
    return load_with_storm(
        path, options.failure(), options.constants or "", normalise=options.normalise
    )


def _save_npz(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    from dead_ends.io.npz import save_npz

    save_npz(model, path)


def _save_prism(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    from dead_ends.io.prism import save_prism

    save_prism(model, path)


def _save_drn(model: SafeMDP, path: str | os.PathLike[str]) -> None:
    from dead_ends.io.drn import save_drn

    save_drn(model, path)


_Reader = Callable[[Path, ModelOptions], SafeMDP]
_READERS: dict[str, _Reader] = {
    ".npz": _load_npz,
    ".tra": _load_prism,
    ".drn": _load_drn,
    ".prism": _load_with_storm,
    ".nm": _load_with_storm,
    ".pm": _load_with_storm,
    ".jani": _load_with_storm,
    ".umb": _load_with_storm,
}
_BINARY = (".npz", ".umb")
"""Formats that compress by themselves."""

_WRITERS: dict[str, Callable[[SafeMDP, str | os.PathLike[str]], None]] = {
    ".npz": _save_npz,
    ".tra": _save_prism,
    ".drn": _save_drn,
}
