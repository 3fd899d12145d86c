"""A learner's whole state in one safetensors file: networks, optimizers, updates done."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from dead_ends.io.atomic import atomic_path

__all__ = ["load_checkpoint", "save_checkpoint"]


class Trained(Protocol):
    """Anything with networks and optimizers."""

    def state_dict(self) -> dict[str, Any]:
        """The networks' tensors, as of a torch module."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> Any:
        """Put them back."""

    @property
    def optimizers(self) -> tuple[torch.optim.Optimizer, ...]:
        """In a fixed order."""


def save_checkpoint(
    learner: Trained, update: int, path: str | os.PathLike[str], rest: str = ""
) -> None:
    """Write the state after ``update`` updates; the file is whole or as it was before.

    ``rest`` is kept beside it: what else the run needs to go on, as text.
    """
    tensors = {f"network.{name}": tensor for name, tensor in learner.state_dict().items()}
    for i, optimizer in enumerate(learner.optimizers):
        for j, state in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{i}.{j}.{name}": tensor for name, tensor in state.items()}
    contiguous = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        save_file(contiguous, temporary, metadata={"update": str(update), "rest": rest})


def load_checkpoint(learner: Trained, path: str | os.PathLike[str]) -> tuple[int, str]:
    """Put the state back into a learner of the same settings; the updates done, the rest.

    Raises:
        ValueError: if the file is missing, broken, or belongs to other settings.
    """
    if not Path(path).is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        with safe_open(Path(path), framework="pt") as file:
            metadata = file.metadata() or {}
            update, rest = int(metadata["update"]), metadata["rest"]
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (it cannot be iterated)
        networks = {
            name.removeprefix("network."): tensor
            for name, tensor in tensors.items()
            if name.startswith("network.")
        }
        learner.load_state_dict(networks)
    except (SafetensorError, KeyError, RuntimeError) as error:
        raise ValueError(f"{path}: not a checkpoint of this run ({error})") from error
    for i, optimizer in enumerate(learner.optimizers):
        state = optimizer.state_dict()
        state["state"] = _optimizer_state(tensors, i)
        optimizer.load_state_dict(state)
    return update, rest


def _optimizer_state(tensors: dict[str, Tensor], optimizer: int) -> dict[int, dict[str, Tensor]]:
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        kind, *place = name.split(".")
        if kind == "optimizer" and int(place[0]) == optimizer:
            state.setdefault(int(place[1]), {})[place[2]] = torch.clone(tensor)
    return state
