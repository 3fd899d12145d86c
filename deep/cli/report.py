"""``python -m deep report``: tables and pictures of a study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from deep.study.report import report


@dataclass(frozen=True)
class Report:
    """Tables and pictures from a study's saved runs, whatever has finished.

    Attributes:
        study: the study's folder.
        out: the folder that gets report.md and its parts.
    """

    study: Path
    out: Path

    def run(self) -> None:
        """Read, write, and say how much there was."""
        found = report(self.study, self.out)
        print(
            f"{self.out / 'report.md'}: {len(found.runs)} finished runs, "
            f"{len(found.unfinished)} unfinished"
        )
