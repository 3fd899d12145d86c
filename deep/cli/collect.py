"""``python -m deep collect``: offline data from a task."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from deep.data.formats import write_hdf5
from deep.data.transitions import Transitions, summarise
from deep.pretraining.config import Mix
from deep.runs.folder import new_file
from deep.tasks import make_task
from deep.tasks.gym import NO_RULES, Rules
from deep.tasks.vectorised import GYM, REAL, check_rules
from deep.train.offline_data import collect_in_environments


@dataclass(frozen=True)
class Collect:
    """Collect offline data from a task.

    Attributes:
        task: the name of a task; "real:" before it means Safety-Gymnasium's own, "gym:" any
            Gymnasium environment of that id.
        out: the HDF5 file to write, a new one.
        seed: of the collection.
        rules: what an environment of "gym:" leaves open.
        mix: who acts, and what is kept.
    """

    task: str
    out: Path
    seed: int = 0
    rules: Annotated[Rules, tyro.conf.arg(name="")] = NO_RULES
    mix: Annotated[Mix, tyro.conf.arg(name="")] = field(default_factory=Mix)

    def run(self) -> None:
        """Collect, write, and say what there is."""
        with new_file(self.out):
            write_hdf5(data := self._data(), self.out)
        print(f"{self.out}: {summarise(data)}")

    def _data(self) -> Transitions:
        check_rules(self.task, self.rules)
        rng = np.random.default_rng(self.seed)
        if self.task.startswith((REAL, GYM)):
            return collect_in_environments(self.task, self.mix, self.rules, rng)
        return self.mix.collect(make_task(self.task), rng)
