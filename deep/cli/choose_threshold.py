"""``python -m deep choose-threshold``: methods made comparably safe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from deep.runs.folder import new_file
from deep.study.threshold_choice import choose_threshold, write_choice


@dataclass(frozen=True)
class ChooseThreshold:
    """Choose epsilon, or WCSAC's cost limit, so that the methods are comparably safe.

    Attributes:
        run_folder: a finished training run with another threshold for each seed.
        baseline: a training run of SAC on the same task.
        out: the JSON file to write, a new one.
        share: the largest candidate with at most this share of SAC's violations is taken.
    """

    run_folder: Path
    baseline: Path
    out: Path
    share: float = 0.05

    def run(self) -> None:
        """Choose, write, and say why."""
        with new_file(self.out):
            choice = choose_threshold(self.run_folder, self.baseline, self.share)
            write_choice(choice, self.out)
        held = "" if choice.met else " (none is as safe as that)"
        print(f"{self.out}: {choice.threshold:g}, {choice.allowed:.1f} violations allowed{held}")
