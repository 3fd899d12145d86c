"""Models from and to networkx graphs.

Nodes are states, edges transitions. Attributes of an edge:

* ``action``: any label; edges without it get actions of their own, numbered in order;
* ``probability``: needed where an action of a state has several edges; floats or Fractions.

Attributes of a node: ``fail``, ``terminal``, ``initial``, all bool. A node without edges that
does not fail is a harmless end. The graph's attribute ``estimate``, if true, says that the model is
an estimate (see :class:`dead_ends.SafeMDP`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from dead_ends.io.transitions import Condition, Transitions, build_model
from dead_ends.model.safe_mdp import SafeMDP, require_type

__all__ = ["from_networkx", "to_networkx"]


def from_networkx(
    graph: Any,
    fail: Iterable[Hashable] | None = None,
    *,
    fail_if: Condition | None = None,
    normalise: bool = False,
) -> SafeMDP:
    """The model of a DiGraph or MultiDiGraph.

    States are numbered in the order of the nodes and named after them; actions in the order
    in which their labels first appear.

    Args:
        graph: with the attributes described above.
        fail: the nodes that fail; without it and ``fail_if`` those with the attribute ``fail``.
        fail_if: a condition on the numbers (s, a, s').
        normalise: as in :meth:`dead_ends.SafeMDP.stochastic`.

    Raises:
        ValueError: naming the node, and the action, at fault.
    """
    if not graph.is_directed():
        raise ValueError("the graph must be directed")
    number = {node: state for state, node in enumerate(graph.nodes)}
    if not number:
        raise ValueError("the graph has no nodes")
    edges = _edges(graph)
    labels = {label: action for action, label in enumerate(dict.fromkeys(e[1] for e in edges))}
    probability = _probabilities(edges)
    fails = _fail_mask(graph, number, fail, fail_if is None)
    continues = np.zeros(len(number), dtype=np.bool_)
    continues[[number[edge[0]] for edge in edges]] = True
    initial = _flags(graph, "initial")
    transitions = Transitions(
        source=np.array([number[edge[0]] for edge in edges], dtype=np.int64),
        action=np.array([labels[edge[1]] for edge in edges], dtype=np.int64),
        target=np.array([number[edge[2]] for edge in edges], dtype=np.int64),
        probability=probability,
        fail=fails,
        terminal=(_flags(graph, "terminal") | ~continues) & ~fails,
        num_actions=max(1, len(labels)),
        initial=initial / initial.sum() if initial.any() else None,
        state_names=tuple(str(node) for node in graph.nodes),
        action_names=tuple(str(label) for label in labels) or None,
    )
    model = build_model(transitions, fail_if, normalise=normalise)
    return replace(model, estimate=bool(graph.graph.get("estimate")))


def to_networkx(model: SafeMDP) -> Any:
    """A MultiDiGraph with the states' numbers as nodes; :func:`from_networkx` reads it.

    Nodes have the attributes ``name`` (if states have names), ``fail``, ``terminal`` and
    ``initial``; edges ``action`` (the name, or the number) and ``probability``, a Fraction if
    the model is exact. Fail and terminal states have no edges.
    """
    require_type(model, SafeMDP, "to_networkx")
    graph: Any = nx.MultiDiGraph(estimate=True) if model.estimate else nx.MultiDiGraph()
    initial = np.zeros(model.num_states) if model.initial is None else model.initial
    for state in range(model.num_states):
        graph.add_node(
            state,
            fail=bool(model.fail[state]),
            terminal=bool(model.terminal[state]),
            initial=bool(initial[state] > 0),
        )
        if model.state_names is not None:
            graph.nodes[state]["name"] = model.state_names[state]
    kernel = model.transitions()
    row = np.repeat(np.arange(kernel.shape[0]), np.diff(kernel.indptr)).tolist()
    probabilities = model.exact or kernel.data.tolist()
    names = model.action_names or range(model.num_actions)
    for choice, target, p in zip(row, kernel.indices.tolist(), probabilities, strict=True):
        state, action = divmod(choice, model.num_actions)
        if not model.terminal[state]:
            graph.add_edge(state, target, action=names[action], probability=p)
    return graph


def _edges(graph: Any) -> list[tuple[Any, Any, Any, Any]]:
    """(node, action's label, successor, probability or None)."""
    unlabelled: Counter[Any] = Counter()
    edges = []
    for node, successor, data in graph.edges(data=True):
        label = data.get("action")
        if label is None:
            label = unlabelled[node]
            unlabelled[node] += 1
        edges.append((node, label, successor, data.get("probability")))
    return edges


def _probabilities(edges: list[tuple[Any, Any, Any, Any]]) -> NDArray[Any]:
    size = Counter((node, label) for node, label, _, _ in edges)
    values = []
    for node, label, _, probability in edges:
        if probability is None:
            if size[node, label] > 1:
                raise ValueError(
                    f"node {node!r}, action {label!r}: {size[node, label]} edges need the "
                    "attribute 'probability'"
                )
            probability = 1
        if not isinstance(probability, int | float | np.number | Fraction):
            raise ValueError(
                f"node {node!r}, action {label!r}: {probability!r} is not a probability"
            )
        values.append(probability)
    exact = any(isinstance(value, Fraction) for value in values)
    return np.array(values, dtype=object if exact else np.float64)


def _fail_mask(
    graph: Any, number: dict[Any, int], fail: Iterable[Hashable] | None, required: bool
) -> NDArray[np.bool_]:
    if fail is None:
        mask = _flags(graph, "fail")
        if required and not any("fail" in data for _, data in graph.nodes(data=True)):
            raise ValueError("which nodes fail? Name them, or give nodes the attribute 'fail'")
        return mask
    mask = np.zeros(len(number), dtype=np.bool_)
    for node in fail:
        if node not in number:
            raise ValueError(f"fail: {node!r} is not a node")
        mask[number[node]] = True
    return mask


def _flags(graph: Any, name: str) -> NDArray[np.bool_]:
    values = [data.get(name, False) for _, data in graph.nodes(data=True)]
    bad = [
        node
        for node, value in zip(graph.nodes, values, strict=True)
        if not isinstance(value, bool | np.bool_)
    ]
    if bad:
        raise ValueError(f"node {bad[0]!r}: the attribute '{name}' must be true or false")
    return np.array(values, dtype=np.bool_)
