"""The tutorial runs as it is printed, and keeps what it promises."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial_own_environment.md"


def test_the_tutorial_protects_the_lift(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", TUTORIAL.read_text(), re.DOTALL)
    assert len(blocks) == 4
    protecting = [line for line in blocks[2].splitlines() if line and "import" not in line]
    assert len(protecting) < 20
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(TUTORIAL), "exec"), names)
    assert names["crashes"](names["Lift"](), 50) >= 45
    assert names["crashes"](names["protected"], 50) == 0
    assert names["protected"].interventions > 0
    assert names["result"].health[0].fault is None
