"""Models in the PRISM language, JANI and UMB, built by Storm.

Storm, through its Python package stormpy (the extra ``storm``), explores the model; it is
handed over in Storm's own DRN format with all digits and read as :mod:`dead_ends.io.drn` reads
it. Labels, names of actions and variables of states are kept; labels that no state carries too.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.drn import read_drn
from dead_ends.io.errors import located, optional_module
from dead_ends.io.explicit import Failure, explicit_model
from dead_ends.model import SafeMDP

__all__ = ["load_with_storm"]

ALL_DIGITS = 17


def load_with_storm(
    path: str | os.PathLike[str],
    failure: Failure | None = None,
    constants: str = "",
    *,
    normalise: bool = False,
) -> SafeMDP:
    """The model in a PRISM-language, JANI or UMB file.

    Args:
        path: .prism, .nm, .pm; .jani; or .umb.
        failure: which states fail.
        constants: values of undefined constants, such as "N=4,K=2".
        normalise: as in :meth:`dead_ends.SafeMDP.stochastic`.

    Raises:
        ValueError: naming the file, with what Storm says about it, or the constants without values.
        OSError: if there is no such file.
        MissingDependencyError: if stormpy is not installed.
    """
    source = Path(path)
    source.open("rb").close()  # the system's own words if it cannot be read
    stormpy = optional_module("stormpy", f"a {source.suffix} file", "storm")
    with located(path), TemporaryDirectory() as folder:
        built = Path(folder) / "model.drn"
        try:
            model = _build(stormpy, source, constants)
            kind = str(model.model_type).rpartition(".")[2]
            if kind not in ("MDP", "DTMC"):
                raise ValueError(f"the model is of type {kind}; MDP and DTMC can be read")
            options = stormpy.io.DirectEncodingExporterOptions()
            options.output_precision = ALL_DIGITS
            stormpy.io.export_to_drn(model, str(built), options=options)
        except (RuntimeError, stormpy.exceptions.StormError) as error:
            raise ValueError(str(error)) from None
        variables = _variables(model)
        explicit = replace(
            read_drn(built, normalise=normalise),
            labels=_labels(model),
            variables=variables,
            state_names=_state_names(variables),
        )
        return explicit_model(explicit, failure or Failure(), normalise)


def _labels(model: Any) -> dict[str, NDArray[np.bool_]]:
    """All labels that are declared; a DRN file has those that a state carries."""
    labels = {}
    for name in sorted(model.labeling.get_labels()):
        labels[name] = np.zeros(model.nr_states, dtype=np.bool_)
        labels[name][list(model.labeling.get_states(name))] = True
    return labels


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


def _build(stormpy: Any, path: Path, constants: str) -> Any:
    suffix = path.suffix.lower()
    if suffix == ".umb":
        return stormpy.build_model_from_umb(str(path))
    if suffix == ".jani":
        program, _ = stormpy.parse_jani_model(str(path))
    else:
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
