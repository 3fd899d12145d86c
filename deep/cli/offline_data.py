"""``python -m deep offline-data``: the paper's offline data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deep.data.formats import write_hdf5
from deep.data.transitions import summarise
from deep.runs.folder import new_file
from deep.train.offline_data import offline_data, training_run


@dataclass(frozen=True)
class OfflineData:
    """The paper's offline data: a run's replay buffer and random actions, before violations.

    Attributes:
        run_folder: a finished run of SAC with ``--keep-replay``.
        out: the HDF5 file to write, a new one.
        seed: whose replay, and of the random actions.
        random: transitions with uniform random actions, before the filter.
        keep: only so many steps before each violation; None: everything.
    """

    run_folder: Path
    out: Path
    seed: int
    random: int = 1_000_000
    keep: int | None = 100

    def run(self) -> None:
        """Put them together, write, and say what there is."""
        task = training_run(self.run_folder).task
        rng = np.random.default_rng(self.seed)
        with new_file(self.out):
            data = offline_data(task, self.run_folder, self.seed, self.random, self.keep, rng)
            write_hdf5(data, self.out)
        print(f"{self.out}: {summarise(data)}")
