"""Every public function that takes a model, values or the like names the type that it wants."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dead_ends
from dead_ends import SafeMDP, classify
from dead_ends.safety.policies import greedy_actions

TYPES = ("SafeMDP", "Values", "Labelling", "Certificate", "FilterTable", "ExpectedSurvival")
ELSEWHERE = (
    "certificates.certificate.save_certificate",
    "cli.page_answers.page_answers",
    "draw.animation.animate_episodes",
    "draw.page.draw_page",
    "draw.pictures.plot_boundaries",
    "draw.pictures.plot_map",
    "envs.safe_mdp_env.SafeMDPEnv",
    "io.labelling.save_labelling",
    "io.networkx_graph.to_networkx",
    "paper.conservatism",
    "paper.dea_rrl",
    "paper.dea_rrl_expectile",
    "paper.expectile_iteration",
    "paper.in_policy_set",
    "paper.plan",
    "paper.price_of_conservatism",
    "paper.rrl",
    "paper.rrl_msdp",
    "paper.verification.verify_statements",
    "safety.guarantees.episode_guarantee",
    "safety.guarantees.expected_survival",
    "safety.guarantees.one_step_risk",
    "safety.policies.greedy_actions",
)


def public() -> Iterator[tuple[str, Any]]:
    for name in dead_ends.__all__:
        if inspect.isfunction(getattr(dead_ends, name)):
            yield name, getattr(dead_ends, name)
    for path in ELSEWHERE:
        module, _, name = path.rpartition(".")
        yield name, getattr(import_module(f"dead_ends.{module}"), name)


def parameters() -> list[tuple[str, str, str]]:
    return [
        (name, parameter.name, kind)
        for name, function in public()
        for parameter in inspect.signature(function).parameters.values()
        if (kind := str(parameter.annotation).partition(" | ")[0]) in TYPES
        and name != "behavior_correction"
    ]


MODEL = SafeMDP.deterministic([[0, 1], [1, 1]], np.array([False, True]))


def given(kind: str) -> Any:
    return {
        "SafeMDP": lambda: MODEL,
        "Values": lambda: dead_ends.value_iteration(MODEL),
        "Labelling": lambda: classify(MODEL),
        "Certificate": lambda: dead_ends.certify(MODEL),
    }.get(kind, lambda: "anything")()


@pytest.mark.parametrize(("name", "wrong", "kind"), parameters())
def test_the_type_wanted_is_named(name: str, wrong: str, kind: str, tmp_path: Path) -> None:
    function = dict(public())[name]
    arguments = {
        parameter.name: given(str(parameter.annotation).partition(" | ")[0])
        for parameter in inspect.signature(function).parameters.values()
        if parameter.default is parameter.empty
    }
    if "path" in arguments:
        arguments["path"] = tmp_path / "model.npz"
    arguments[wrong] = np.zeros((2, 2))
    with pytest.raises(TypeError, match=rf"^{name} takes a {kind} \(.*\), not ndarray$"):
        function(**arguments)
    assert not list(tmp_path.iterdir())


def test_many_are_tried() -> None:
    assert len(parameters()) > 35


@pytest.mark.parametrize("wrong", [MODEL, classify(MODEL), None])
def test_a_critic_is_values_or_a_table(wrong: Any) -> None:
    with pytest.raises(TypeError, match=r"^Q must be Values or a table \(S, A\), not "):
        greedy_actions(wrong)
    with pytest.raises(ValueError, match=r"^Q\[0, 1\] is masked, and must be known$"):
        greedy_actions(np.ma.array(np.zeros((2, 2)), mask=[[0, 1], [0, 0]]))
