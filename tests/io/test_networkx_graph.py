"""networkx graphs, both ways."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import networkx as nx
import numpy as np
import pytest

from dead_ends.io.networkx_graph import from_networkx, to_networkx
from dead_ends.labels.classification import classify
from dead_ends.model.safe_mdp import SafeMDP


def house() -> Any:
    """The door may be left or passed; behind it all ways lead down."""
    graph = nx.DiGraph()
    graph.add_node("pit", fail=True)
    graph.add_node("door", initial=True)
    graph.add_edge("door", "door", action="wait")
    graph.add_edge("door", "hall", action="go")
    graph.add_edge("hall", "edge", action="go")
    graph.add_edge("edge", "pit", action="go")
    graph.add_edge("door", "garden", action="leave")
    return graph


def test_a_graph_with_labels() -> None:
    model = from_networkx(house())
    assert model.state_names == ("pit", "door", "hall", "edge", "garden")
    assert model.action_names == ("wait", "go", "leave")
    assert model.terminal.tolist() == [False] * 4 + [True]
    assert model.initial is not None
    assert model.initial.tolist() == [0, 1, 0, 0, 0]
    assert model.successors()[1].tolist() == [1, 2, 4]
    assert classify(model).survival_time[2:4].tolist() == [2, 1]


def test_survival_time_is_the_longest_path() -> None:
    """networkx's own longest path on random acyclic graphs is the oracle."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = int(rng.integers(2, 12))
        graph = nx.DiGraph(
            [(i, j) for i in range(n) for j in range(i + 1, n) if rng.random() < 0.4]
        )
        graph.add_nodes_from(range(n))
        graph.add_edges_from((i, n - 1) for i in range(n - 1) if not graph.out_degree(i))
        model = from_networkx(graph, fail=[n - 1])
        times = dict(zip(model.state_names or (), classify(model).survival_time, strict=True))
        for node in range(n):
            below = graph.subgraph(nx.descendants(graph, node) | {node})
            assert times[str(node)] == nx.dag_longest_path_length(below)


def test_edges_without_labels_are_actions_of_their_own() -> None:
    model = from_networkx(nx.DiGraph([("a", "b"), ("a", "c"), ("b", "b"), ("c", "c")]), fail=["c"])
    assert model.action_names == ("0", "1")
    assert model.successors().tolist() == [[1, 2], [1, -1], [-1, -1]]


def test_fail_by_nodes_or_by_a_condition() -> None:
    graph = house()
    assert from_networkx(graph, fail=["edge", "hall"]).fail.tolist() == [0, 0, 1, 1, 0]
    assert from_networkx(graph, fail=[], fail_if="s == 1 and a == 1").fail.tolist() == [0] * 5 + [1]


@pytest.mark.parametrize("number", [float, Fraction])
def test_round_trip(number: Any, assert_same_dynamics: Callable[[SafeMDP, SafeMDP], None]) -> None:
    P = np.full((4, 2, 4), number(0), dtype=object if number is Fraction else float)
    P[0, 0, 0] = P[0, 0, 1] = number(1) / 2
    P[1, 1, 2], P[1, 1, 3] = number(1) / 4, 3 * number(1) / 4
    P[0, 1, 3] = number(1)
    available = np.array([[1, 1], [0, 1], [0, 0], [0, 0]]) == 1
    position = np.arange(4)
    model = SafeMDP.stochastic(
        P,
        position == 2,
        available,
        terminal=position == 3,
        initial=[0, 1],
        state_names=list("0123"),
        action_names=["go", "wait"],
    )
    graph = to_networkx(model)
    assert graph.number_of_edges() == 5
    assert graph.nodes[1]["name"] == "1"
    assert_same_dynamics(from_networkx(graph), model)


def changed(**attributes: Any) -> Any:
    graph = house()
    for name, value in attributes.items():
        graph.nodes["hall"][name] = value
    return graph


def two_edges(**attributes: Any) -> Any:
    graph = nx.MultiDiGraph()
    graph.add_node(2, fail=True)
    graph.add_edge(1, 1, action="a", **attributes)
    graph.add_edge(1, 2, action="a", **attributes)
    return graph


@pytest.mark.parametrize(
    ("graph", "options", "message"),
    [
        (nx.Graph([(0, 1)]), {}, "the graph must be directed"),
        (nx.DiGraph(), {}, "the graph has no nodes"),
        (nx.DiGraph([(0, 1)]), {}, "which nodes fail"),
        (house(), {"fail": ["pitt"]}, "fail: 'pitt' is not a node"),
        (changed(fail="yes"), {}, "node 'hall': the attribute 'fail' must be true or false"),
        (changed(initial=1), {}, "node 'hall': the attribute 'initial' must be true or false"),
        (two_edges(), {}, "node 1, action 'a': 2 edges need the attribute 'probability'"),
        (two_edges(probability="x"), {}, "node 1, action 'a': 'x' is not a probability"),
        (two_edges(probability=0.4), {}, r"state 1 \(1\), action 0 \(a\): .* sum to 0.8, not 1"),
    ],
)
def test_what_is_wrong_is_said(graph: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_networkx(graph, **options)
