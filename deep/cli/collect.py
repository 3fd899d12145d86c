"""``python -m deep collect``: offline data from a task."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from deep.config import Mix
from deep.data import summarise
from deep.folder import new_file
from deep.formats import write_hdf5
from deep.tasks import make_task


@dataclass(frozen=True)
class Collect:
    """Collect offline data from a task.

    Attributes:
        task: the task's name.
        out: the HDF5 file to write, a new one.
        seed: of the collection.
        mix: who acts, and what is kept.
    """

    task: str
    out: Path
    seed: int = 0
    mix: Annotated[Mix, tyro.conf.arg(name="")] = field(default_factory=Mix)

    def run(self) -> None:
        """Collect, write, and say what there is."""
        with new_file(self.out):
            data = self.mix.collect(make_task(self.task), np.random.default_rng(self.seed))
            write_hdf5(data, self.out)
        print(f"{self.out}: {summarise(data)}")
