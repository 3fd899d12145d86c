"""Certificates: what the solver writes is accepted, what is not true is refused."""

import ast
import json
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dead_ends.certificates.checker
from dead_ends.certificates.certificate import COLUMNS, certify, load_certificate, save_certificate
from dead_ends.certificates.checker import Certificate, CertificateError, check_certificate
from dead_ends.labels.classification import classify
from dead_ends.model.digest import model_digest
from dead_ends.model.safe_mdp import SafeMDP

FAIL, DEAD, SAFE, AT_RISK = range(4)


def tables() -> Iterator[SafeMDP]:
    """All deterministic models with two states and fail, two actions; some with an end or a gap."""
    fail = np.array([False, False, True])
    for codes in product(range(-1, 3), repeat=4):
        table = np.array([codes[:2], codes[2:], (0, 0)])
        if (table >= 0).any(axis=1).all():
            yield SafeMDP.deterministic(table, fail)
    for code in product(range(3), repeat=2):
        table = np.array([code, (2, 2), (0, 0)])
        yield SafeMDP.deterministic(table, fail, terminal=np.array([False, True, False]))


def kernels(num_actions: int) -> list[SafeMDP]:
    """All supports of two states and fail; the probabilities of one row are equal."""
    supports = [row for row in product([0, 1], repeat=3) if any(row)]
    fail = np.array([False, False, True])
    models = []
    for rows in product(supports, repeat=2 * num_actions):
        P = np.zeros((3, num_actions, 3))
        P[:2] = np.array(rows).reshape(2, num_actions, 3)
        P[:2] /= P[:2].sum(axis=2, keepdims=True)
        models.append(SafeMDP.stochastic(P, fail))
    return models


MODELS = [*tables(), *kernels(1), *kernels(2)[::11]]


def successors(model: SafeMDP) -> list[dict[int, list[int]]]:
    """For each state: the successors of each available action."""
    kernel = model.transitions()
    result: list[dict[int, list[int]]] = []
    for state in range(model.num_states):
        row = state * model.num_actions
        ends = kernel.indptr[row : row + model.num_actions + 1]
        parts = {a: kernel.indices[ends[a] : ends[a + 1]].tolist() for a in range(len(ends) - 1)}
        result.append({a: targets for a, targets in parts.items() if targets})
    return result


def true_labels(model: SafeMDP) -> list[int]:
    """By all memoryless policies: may fail be avoided surely, or with positive probability?"""
    graph = successors(model)
    fail = set(np.flatnonzero(model.fail).tolist())
    can_avoid, can_hope = set(), set()
    for policy in product(*[list(actions) or [None] for actions in graph]):
        chain = [graph[s].get(a, []) for s, a in enumerate(policy)]
        reached = [reach(chain, state) for state in range(len(chain))]
        can_avoid |= {s for s, after in enumerate(reached) if not after & fail}
        can_hope |= {
            s for s, after in enumerate(reached) if any(not reached[t] & fail for t in after)
        }
    return [
        FAIL if s in fail else SAFE if s in can_avoid else AT_RISK if s in can_hope else DEAD
        for s in range(len(graph))
    ]


def reach(chain: list[list[int]], start: int) -> set[int]:
    seen, stack = {start}, [start]
    while stack:
        new = set(chain[stack.pop()]) - seen
        seen |= new
        stack += new
    return seen


def is_true(model: SafeMDP, certificate: Certificate) -> bool:
    """The conditions of the checker's text, state by state."""
    label, rank, escape, action = (getattr(certificate, name).tolist() for name in COLUMNS)
    graph = successors(model)
    for s, actions in enumerate(graph):
        unsafe = [[rank[t] for t in targets if label[t] != SAFE] for targets in actions.values()]
        near = all(min(ranks, default=rank[s]) < rank[s] for ranks in unsafe)
        if model.is_deterministic and label[s] == DEAD:
            near = near and rank[s] == 1 + max(map(min, unsafe), default=0)
        chosen = actions.get(action[s], [])
        match label[s]:
            case 0:
                fixed = rank[s] == escape[s] == 0 and action[s] == -1
                holds = model.fail[s] and fixed
            case 1:
                inside = all(label[t] in (FAIL, DEAD) for ts in actions.values() for t in ts)
                holds = inside and near and rank[s] > 0 and escape[s] == 0 and action[s] == -1
            case 2:
                stays = bool(chosen) and all(label[t] == SAFE for t in chosen)
                holds = stays and rank[s] == escape[s] == 0
            case 3:
                closer = any(label[t] in (SAFE, AT_RISK) and escape[t] < escape[s] for t in chosen)
                holds = closer and near and rank[s] > 0 and escape[s] > 0
                holds = holds and not model.is_deterministic
            case _:
                return False
        if not holds or (model.fail[s] and label[s] != FAIL):
            return False
    return True


def accepted(model: SafeMDP, certificate: Certificate) -> bool:
    try:
        check_certificate(model, certificate)
    except CertificateError:
        return False
    return True


def changed(certificate: Certificate, name: str, state: int, value: int) -> Certificate:
    column = np.array(getattr(certificate, name), dtype=np.int64)
    column[state] = value
    return replace(certificate, **{name: column})


def test_what_is_certified_is_accepted_and_right() -> None:
    for model in MODELS:
        certificate = certify(model)
        check_certificate(model, certificate)
        assert certificate.labels.tolist() == true_labels(model)
        assert is_true(model, certificate)


def test_the_ranks_of_deterministic_models_are_survival_times() -> None:
    for model in tables():
        labelling = classify(model)
        rank = certify(model, labelling).rank
        assert np.array_equal(rank[labelling.dead], labelling.survival_time[labelling.dead])


def test_every_mutation_of_small_models() -> None:
    """Each entry, each other value: refused unless true; and labels are never wrong."""
    refused = kept = 0
    for model in MODELS:
        certificate = certify(model)
        right = certificate.labels.tolist()
        for name, state, value in product(COLUMNS, range(3), range(-2, 5)):
            mutant = changed(certificate, name, state, value)
            if getattr(certificate, name)[state] == value:
                continue
            verdict = accepted(model, mutant)
            assert verdict == is_true(model, mutant), (model, name, state, value)
            assert not verdict or mutant.labels.tolist() == right
            refused += not verdict
            kept += verdict
    # True mutations exist: another action that stays, a higher rank where nothing hangs on it.
    assert refused > kept > 0


@pytest.mark.parametrize("block", [1, 2])
def test_blocks_do_not_change_the_verdict(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """States are compared block by block; small models fit one, so blocks are made smaller."""
    models = MODELS[::7]
    certificates = [certify(model) for model in models]
    monkeypatch.setattr(dead_ends.certificates.checker, "BLOCK", block)
    for model, certificate in zip(models, certificates, strict=True):
        check_certificate(model, certificate)  # its digest was made in one block
        for name, state, value in product(COLUMNS, range(3), range(-1, 4)):
            mutant = changed(certificate, name, state, value)
            assert accepted(model, mutant) == is_true(model, mutant), (model, name, state, value)


def test_the_check_needs_little_memory() -> None:
    """Not the whole kernel of a table: bytes a state, for four actions."""
    num_states = 1_000_000
    shifts = np.array([0, 1, 7, 100], dtype=np.int32)
    table = (np.arange(num_states, dtype=np.int32)[:, None] + shifts) % num_states
    model = SafeMDP.deterministic(table, np.arange(num_states) % 100 == 50)
    certificate = certify(model)
    tracemalloc.start()
    check_certificate(model, certificate)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 150 * num_states


def test_no_certificate_at_all_for_wrong_labels() -> None:
    """Every combination of small entries on every one-action model with one state and fail."""
    fail = np.array([False, True])
    for support in ([1, 0], [0, 1], [0.5, 0.5]):
        model = SafeMDP.stochastic(np.array([[support], [[0, 0]]], dtype=float), fail)
        truth, found = true_labels(model), 0
        digest = model_digest(model)
        pairs = list(product(range(3), repeat=2))
        for labels, rank, escape, action in product(
            product(range(4), repeat=2), pairs, pairs, [(-1, -1), (0, -1)]
        ):
            columns = (np.array(column) for column in (labels, rank, escape, action))
            if accepted(model, Certificate(digest, *columns)):
                assert list(labels) == truth
                found += 1
        assert found


def line(length: int, **more: Any) -> SafeMDP:
    """State 0 may stay or enter a corridor of the given length that ends in fail."""
    table = np.minimum(np.arange(length + 2)[:, None] + [1, 2], length + 1)
    table[0, 0] = 0
    return SafeMDP.deterministic(table, np.arange(length + 2) == length + 1, **more)


def test_long_corridors_and_large_models() -> None:
    model = line(100_000)
    certificate = certify(model)
    assert certificate.rank.max() == 100_000
    check_certificate(model, certificate)
    bad = changed(certificate, "rank", 50_000, int(certificate.rank[50_000]) + 1)
    with pytest.raises(CertificateError, match="state 49999: some action has no unsafe successor"):
        check_certificate(model, bad)


@pytest.mark.parametrize("seed", range(10))
def test_random_stochastic_models(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_states, num_actions = 300, 3
    P = rng.random((num_states, num_actions, num_states))
    P *= rng.random(P.shape) < 1.2 / num_states
    # A successor with a lower number always exists, so that fail, the last, is not everywhere.
    P[:, :, 0] += (P.sum(axis=2) == 0) * 1.0
    P[:100] = np.roll(P[:100], 50, axis=2)
    P /= P.sum(axis=2, keepdims=True)
    fail = rng.random(num_states) < 0.3
    terminal = ~fail & (rng.random(num_states) < 0.02)
    model = SafeMDP.stochastic(P, fail, terminal=terminal)
    certificate = certify(model)
    check_certificate(model, certificate)
    assert is_true(model, certificate)
    for _ in range(100):
        name = str(rng.choice(COLUMNS))
        mutant = changed(certificate, name, int(rng.integers(num_states)), int(rng.integers(-1, 6)))
        assert accepted(model, mutant) == is_true(model, mutant)


def test_a_certificate_is_of_one_model() -> None:
    table = np.array([[0, 1], [2, 2], [2, 2], [0, 3]])
    fail = np.array([False, False, True, False])
    P = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    end = np.array([False, True])
    models = [
        SafeMDP.deterministic(table, fail),
        SafeMDP.deterministic(table[:, ::-1].copy(), fail),
        SafeMDP.deterministic(table, fail, terminal=np.arange(4) == 3),
        SafeMDP.deterministic(table, np.arange(4) == 1),
        SafeMDP.deterministic(table[:, :1].copy(), fail),
        SafeMDP.deterministic(np.where(table == 3, -1, table), fail),
        SafeMDP.stochastic(P, end),
        SafeMDP.stochastic(np.array([[[0.25, 0.75]], [[0.0, 1.0]]]), end),
        SafeMDP.stochastic(P, ~end, terminal=end),
    ]
    digests = {model_digest(model) for model in models}
    assert len(digests) == len(models)
    for first, second in product(models, repeat=2):
        if first is not second and first.num_states == second.num_states:
            with pytest.raises(CertificateError, match="of another model"):
                check_certificate(second, certify(first))


def golden_models() -> dict[str, SafeMDP]:
    """One of each kind that the digest tells apart, with ends, gaps and rows that do not count."""
    table = np.array([[0, 1], [-1, 2], [7, 7], [9, -9], [1, -1]])
    fail, terminal = np.arange(5) == 2, np.arange(5) == 3
    P = np.zeros((3, 2, 3))
    P[0, 0], P[0, 1], P[1, 0], P[1, 1] = (0.1, 0.2, 0.7), (0, 1, 0), (0, 0, 1), (1 / 3, 0, 2 / 3)
    thirds = np.array([[[Fraction(1, 3), Fraction(2, 3)]], [[0, 1]]], dtype=object)
    return {
        "table": SafeMDP.deterministic(table, fail, terminal=terminal),
        "floats": SafeMDP.stochastic(P, np.arange(3) == 2, np.array([[1, 1], [1, 0], [1, 1]]) == 1),
        "Fractions": SafeMDP.stochastic(thirds, np.array([False, True])),
        "more states than are read at once": line(300_000),
    }


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("table", "d136cb3e8a1ace9a01147727ca3891bb8203cc5d204c2ac19d8addb5adb735a3"),
        ("floats", "102858613e926f0865af5c7b0256a6a3ceb469a2c28816f6e2d912354d9d2723"),
        ("Fractions", "fe92de6386e401189801b76e24d41732d92d59bfeae6f099d30abd2ddff34240"),
        (
            "more states than are read at once",
            "e97307127a0e7cf2b4647847a31c6e91521f340d75a9174cb2167220921885fc",
        ),
    ],
)
def test_digests_stay_what_they_are(name: str, digest: str) -> None:
    """Saved certificates hold them: another digest would refuse every one of them."""
    assert model_digest(golden_models()[name]) == digest


def test_a_saved_certificate_stays_valid() -> None:
    """As a release wrote it, to the letter."""
    model = golden_models()["table"]
    columns = {
        "labels": [SAFE, DEAD, FAIL, SAFE, DEAD],
        "rank": [0, 1, 0, 0, 2],
        "escape": [0, 0, 0, 0, 0],
        "action": [0, -1, -1, 0, -1],
    }
    digest = "d136cb3e8a1ace9a01147727ca3891bb8203cc5d204c2ac19d8addb5adb735a3"
    saved = Certificate(digest, **{name: np.array(each) for name, each in columns.items()})
    check_certificate(model, saved)
    made = certify(model)
    assert made.digest == digest
    assert {name: getattr(made, name).tolist() for name in COLUMNS} == columns


def test_names_rewards_and_ignored_rows_do_not_change_the_model() -> None:
    model = line(3)
    table = model.next_state
    assert table is not None
    other = table.copy()
    other[-1] = 0
    named = SafeMDP.deterministic(
        other, model.fail, rewards=np.ones((5, 2)), initial=[0], state_names=list("abcde")
    )
    assert model_digest(named) == model_digest(model)
    check_certificate(named, certify(model))


@pytest.mark.parametrize(
    ("name", "state", "value", "message"),
    [
        ("labels", 0, 7, "state 0: not a label"),
        ("labels", 0, -1, "state 0: not a label"),
        ("labels", 0, FAIL, "state 0: the label fail belongs to the fail states alone"),
        ("labels", 4, DEAD, "state 4: the label fail belongs to the fail states alone"),
        ("labels", 0, AT_RISK, "state 0: at risk in a deterministic model"),
        ("labels", 1, SAFE, "state 1: rank must be positive if dead or at risk, else 0"),
        ("rank", 1, -3, "state 1: rank must be positive"),
        ("rank", 4, -1, "state 4: rank and escape must not be negative"),
        ("escape", 1, 1, "state 1: escape must be positive if at risk, else 0"),
        ("action", 0, 2, "state 0: not an action"),
        ("action", 1, 0, "state 1: safe and at-risk states have an action, others -1"),
        ("action", 0, 1, "state 0: labelled safe, and its action may leave the safe states"),
        ("rank", 2, 3, "state 1: some action has no unsafe successor of lower rank"),
        ("rank", 1, 4, "state 1: rank is not 1 . the greatest of successors"),
    ],
)
def test_the_refusal_says_why(name: str, state: int, value: int, message: str) -> None:
    model = line(3)
    with pytest.raises(CertificateError, match=message):
        check_certificate(model, changed(certify(model), name, state, value))


def test_more_refusals() -> None:
    table = np.array([[0, -1], [2, 2], [0, 0]])
    model = SafeMDP.deterministic(table, np.array([False, False, True]))
    certificate = certify(model)
    with pytest.raises(CertificateError, match="state 0: its action is not available"):
        check_certificate(model, changed(certificate, "action", 0, 1))
    both = changed(changed(certificate, "labels", 0, DEAD), "rank", 0, 1)
    with pytest.raises(CertificateError, match="state 0: some action has no unsafe successor"):
        check_certificate(model, changed(both, "action", 0, -1))
    P = np.array([[[0.5, 0.5, 0]], [[0, 0, 1]], [[0, 0, 1.0]]])
    risky = SafeMDP.stochastic(P, np.array([False, True, False]))
    certificate = certify(risky)
    assert certificate.labels.tolist() == [DEAD, FAIL, SAFE]
    as_risk = changed(changed(certificate, "labels", 0, AT_RISK), "escape", 0, 1)
    with pytest.raises(CertificateError, match="state 0: its action does not escape"):
        check_certificate(risky, changed(as_risk, "action", 0, 0))
    P = np.array([[[0, 1, 0, 0]], [[0, 0, 0.5, 0.5]], [[0, 0, 1, 0]], [[0, 0, 0, 1.0]]])
    hopeful = SafeMDP.stochastic(P, np.array([False, False, True, False]))
    certificate = certify(hopeful)
    assert certificate.labels.tolist() == [AT_RISK, AT_RISK, FAIL, SAFE]
    as_dead = changed(changed(certificate, "labels", 0, DEAD), "escape", 0, 0)
    with pytest.raises(CertificateError, match="state 0: labelled dead, with a successor that is"):
        check_certificate(hopeful, changed(as_dead, "action", 0, -1))
    for name in COLUMNS:
        with pytest.raises(CertificateError, match=f"{name}: 3 integers are needed"):
            check_certificate(risky, replace(certify(risky), **{name: np.zeros(2, dtype=int)}))
        with pytest.raises(CertificateError, match=f"{name}: 3 integers are needed"):
            check_certificate(risky, replace(certify(risky), **{name: np.zeros(3)}))


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_files(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"certificate{suffix}"
    model = kernels(2)[100]
    certificate = certify(model)
    save_certificate(certificate, path)
    loaded = load_certificate(path)
    assert loaded.digest == certificate.digest
    for name in COLUMNS:
        assert np.array_equal(getattr(loaded, name), getattr(certificate, name))
    check_certificate(model, loaded)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match=f"certificate{suffix}: not "):
        load_certificate(path)


GOOD = {
    "format": "dead-ends certificate",
    "version": 1,
    "digest": "",
    "labels": [0],
    "rank": [0],
    "escape": [0],
    "action": [-1],
}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "not a certificate of dead-ends"),
        ({}, "not a certificate of dead-ends"),
        (GOOD | {"version": 2}, "certificate of version 2, not 1"),
        ({k: v for k, v in GOOD.items() if k != "rank"}, "no column 'rank'"),
        (GOOD | {"rank": [0.5]}, "rank: not a list of integers"),
        (GOOD | {"rank": 0}, "rank: not a list of integers"),
        (GOOD | {"rank": ["a"]}, "rank: not a list of integers"),
        (GOOD | {"rank": [[1], [1, 2]]}, "rank: "),
    ],
)
def test_bad_files(content: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=message) as caught:
        load_certificate(path)
    assert str(caught.value).startswith(str(path))
    with pytest.raises(ValueError, match="certificates are written as"):
        save_certificate(certify(line(2)), tmp_path / "certificate.txt")


def test_the_checker_shares_nothing_with_the_solver() -> None:
    path = dead_ends.certificates.checker.__file__
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {
        n.name for node in ast.walk(tree) if isinstance(node, ast.Import) for n in node.names
    }
    ours = {"dead_ends.model.digest", "dead_ends.model.safe_mdp"}
    assert imported == ours | {
        "__future__",
        "dataclasses",
        "numpy",
        "numpy.typing",
        "typing",
    }
