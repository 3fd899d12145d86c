"""One thread a process: small networks are slower with more."""

from __future__ import annotations

import torch

torch.set_num_threads(1)
