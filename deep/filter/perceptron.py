"""Trained perceptrons in numpy: evaluated, rescaled, and kept in files without pickle.

What is deployed (safety filters, task policies) needs numpy and safetensors, not torch.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.io.atomic import atomic_path

__all__ = [
    "Floats",
    "Layers",
    "check_layers",
    "for_raw_inputs",
    "forward",
    "networks_from_bytes",
    "networks_to_bytes",
    "read_networks",
    "write_networks",
]

Floats = NDArray[np.float32]
Layers = tuple[tuple[Floats, Floats], ...]
"""(weights (in, out), biases (out,)) a layer, or with a leading axis for M networks."""


def forward(layers: Layers, x: Floats) -> Floats:
    """A perceptron with ReLU, or M of them at once if the layers have a leading axis."""
    *hidden, (last, bias) = layers
    for weights, biases in hidden:
        x = np.maximum(x @ weights + biases, 0)
    return np.asarray(x @ last + bias)


def for_raw_inputs(part: str, layers: Layers, centre: NDArray[Any], scale: NDArray[Any]) -> Layers:
    """The same function of x where ``layers`` take (x - centre) / scale.

    Raises:
        ValueError: naming the part, if single precision cannot hold its weights.
    """
    (weights, biases), *rest = layers
    scaled = weights.astype(np.float64) / scale[:, None]
    shifted = biases - centre @ scaled if biases.ndim == 1 else biases - (centre @ scaled)[:, None]
    with np.errstate(over="ignore"):
        first = scaled.astype(np.float32), shifted.astype(np.float32)
    if not all(np.isfinite(array).all() for array in first):
        raise ValueError(f"{part}: the scales are too small for its weights")
    return (first, *rest)


def check_layers(
    part: str, layers: Layers, inputs: int, outputs: int, *, several: bool = False
) -> None:
    """Refuse layers that do not map R^inputs to R^outputs, or hold a NaN.

    With ``several`` they are those of M networks, else of one.

    Raises:
        ValueError: naming the part.
    """
    if not layers:
        raise ValueError(f"{part}: there are no layers")
    for i, (weights, biases) in enumerate(layers):
        if weights.ndim not in (2, 3):
            raise ValueError(f"{part}: the weights of layer {i} have shape {weights.shape}")
        if (weights.ndim == 3) != several:
            found, wanted = ("one network", "several") if several else ("several networks", "one")
            raise ValueError(f"{part}: layer {i} holds {found}, expected {wanted}")
        if not len(weights):
            raise ValueError(f"{part}: layer {i} holds no network")
        for array in (weights, biases):
            if array.dtype != np.float32:
                raise ValueError(f"{part}: layer {i} is of type {array.dtype}, expected float32")
        outs = weights.shape[-1]
        if biases.shape != ((outs,) if weights.ndim == 2 else (len(weights), 1, outs)):
            raise ValueError(
                f"{part}: layer {i} has weights of shape {weights.shape} and biases of shape "
                f"{biases.shape}"
            )
    if (layers[0][0].shape[-2], layers[-1][0].shape[-1]) != (inputs, outputs):
        raise ValueError(
            f"{part}: the network maps R^{layers[0][0].shape[-2]} to R^{layers[-1][0].shape[-1]}, "
            f"expected R^{inputs} to R^{outputs}"
        )
    if any(
        a.shape[-1] != b.shape[-2] or a.shape[:-2] != b.shape[:-2]
        for (a, _), (b, _) in pairwise(layers)
    ):
        raise ValueError(f"{part}: the layers do not fit each other")
    if not all(np.isfinite(array).all() for layer in layers for array in layer):
        raise ValueError(f"{part}: the weights hold a NaN or an infinity")


def write_networks(
    path: str | os.PathLike[str], form: str, networks: dict[str, Layers], rest: dict[str, Any]
) -> None:
    """One safetensors file: arrays, and ``rest`` as JSON in its header under ``form``."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(networks_to_bytes(form, networks, rest))


def networks_to_bytes(form: str, networks: dict[str, Layers], rest: dict[str, Any]) -> bytes:
    """The content of the file that :func:`write_networks` writes."""
    from safetensors.numpy import save

    arrays = {
        f"{part}.{i}.{kind}": np.ascontiguousarray(array)
        for part, layers in networks.items()
        for i, layer in enumerate(layers)
        for kind, array in zip(("weights", "biases"), layer, strict=True)
    }
    return save(arrays, metadata={"networks": json.dumps({"format": form, **rest})})


def read_networks(
    path: str | os.PathLike[str], form: str, parts: Sequence[str]
) -> tuple[dict[str, Layers], dict[str, Any]]:
    """What :func:`write_networks` wrote: the networks named ``parts``, and the rest.

    Raises:
        ValueError: if the file is missing, broken, or of another form.
    """
    if not Path(path).is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        return networks_from_bytes(Path(path).read_bytes(), form, parts)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def networks_from_bytes(
    content: bytes, form: str, parts: Sequence[str]
) -> tuple[dict[str, Layers], dict[str, Any]]:
    """What :func:`networks_to_bytes` gave.

    Raises:
        ValueError: if the content is broken, or of another form.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        arrays = load(content)
    except SafetensorError as error:
        raise ValueError(f"not a safetensors file ({error})") from error
    except KeyError as error:  # a type that numpy has not
        raise ValueError(f"arrays of type {error}, expected F32") from error
    rest = _header(content)
    if rest.get("format") != form:
        raise ValueError(f"not a {form!r} file{_older(rest.get('format'), form)}")
    try:
        return {part: _layers(arrays, part) for part in parts}, rest
    except KeyError as error:
        raise ValueError(f"the file lacks {error}") from error


def _header(content: bytes) -> dict[str, Any]:
    """The JSON under "networks" in a safetensors header; {} where there is none."""
    length = int.from_bytes(content[:8], "little")
    metadata = json.loads(content[8 : 8 + length]).get("__metadata__") or {}
    try:
        rest = json.loads(metadata.get("networks", "{}"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"the header is damaged ({error})") from error
    return rest if isinstance(rest, dict) else {}


def _older(found: object, form: str) -> str:
    """What to do about a file of the same kind that an earlier version wrote."""
    name = form.rsplit(" ", 1)[0]
    same_kind = isinstance(found, str) and found != form and found.rsplit(" ", 1)[0] == name
    return f" but {found!r}, of another version: make it anew with this one" if same_kind else ""


def _layers(arrays: dict[str, Floats], part: str) -> Layers:
    count = sum(name.startswith(f"{part}.") for name in arrays) // 2
    return tuple(
        (arrays[f"{part}.{i}.weights"], arrays[f"{part}.{i}.biases"]) for i in range(count)
    )
