"""Probabilities of six digits, in every format: refused by name, or mended where that is asked."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pytest

from dead_ends.io import load_model
from dead_ends.io.gymnasium_table import load_gymnasium
from dead_ends.io.networkx_graph import from_networkx
from dead_ends.model.safe_mdp import SafeMDP

TRA = "4 4 6\n0 0 1 %\n0 0 2 %\n0 0 3 %\n1 0 1 1\n2 0 2 1\n3 0 3 1\n"
DRN = (
    "@type: DTMC\n@nr_states\n4\n@model\n"
    "state 0 init\n\taction 0\n\t\t1 : %\n\t\t2 : %\n\t\t3 : %\n"
    + ("".join(f"state {s}\n\taction 0\n\t\t{s} : 1\n" for s in (1, 2, 3)))
)
PRISM = "dtmc\nmodule m\nx:[0..3];\n[] x=0 -> " + (
    " + ".join(f"%:(x'={x})" for x in (1, 2, 3)) + ";\n[] x>0 -> true;\nendmodule\n"
)
Reader = Callable[..., SafeMDP]


def text(suffix: str, content: str) -> Callable[[Path, str], Reader]:
    def reader(folder: Path, digits: str) -> Reader:
        path = folder / f"model{suffix}"
        path.write_text(content.replace("%", digits))
        return lambda **options: load_model(path, fail_states=[1], **options)

    return reader


def arrays(exact: bool) -> Callable[[Path, str], Reader]:
    def reader(folder: Path, digits: str) -> Reader:
        values = [digits] * 3 + ["1"] * 3
        P = {"P_exact": values} if exact else {"P_data": np.array(values, dtype=float)}
        np.savez(
            folder / "model.npz",
            fail=np.arange(4) == 1,
            P_indices=[1, 2, 3, 1, 2, 3],
            P_indptr=[0, 3, 4, 5, 6],
            **P,
        )
        return lambda **options: load_model(folder / "model.npz", **options)

    return reader


def gymnasium_table(_: Path, digits: str) -> Reader:
    P = [[[(float(digits), s, 3.0, False) for s in (1, 2, 3)]]]
    P += [[[(1.0, s, 0.0, False)]] for s in (1, 2, 3)]
    env = SimpleNamespace(unwrapped=SimpleNamespace(P=P))
    return lambda **options: load_gymnasium(env, fail_states=[1], **options)


def graph(number: Callable[[str], object]) -> Callable[[Path, str], Reader]:
    def reader(_: Path, digits: str) -> Reader:
        edges = nx.MultiDiGraph()
        edges.add_nodes_from(range(4))
        for s in (1, 2, 3):
            edges.add_edge(0, s, action="a", probability=number(digits))
        return lambda **options: from_networkx(edges, fail=[1], **options)

    return reader


READERS = {
    ".tra": text(".tra", TRA),
    ".drn": text(".drn", DRN),
    "PRISM": text(".pm", PRISM),
    ".npz": arrays(exact=False),
    ".npz, exact": arrays(exact=True),
    "Gymnasium": gymnasium_table,
    "networkx": graph(float),
    "networkx, exact": graph(Fraction),
}


@pytest.mark.parametrize("name", READERS)
def test_refused_by_name_or_mended(name: str, tmp_path: Path) -> None:
    if name == "PRISM":
        pytest.importorskip("stormpy", reason="stormpy, the extra storm, is not installed")
    load = READERS[name](tmp_path, "0.333333")
    with pytest.raises(
        ValueError, match=r"state 0.* sum to .*; normalise=True \(--normalise\) div"
    ):
        load()
    model = load(normalise=True)
    assert model.normalised == 1
    assert model.transitions().toarray()[0] == pytest.approx([0, 1 / 3, 1 / 3, 1 / 3], rel=4e-16)
    assert model.exact_probabilities()[:3] == (Fraction(1, 3),) * 3
    assert (model.exact is None) == ("exact" not in name)
    if model.rewards is not None:
        assert model.rewards[0, 0] == pytest.approx(3.0, rel=4e-16), "of the mended probabilities"
    if name != "PRISM":  # Storm refuses it itself
        line = "line .* " if name in (".tra", ".drn") else ""
        with pytest.raises(ValueError, match=f"{line}.*sum to .*not (exactly )?1$"):
            READERS[name](tmp_path, "0.33333")(normalise=True)


def test_a_certain_step_that_was_rounded_makes_a_table(tmp_path: Path) -> None:
    path = tmp_path / "model.tra"
    path.write_text("2 2 2\n0 0 1 0.999999\n1 0 1 1\n")
    model = load_model(path, fail_states=[1], normalise=True)
    assert model.is_deterministic
    assert model.normalised == 1
