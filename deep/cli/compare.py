"""``python -m deep compare``: every method against the exact answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from deep.runs.folder import only_process
from deep.score.compare import CompareConfig, compare, summary_table


@dataclass(frozen=True)
class Compare:
    """Score every method against the exact answer of a task.

    Attributes:
        config: the comparison.
    """

    config: Annotated[CompareConfig, tyro.conf.arg(name="")]

    def run(self) -> None:
        """Train, score, and print the table."""
        with only_process(self.config.out):
            print(summary_table(compare(self.config)))
