"""A safety filter as an ONNX graph, to run it where there is no Python.

Inputs: ``observation`` (n, o), ``action`` (n, a), float32, in the environment's units.
Outputs: ``executed`` (n, a), ``intervened`` (n,) bool and ``critic`` (n,): Equation
(behavior_correction), with the rules of :mod:`deep.filter.safety_filter` for what is not finite or
out of bounds. The model's metadata hold ``action_low``, ``action_high``,
``observation_low``, ``observation_high`` (JSON lists: what the filter was trained on) and
``threshold``; whoever runs it compares them with the machine's own.
"""

from __future__ import annotations

import json
import os

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from dead_ends.io.atomic import atomic_path
from deep.filter.perceptron import Layers
from deep.filter.safety_filter import SafetyFilter, inner_ends

__all__ = ["export_onnx"]

OPSET = 17
IR_VERSION = 8


class _Graph:
    """Nodes and constants under fresh names."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: NDArray[np.generic]) -> str:
        name = f"constant{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, order="C"), name))
        return name

    def op(self, kind: str, *inputs: str, output: str = "", axis: int | None = None) -> str:
        name = output or f"{kind.lower()}{len(self.nodes)}"
        node = helper.make_node(kind, list(inputs), [name])
        if axis is not None:
            node.attribute.append(helper.make_attribute("axis", axis))
        self.nodes.append(node)
        return name

    def affine(self, x: str, factor: tuple[float, ...], offset: tuple[float, ...]) -> str:
        """x * factor + offset."""
        scaled = self.op("Mul", x, self.constant(np.array(factor, dtype=np.float32)))
        return self.op("Add", scaled, self.constant(np.array(offset, dtype=np.float32)))

    def infinite(self, x: str) -> str:
        """Where x is a NaN or an infinity."""
        return self.op("Or", self.op("IsNaN", x), self.op("IsInf", x))

    def any(self, mask: str, axis: int) -> str:
        """Whether ``mask`` holds anywhere along the axis, which stays with length 1."""
        number = self.op("Cast", mask)
        self.nodes[-1].attribute.append(helper.make_attribute("to", TensorProto.FLOAT))
        found = self.op("ReduceMax", number)
        self.nodes[-1].attribute.append(helper.make_attribute("axes", [axis]))
        return self.op("Greater", found, self.constant(np.array(0, dtype=np.float32)))

    def within(self, x: str, ends: tuple[NDArray[np.float32], NDArray[np.float32]]) -> str:
        """x moved to the nearest end where it lies outside."""
        low, high = ends
        return self.op("Min", self.op("Max", x, self.constant(low)), self.constant(high))

    def perceptron(self, x: str, layers: Layers) -> str:
        for i, (weights, biases) in enumerate(layers):
            x = self.op("MatMul", x, self.constant(weights))
            x = self.op("Add", x, self.constant(biases))
            if i < len(layers) - 1:
                x = self.op("Relu", x)
        return x

    def worst(self, members: str, count: int) -> str:
        """The largest of ``count`` members along the first axis."""
        parts = [
            self.op("Gather", members, self.constant(np.array(i)), axis=0) for i in range(count)
        ]
        return self.op("Max", *parts)


def _standardise(graph: _Graph, x: str, centre: tuple[float, ...], scale: tuple[float, ...]) -> str:
    shifted = graph.op("Sub", x, graph.constant(np.array(centre, dtype=np.float32)))
    return graph.op("Div", shifted, graph.constant(np.array(scale, dtype=np.float32)))


def _powered(graph: _Graph, x: str, power: tuple[float, ...]) -> str:
    """x ** power where the power is not 1, of what is not negative."""
    exponents = np.array(power, dtype=np.float32)
    if (exponents == 1).all():
        return x
    positive = graph.op("Pow", graph.op("Relu", x), graph.constant(exponents))
    return graph.op("Where", graph.constant(exponents != 1), positive, x)


def export_onnx(safety: SafetyFilter, path: str | os.PathLike[str]) -> None:
    """Write the filter as an ONNX model (opset 17).

    >>> safety = pretrain(log, horizon=3, updates=3, quiet=True).filters[0]
    >>> export_onnx(safety, "filter.onnx")
    """
    graph = _Graph()
    n = safety.normalisation
    ends = inner_ends(safety.actions)
    zero, one = (graph.constant(np.array(x, dtype=np.float32)) for x in (0, 1))
    first = graph.constant(np.array([0]))

    seen = _powered(graph, "observation", n.observation_power)
    lost = graph.op("Or", graph.infinite("observation"), graph.infinite(seen))
    scaled = _standardise(graph, seen, n.observation_centre, n.observation_scale)
    observation = graph.op("Where", lost, zero, scaled)  # at its mean
    proposed = graph.within("action", ends)
    action = _standardise(graph, proposed, n.action_centre, n.action_scale)

    x = graph.op("Concat", observation, action, axis=1)
    logits = graph.perceptron(x, safety.critic)  # (M, n, 1)
    judged = graph.op("Sigmoid", graph.worst(logits, len(safety.critic[0][0])))  # (n, 1)
    missing = graph.op("Or", graph.any(lost, axis=1), graph.any(graph.infinite("action"), axis=1))
    overflow = graph.op("Squeeze", graph.any(graph.infinite(logits), axis=0), first)
    critic = graph.op("Where", graph.op("Or", missing, overflow), one, judged)
    threshold = np.array([[safety.threshold]], dtype=np.float32)
    allowed = graph.op("Less", critic, graph.constant(threshold))

    outputs = graph.perceptron(observation, safety.recovery)
    cut = [graph.constant(np.array([i])) for i in (0, safety.action_dim, 1)]
    mean = graph.op("Slice", outputs, cut[0], cut[1], cut[2])
    bent = graph.op("Where", graph.op("IsNaN", mean), zero, graph.op("Tanh", mean))
    reached = graph.affine(bent, (safety.reach,) * safety.action_dim, (0.0,) * safety.action_dim)
    unit = graph.op("Clip", reached, graph.constant(np.array(-1, dtype=np.float32)), one)
    recovery = graph.within(graph.affine(unit, n.action_scale, n.action_centre), ends)

    graph.op("Where", allowed, proposed, recovery, output="executed")
    last = graph.constant(np.array([1]))
    graph.op("Squeeze", graph.op("Not", allowed), last, output="intervened")
    graph.op("Squeeze", critic, last, output="critic")
    _write(graph, safety, path)


def _write(graph: _Graph, safety: SafetyFilter, path: str | os.PathLike[str]) -> None:
    def port(name: str, kind: int, *width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, kind, ["n", *width])

    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "behavior_correction",
            [
                port("observation", TensorProto.FLOAT, safety.observation_dim),
                port("action", TensorProto.FLOAT, safety.action_dim),
            ],
            [
                port("executed", TensorProto.FLOAT, safety.action_dim),
                port("intervened", TensorProto.BOOL),
                port("critic", TensorProto.FLOAT),
            ],
            initializer=graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    ranges = {"action": safety.actions, "observation": safety.observations}
    ends = {f"{k}_{end}": getattr(b, end) for k, b in ranges.items() for end in ("low", "high")}
    told = ends | {"threshold": safety.threshold}
    helper.set_model_props(model, {name: json.dumps(value) for name, value in told.items()})
    onnx.checker.check_model(model)
    with atomic_path(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
