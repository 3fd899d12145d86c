"""What tells a model from another: a digest of its transitions and ends."""

from __future__ import annotations

import hashlib

import numpy as np

from dead_ends.model.safe_mdp import SafeMDP

__all__ = ["model_digest"]

BLOCK = 1 << 18
"""States at a time, so that a large table is not held twice."""


def model_digest(model: SafeMDP) -> str:
    """SHA-256 of the transitions and the ends; names and rewards do not count."""
    kind = "deterministic" if model.is_deterministic else "stochastic"
    content = hashlib.sha256(f"{kind} {model.num_states} {model.num_actions}\n".encode())
    content.update(np.packbits(model.fail).tobytes() + np.packbits(model.terminal).tobytes())
    if model.is_deterministic:
        table = model.successors()
        for first in range(0, model.num_states, BLOCK):
            content.update(table[first : first + BLOCK].astype("<i4").tobytes())
    else:
        kernel = model.transitions()
        for array, form in ((kernel.indptr, "<i8"), (kernel.indices, "<i4"), (kernel.data, "<f8")):
            content.update(np.ascontiguousarray(array, dtype=form).data)
        content.update(" ".join(map(str, model.exact or ())).encode())
    return content.hexdigest()
