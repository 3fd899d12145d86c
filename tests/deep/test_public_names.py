"""Every public name has an example that runs, about one log and one environment."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import deep


class Car(gymnasium.Env[Any, Any]):
    """The environment of the examples: a gap that shrinks by the action, 3 at first."""

    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        super().reset(**options)
        self.gap = np.array([3.0], dtype=np.float32)
        return self.gap, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.gap = self.gap - action
        return self.gap, 0.0, bool(self.gap[0] <= 0), False, {}


def examples(name: str) -> list[doctest.DocTest]:
    value = getattr(deep, name)
    finder = doctest.DocTestFinder(recurse=False)
    return [test for test in finder.find(value, name, globs={}) if test.examples]


def names() -> dict[str, Any]:
    """What an example may use: deep's names, numpy, Gymnasium, a log, an environment."""
    known = {name: getattr(deep, name) for name in deep.__all__}
    known |= {"np": np, "gymnasium": gymnasium, "env": Car()}
    (log,) = examples("Transitions")
    exec("".join(example.source for example in log.examples), known)
    return known


@pytest.mark.parametrize("name", deep.__all__)
def test_every_public_name_has_an_example_that_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    (test,) = examples(name)
    test.globs = names()
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    runner.run(test)
    assert runner.summarize() == (0, len(test.examples))
