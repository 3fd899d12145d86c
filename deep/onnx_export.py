"""A safety filter as an ONNX graph, to run it where there is no Python.

Inputs: ``observation`` (n, o), ``action`` (n, a), float32. Outputs: ``executed`` (n, a),
``intervened`` (n,) bool and ``critic`` (n,): Equation (behavior_correction).
"""

from __future__ import annotations

import os

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from dead_ends.io.atomic import atomic_path
from deep.perceptron import Layers
from deep.safety_filter import SafetyFilter

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
    """Write the filter as an ONNX model (opset 17)."""
    graph = _Graph()
    n = safety.normalisation
    seen = _powered(graph, "observation", n.observation_power)
    observation = _standardise(graph, seen, n.observation_centre, n.observation_scale)
    action = _standardise(graph, "action", n.action_centre, n.action_scale)

    x = graph.op("Concat", observation, action, axis=1)
    logits = graph.perceptron(x, safety.critic)  # (M, n, 1)
    critic = graph.op("Sigmoid", graph.worst(logits, len(safety.critic[0][0])))  # (n, 1)
    threshold = np.array([[safety.threshold]], dtype=np.float32)
    allowed = graph.op("Less", critic, graph.constant(threshold))

    outputs = graph.perceptron(observation, safety.recovery)
    bounds = [graph.constant(np.array([i])) for i in (0, safety.action_dim, 1)]
    mean = graph.op("Slice", outputs, bounds[0], bounds[1], bounds[2])
    reached = graph.affine(
        graph.op("Tanh", mean), (safety.reach,) * safety.action_dim, (0.0,) * safety.action_dim
    )
    ends = [graph.constant(np.array(x, dtype=np.float32)) for x in (-1, 1)]
    unit = graph.op("Clip", reached, *ends)
    recovery = graph.affine(unit, n.action_scale, n.action_centre)

    graph.op("Where", allowed, "action", recovery, output="executed")
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
    onnx.checker.check_model(model)
    with atomic_path(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
