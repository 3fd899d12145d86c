"""Make the pictures of the README and the docs: ``python figures/make.py``.

Those of the counterexamples are made by the proofs: ``pytest proofs_check --update-report``.
"""

from __future__ import annotations

from pathlib import Path

from dead_ends.visualize import main

HERE = Path(__file__).parent

if __name__ == "__main__":
    for task in ("brake", "gridworld", "lifegate", "bridge"):
        picture, animation = HERE / f"{task}.png", HERE / f"{task}.gif"
        status = main([task, "--out", str(picture), "--gif", str(animation)])
        if status:
            raise SystemExit(status)
