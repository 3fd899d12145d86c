"""What Adam's first step tells: against which slope it went."""

from __future__ import annotations

import torch
from torch import Tensor, nn


def went_down(loss: Tensor, before: nn.Module, after: nn.Module, rate: float) -> bool:
    """Whether ``after`` is ``before``, of which the loss was made, one first step of Adam later.

    That step is the rate against the gradient's sign, wherever the gradient is not tiny.
    """
    parameters = list(before.parameters())
    slopes = torch.autograd.grad(loss, parameters)
    for old, new, slope in zip(parameters, after.parameters(), slopes, strict=True):
        clear = slope.abs() > 1e-4
        step = -rate * slope.sign()
        if not clear.any() or not torch.allclose((new - old)[clear], step[clear], rtol=1e-2):
            return False
    return True
