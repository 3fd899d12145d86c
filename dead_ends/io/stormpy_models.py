"""Models in the PRISM language, JANI and UMB, built by Storm.

Storm, through its Python package stormpy (the extra ``storm``), explores the model. Transitions,
labels, names of actions and variables of states are taken from its own tables, not from a text
that it writes: so whatever stands in a name is kept, and probabilities to the last bit.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.compressed import plain_path, read_bytes
from dead_ends.io.errors import located, optional_module
from dead_ends.io.explicit import (
    INTERVALS,
    PARAMETRIC,
    Explicit,
    Failure,
    Integers,
    Mask,
    explicit_model,
    unreadable_kind,
)
from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["load_with_storm"]

_FIRST_WORD = re.compile(r"(?:\s|//[^\n]*(?:\n|$))*(\w+)")
"""A PRISM-language file begins with the kind of its model, after comments."""


def load_with_storm(
    path: str | os.PathLike[str],
    failure: Failure | None = None,
    constants: str = "",
    *,
    normalise: bool = False,
) -> SafeMDP:
    """The model in a PRISM-language, JANI or UMB file.

    Args:
        path: .prism, .nm, .pm; .jani; or .umb; the former two also compressed, as .prism.gz.
        failure: which states fail.
        constants: values of undefined constants, such as "N=4,K=2".
        normalise: as in :meth:`dead_ends.SafeMDP.stochastic`.

    Raises:
        ValueError: naming the file, with what Storm says about it, or the constants without values.
        OSError: if there is no such file.
        MissingDependencyError: if stormpy is not installed.
    """
    source, plain = Path(path), plain_path(path)
    source.open("rb").close()  # the system's own words if it cannot be read
    stormpy = optional_module("stormpy", f"a {plain.suffix} file", "storm")
    content = read_bytes(source) if plain != source else None
    with located(path), TemporaryDirectory() as folder:
        if content is not None:
            source = Path(folder) / plain.name
            source.write_bytes(content)
        try:
            explicit = _explicit(_build(stormpy, source, constants))
        except (RuntimeError, stormpy.exceptions.StormError) as error:
            raise ValueError(" ".join(str(error).split())) from None
        return explicit_model(explicit, failure or Failure(), normalise)


def _build(stormpy: Any, path: Path, constants: str) -> Any:
    """Storm's model.

    Raises:
        ValueError: naming the kind of the model if it is neither an MDP nor a DTMC.
    """
    if path.suffix.lower() == ".umb":
        model = stormpy.build_model_from_umb(str(path))
    else:
        model = _build_symbolic(stormpy, path, constants)
    kind = _word(model.model_type)
    if kind not in ("MDP", "DTMC"):
        unknown = f"the model is of type {kind}; MDPs and DTMCs can be read"
        raise ValueError(unreadable_kind(kind) or unknown)
    if model.supports_uncertainty:
        raise ValueError(INTERVALS)
    if model.supports_parameters:
        raise ValueError(PARAMETRIC)
    return model


def _build_symbolic(stormpy: Any, path: Path, constants: str) -> Any:
    """Explore a program; before that, which may take long, see what kind it is."""
    if path.suffix.lower() == ".jani":
        program, _ = stormpy.parse_jani_model(str(path))
        _check_kind(_word(program.model_type))
    else:
        found = _FIRST_WORD.match(path.read_text(encoding="utf-8", errors="replace"))
        _check_kind(found[1] if found else "")
        # Simplified, a program loses the variables that never change, and conditions may use them.
        program = stormpy.parse_prism_program(str(path), simplify=False)
    program, _ = stormpy.io.instantiate_constants(program, constants)
    names = [constant.name for constant in program.constants if not constant.defined]
    if names:
        wanted = ",".join(f"{name}=..." for name in names)
        raise ValueError(f"constants without a value; give them (--constants {wanted})")
    options = stormpy.BuilderOptions()
    options.set_build_all_labels(True)
    options.set_build_choice_labels(True)
    options.set_build_state_valuations(True)
    return stormpy.build_model(program, options=options)


def _word(kind: Any) -> str:
    """The last word of a constant of Storm, such as MDP of ModelType.MDP."""
    return str(kind).rpartition(".")[2]


def _check_kind(kind: str) -> None:
    if refusal := unreadable_kind(kind):
        raise ValueError(refusal)


def _explicit(model: Any) -> Explicit:
    """Storm's tables as ours. Its rows are the choices of all states, in order."""
    matrix, states = model.transition_matrix, model.nr_states
    first = (
        model.nondeterministic_choice_indices
        if model.is_nondeterministic_model
        else range(states + 1)
    )
    begins = np.fromiter(first, np.int64, states + 1)
    lengths = np.fromiter((len(matrix.get_row(row)) for row in range(matrix.nr_rows)), np.int64)
    row = np.repeat(np.arange(matrix.nr_rows), lengths)
    source = np.searchsorted(begins, row, side="right") - 1
    names, name = _choice_names(model)
    variables = _variables(model)
    return Explicit(
        source=source,
        choice=row - begins[source],
        target=np.fromiter((entry.column for entry in matrix), np.int64, matrix.nr_entries),
        probability=_probabilities(model),
        num_states=states,
        labels=_labels(model),
        choice_names=names,
        choice_name=name[row],
        state_names=_state_names(variables),
        variables=variables,
    )


def _probabilities(model: Any) -> NDArray[Any]:
    matrix = model.transition_matrix
    if not model.is_exact:
        return np.fromiter((entry.value for entry in matrix), np.float64, matrix.nr_entries)
    values = [Fraction(str(entry.value)) for entry in matrix]
    return np.array([*values, None], dtype=object)[:-1]  # None: never an array of their parts


def _labels(model: Any) -> dict[str, Mask]:
    """All labels that are declared, with the states that carry them."""
    labels = {}
    for name in sorted(model.labeling.get_labels()):
        labels[name] = np.zeros(model.nr_states, dtype=np.bool_)
        labels[name][list(model.labeling.get_states(name))] = True
    return labels


def _choice_names(model: Any) -> tuple[list[str], Integers]:
    """The different names of choices, and which of them each row has; -1 for none."""
    names: list[str] = []
    which = np.full(model.nr_choices, -1, dtype=np.int64)
    if not model.has_choice_labeling():
        return names, which
    labeling = model.choice_labeling
    for name in sorted(labeling.get_labels()):
        rows = np.fromiter(labeling.get_choices(name), np.int64)
        if (which[rows] >= 0).any():
            row = int(rows[np.argmax(which[rows] >= 0)])
            raise ValueError(f"choice {row} has two names, '{names[which[row]]}' and '{name}'")
        if len(rows):
            which[rows] = len(names)
            names.append(name)
    return names, which


def _variables(model: Any) -> dict[str, NDArray[Any]]:
    """The values that bool and number variables have in each state."""
    if not model.has_state_valuations():
        return {}
    valuations = model.state_valuations
    columns = {
        variable.name: valuations.get_values_states(variable)
        for variable in valuations.get_all_variables()
        if not variable.has_string_type()
    }
    return {
        name: np.array(values, dtype=None if isinstance(values[0], bool | int) else np.float64)
        for name, values in sorted(columns.items())
    }


def _state_names(variables: Mapping[str, NDArray[Any]]) -> tuple[str, ...] | None:
    """States are called by their variables: "!open, x=1" (Storm's own comments lack true ones)."""
    if not variables:
        return None
    columns = [
        [name if value else f"!{name}" for value in values.tolist()]
        if values.dtype == np.bool_
        else [f"{name}={value}" for value in values.tolist()]
        for name, values in variables.items()
    ]
    return tuple(", ".join(row) for row in zip(*columns, strict=True))
