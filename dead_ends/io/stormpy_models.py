"""Models in the PRISM language, JANI and UMB, built by Storm.

Storm, through its Python package stormpy (the extra ``storm``), explores the model; it is
handed over in Storm's own DRN format with all digits and read as :mod:`dead_ends.io.drn` reads
it. Labels, names of actions and variables of states are kept.
"""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dead_ends.io.drn import read_drn
from dead_ends.io.errors import located, optional_module
from dead_ends.io.explicit import Failure, explicit_model
from dead_ends.model import SafeMDP

__all__ = ["load_with_storm"]

ALL_DIGITS = 17


def load_with_storm(
    path: str | os.PathLike[str], failure: Failure | None = None, constants: str = ""
) -> SafeMDP:
    """The model in a PRISM-language, JANI or UMB file.

    Args:
        path: .prism, .nm, .pm; .jani; or .umb.
        failure: which states fail.
        constants: values of undefined constants, such as "N=4,K=2".

    Raises:
        ValueError: naming the file, with what Storm says about it.
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
        return explicit_model(read_drn(built), failure or Failure())


def _build(stormpy: Any, path: Path, constants: str) -> Any:
    suffix = path.suffix.lower()
    if suffix == ".umb":
        return stormpy.build_model_from_umb(str(path))
    if suffix == ".jani":
        program, _ = stormpy.parse_jani_model(str(path))
    else:
        program = stormpy.parse_prism_program(str(path))
    program, _ = stormpy.io.instantiate_constants(program, constants)
    options = stormpy.BuilderOptions()
    options.set_build_all_labels(True)
    options.set_build_choice_labels(True)
    options.set_build_state_valuations(True)
    return stormpy.build_model(program, options=options)
