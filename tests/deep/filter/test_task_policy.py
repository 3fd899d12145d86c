"""Trained task policies: torch's mean in numpy, kept in files, used as SB3's models are."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch

from deep.data.normalisation import Normalisation
from deep.filter.perceptron import (
    Layers,
    check_layers,
    for_raw_inputs,
    forward,
    read_networks,
    write_networks,
)
from deep.filter.task_policy import FORMAT, TrainedPolicy
from deep.nn.networks import GaussianPolicy
from tests.deep.filters import random_filter

UNITS = Normalisation((1.0, -2.0, 0.0), (3.0, 0.5, 1.0), (5.0, 0.0), (2.0, 1.0))
NETWORK = GaussianPolicy((4,), 3, 2, (8, 6))


def layers() -> Layers:
    mlp = NETWORK.mlp
    with torch.no_grad():
        for bias in mlp.biases:
            bias += torch.linspace(-0.5, 0.5, bias.shape[-1])
    return tuple(
        (w[0].detach().numpy().copy(), b[0, 0].detach().numpy().copy())
        for w, b in zip(mlp.weights, mlp.biases, strict=True)
    )


def observations(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(0)
    return (rng.standard_normal((n, 3)) * [3, 0.5, 1] + [1, -2, 0]).astype(np.float32)


@pytest.fixture(scope="module")
def policy() -> TrainedPolicy:
    return TrainedPolicy(layers(), UNITS, "sac", 4)


def test_it_is_the_torch_policys_mean(policy: TrainedPolicy) -> None:
    raw = observations()
    scaled = torch.from_numpy((raw - np.float32([1, -2, 0])) / np.float32([3, 0.5, 1]))[None]
    with torch.no_grad():
        expected = NETWORK.mean_action(scaled)[0].numpy() * [2, 1] + [5, 0]
    found = policy.act(raw)
    assert found.dtype == np.float32
    assert found.shape == (200, 2)
    assert found == pytest.approx(expected, abs=1e-5)
    assert expected[:, 0].std() > 0.1
    assert policy.act(raw.astype(np.float64)) == pytest.approx(found, abs=1e-6)


def test_a_file_keeps_every_bit(policy: TrainedPolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    policy.save(path)
    again = TrainedPolicy.load(path)
    assert (again.normalisation, again.method, again.seed) == (UNITS, "sac", 4)
    assert np.array_equal(again.act(observations()), policy.act(observations()))
    assert len(again.layers) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["policy.safetensors"]
    again.save(tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


def test_it_predicts_as_a_stable_baselines_model(policy: TrainedPolicy) -> None:
    many = observations(5)
    action, state = policy.predict(many, deterministic=True)
    assert np.array_equal(action, policy.act(many))
    assert state is None
    one, kept = policy.predict(many[2], state=("memory",), episode_start=np.array([True]))
    assert one.shape == (2,)
    assert one == pytest.approx(action[2], abs=1e-6)
    assert kept == ("memory",)
    listed, _ = policy.predict(many[2].tolist())  # type: ignore[arg-type]  # what users do
    assert listed == pytest.approx(one, abs=1e-6)


def test_broken_files_are_refused(policy: TrainedPolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    with pytest.raises(ValueError, match="policy.safetensors: there is no such file$"):
        TrainedPolicy.load(path)
    path.write_text("no")
    with pytest.raises(ValueError, match="policy.safetensors: not a safetensors file "):
        TrainedPolicy.load(path)
    policy.save(path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match="policy.safetensors: not a safetensors file "):
        TrainedPolicy.load(path)
    random_filter().save(path)
    with pytest.raises(ValueError, match="not a 'dead-ends task policy 1' file$"):
        TrainedPolicy.load(path)
    rest = {"normalisation": asdict(UNITS), "method": "sac", "seed": 4}
    for name in rest:
        partial = {key: value for key, value in rest.items() if key != name}
        write_networks(path, FORMAT, {"policy": policy.layers}, partial)
        with pytest.raises(ValueError, match=f"safetensors: the task policy lacks '{name}'$"):
            TrainedPolicy.load(path)
    write_networks(path, FORMAT, {"other": policy.layers}, rest)
    with pytest.raises(ValueError, match="policy.safetensors: policy: there are no layers$"):
        TrainedPolicy.load(path)


def test_networks_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "networks.safetensors"
    networks = {"first": layers(), "second": layers()[::-1][:1]}
    write_networks(path, "a form", networks, {"note": [1, 2]})
    found, rest = read_networks(path, "a form", ("second", "first"))
    assert rest["note"] == [1, 2]
    for part, given in networks.items():
        for (w, b), (v, c) in zip(found[part], given, strict=True):
            assert np.array_equal(w, v)
            assert np.array_equal(b, c)
    with pytest.raises(ValueError, match="networks.safetensors: not a 'another' file$"):
        read_networks(path, "another", ("first",))
    lacking = {"first": layers()}
    write_networks(path, "a form", lacking | {"third.0": layers()[:1]}, {})
    with pytest.raises(ValueError, match="networks.safetensors: the file lacks 'third.0.weights'$"):
        read_networks(path, "a form", ("third",))


@pytest.mark.parametrize("members", [None, 3])
def test_layers_for_raw_inputs_are_the_same_function(members: int | None) -> None:
    rng = np.random.default_rng(1)
    lead = () if members is None else (members,)
    row = () if members is None else (1,)
    made: Layers = tuple(
        (
            rng.standard_normal((*lead, a, b)).astype(np.float32),
            rng.standard_normal((*lead, *row, b)).astype(np.float32),
        )
        for a, b in ((3, 8), (8, 2))
    )
    centre, scale = np.array([1.0, -2.0, 0.5]), np.array([3.0, 0.5, 1.0])
    x = rng.standard_normal((20, 3)).astype(np.float32)
    scaled = ((x - centre) / scale).astype(np.float32)
    found = forward(for_raw_inputs("policy", made, centre, scale), x)
    assert found.shape == (*lead, 20, 2)
    assert found == pytest.approx(forward(made, scaled), abs=1e-4)
    assert all(array.dtype == np.float32 for layer in made for array in layer)
    (w1, b1), (w2, b2) = made
    for m in range(members or 1):
        i = () if members is None else (m,)
        hidden = np.maximum(scaled @ w1[i] + b1[i], 0)
        assert found[i] == pytest.approx(hidden @ w2[i] + b2[i], abs=1e-4)


def test_layers_that_do_not_fit_are_refused() -> None:
    good = layers()
    check_layers("policy", good, 3, 4)
    with pytest.raises(ValueError, match="^policy: there are no layers$"):
        check_layers("policy", (), 3, 4)
    for inputs, outputs in ((2, 4), (3, 2)):
        message = rf"^policy: the network maps R\^3 to R\^4, expected R\^{inputs} to R\^{outputs}$"
        with pytest.raises(ValueError, match=message):
            check_layers("policy", good, inputs, outputs)
    with pytest.raises(ValueError, match="^policy: the layers do not fit each other$"):
        check_layers("policy", (good[0], good[2]), 3, 4)
    with pytest.raises(ValueError, match="^policy: layer 1 holds several networks, expected one$"):
        check_layers("policy", (good[0], *((w[None], b[None, None]) for w, b in good[1:])), 3, 4)
    (weights, biases), *others = good
    for shape in ((1, 8), (3,), ()):
        message = f"policy: layer 0 has weights of shape (3, 8) and biases of shape {shape}"
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            check_layers("policy", ((weights, np.zeros(shape, np.float32)), *others), 3, 4)
    with pytest.raises(ValueError, match=r"^policy: the weights of layer 0 have shape \(8,\)$"):
        check_layers("policy", ((weights[0], biases), *others), 3, 4)
    for place in (0, 1):
        bad = layers()
        bad[1][place][0] = np.nan if place else np.inf
        with pytest.raises(ValueError, match="^policy: the weights hold a NaN or an infinity$"):
            check_layers("policy", bad, 3, 4)
    with pytest.raises(ValueError, match=r"maps R\^3 to R\^4, expected R\^3 to R\^2$"):
        TrainedPolicy(good, Normalisation.identity(3, 1), "sac", 0)
