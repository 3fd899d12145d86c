"""The kernel-checked proofs are accepted, rest on what they say, and speak of this code."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from dead_ends.certificates.certificate import certify
from dead_ends.certificates.checker import Certificate, CertificateError, check_certificate
from dead_ends.labels.classification import INFINITE, classify
from dead_ends.model.safe_mdp import SafeMDP
from proofs_check.machinery import coq_proofs as kernel
from proofs_check.machinery import report_card as report

COMMENT = re.compile(r"\(\*.*?\*\)", re.DOTALL)
ASSUMED = re.compile(
    r"\b(Admitted|admit|give_up|Axioms?|Parameters?|Conjectures?|bypass_check|Unset)\b"
)
Classifier = Callable[[SafeMDP], tuple[NDArray[np.uint8], NDArray[np.int32]]]


@pytest.fixture
def coq() -> None:
    if not kernel.coq_available():
        pytest.skip("not proved here: coqc is not installed")


def python(model: SafeMDP) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Labels and survival times as this package finds them."""
    labelling = classify(model)
    return labelling.labels, labelling.survival_time


@pytest.mark.usefixtures("coq")
def test_every_statement_is_proved(request: pytest.FixtureRequest) -> None:
    proved = kernel.proved_statements()
    assert len(proved) > 30
    assert tuple(proved) == kernel.statement_names()
    allowed = kernel.allowed_axioms()
    assert {name: set(axioms) - allowed for name, axioms in proved.items()} == {
        name: set() for name in proved
    }
    request.node.user_properties.append((report.KERNEL, {"proved": sorted(proved)}))


def test_nothing_is_assumed_in_the_sources() -> None:
    sources = sorted(kernel.FOLDER.glob("*.v"))
    assert len(sources) > 10
    for source in sources:
        assert not ASSUMED.findall(COMMENT.sub("", source.read_text(encoding="utf-8"))), source.name


def test_statements_are_short_and_prove_nothing() -> None:
    text = (kernel.FOLDER / "Statements.v").read_text(encoding="utf-8")
    assert text.count("\n") <= 260
    assert not re.findall(r"\b(Lemma|Theorem|Proof|Qed|Defined)\b", COMMENT.sub("", text))


@pytest.mark.usefixtures("coq")
def test_coqchk_accepts_the_compiled_proofs() -> None:
    summary = kernel.recheck()
    for doubt in ("type-in-type", "unsafe (co)fixpoints", "positivity is assumed"):
        assert re.search(rf"{re.escape(doubt)}: <none>", summary), doubt


@pytest.mark.slow
@pytest.mark.usefixtures("coq")
def test_coqchk_accepts_them_with_the_standard_library() -> None:
    summary = kernel.recheck(standard_library=True)
    axioms = set(re.findall(r"^    Coq\.\w+\.([\w.]+)$", summary, re.MULTILINE))
    # All that the loaded libraries declare, whether a theorem rests on it or not.
    assert axioms == kernel.allowed_axioms() | {"Classical_Prop.classic"}


def coqc(name: str, text: str) -> subprocess.CompletedProcess[str]:
    """Compile a file beside the proofs."""
    kernel.build()
    (kernel.BUILD / f"{name}.v").write_text(text, encoding="utf-8")
    command = ["coqc", "-q", "-Q", ".", "DeadEnds", f"{name}.v"]
    return subprocess.run(command, cwd=kernel.BUILD, capture_output=True, text=True, check=False)


REQUIRE = "From DeadEnds Require Statements Theorems.\n"


@pytest.mark.usefixtures("coq")
def test_a_theorem_is_not_accepted_for_another_statement() -> None:
    good = "Check (Theorems.Horizon : Statements.Horizon_statement).\n"
    assert coqc("GoodCheck", REQUIRE + good).returncode == 0
    wrong = coqc("WrongCheck", REQUIRE + good.replace("s.Horizon_s", "s.Acyclic_s"))
    assert wrong.returncode != 0
    assert "Acyclic_statement" in wrong.stderr


@pytest.mark.usefixtures("coq")
def test_an_assumed_statement_is_found_out() -> None:
    module = (
        "Module Mine. Axiom Horizon : Statements.Horizon_statement. End Mine.\n"
        "Check (Mine.Horizon : Statements.Horizon_statement). Print Assumptions Mine.Horizon.\n"
    )
    printed = coqc("Assumed", REQUIRE + module).stdout
    axioms = set(kernel.parse_assumptions(printed)["Horizon"])
    assert "Assumed.Mine.Horizon" in axioms or "Mine.Horizon" in axioms
    assert not axioms <= kernel.allowed_axioms()


HEAD = "Theorems.A : Statements.A_statement\n     : Statements.A_statement\n"


@pytest.mark.parametrize(
    ("printed", "message"),
    [
        ("Error", "unexpected output of Coq: 'Error'"),
        (HEAD + "Axioms:\n", "unexpected assumptions of A"),
        (HEAD + "Section Variables:\nx : R\n", "unexpected assumptions of A"),
    ],
)
def test_other_output_of_coq_is_not_taken_for_a_proof(printed: str, message: str) -> None:
    with pytest.raises(kernel.KernelError, match=message):
        kernel.parse_assumptions(printed)


def test_axioms_are_read_with_their_types() -> None:
    printed = HEAD + "Axioms:\nR.sig : forall P, P\nlong.name\n  : forall (n : nat),\n    n = n\n"
    closed = HEAD.replace("A", "B") + "Closed under the global context\n"
    assert kernel.parse_assumptions(printed + closed) == {"A": ("R.sig", "long.name"), "B": ()}


# --- The extracted labelling ------------------------------------------------------------------


def all_tables(n: int, m: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Every successor table with every set of fail states: (B, n, m) and (B, n)."""
    count = n ** (n * m)
    powers = n ** np.arange(n * m)
    tables = (np.arange(count)[:, None] // powers % n).astype(np.int32).reshape(count, n, m)
    masks = np.arange(2**n)[:, None] >> np.arange(n) & 1 == 1
    return np.repeat(tables, 2**n, axis=0), np.tile(masks, (count, 1))


def side_by_side(tables: NDArray[np.int32], fail: NDArray[np.bool_]) -> SafeMDP:
    """Many models as one, whose parts do not meet."""
    count, n, m = tables.shape
    offset = (np.arange(count, dtype=np.int32) * n)[:, None, None]
    table = np.where(tables < 0, np.int32(-1), tables + offset)
    return SafeMDP.deterministic(table.reshape(count * n, m), fail.reshape(count * n))


def digit_lines(columns: NDArray[np.int64]) -> str:
    """Rows of one-digit numbers as lines."""
    text = np.full((columns.shape[0], 2 * columns.shape[1]), ord(" "), dtype=np.uint8)
    text[:, ::2] = columns + ord("0")
    text[:, -1] = ord("\n")
    return text.tobytes().decode("ascii")


def proved_labels(tables: NDArray[np.int32], fail: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(B, 2n): labels and survival times of the extracted program, -1 for states that last."""
    count, n, m = tables.shape
    sizes = np.broadcast_to([n, m], (count, 2))
    columns = np.concatenate([sizes, tables.reshape(count, n * m), fail], axis=1)
    if (tables >= 0).all():
        models = digit_lines(columns)
    else:
        models = "".join(" ".join(map(str, row)) + "\n" for row in columns.tolist())
    return np.fromstring(kernel.run_program("label", models), dtype=np.int32, sep=" ").reshape(
        count, 2 * n
    )


def disagreements(
    classifier: Classifier, tables: NDArray[np.int32], fail: NDArray[np.bool_]
) -> int:
    """In how many models the classifier and the extracted program differ."""
    labels, times = classifier(side_by_side(tables, fail))
    times = np.where(times == INFINITE, -1, times)
    found = np.concatenate([labels.reshape(fail.shape), times.reshape(fail.shape)], axis=1)
    return int((found != proved_labels(tables, fail)).any(axis=1).sum())


@pytest.mark.usefixtures("coq")
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_labels_are_the_proved_ones_on_all_models_with_two_actions(n: int) -> None:
    tables, fail = all_tables(n, 2)
    assert len(tables) == 2**n * n ** (2 * n)
    assert disagreements(python, tables, fail) == 0


@pytest.mark.usefixtures("coq")
def test_labels_are_the_proved_ones_where_actions_are_missing() -> None:
    codes = np.array(list(product(range(-1, 3), repeat=6)), dtype=np.int32).reshape(-1, 3, 2)
    tables = np.repeat(codes, 8, axis=0)
    fail = np.tile(np.array(list(product([False, True], repeat=3))), (len(codes), 1))
    valid = ((tables >= 0).any(axis=2) | fail).all(axis=1)
    assert disagreements(python, tables[valid], fail[valid]) == 0


def one_step_late(model: SafeMDP) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    labels, times = python(model)
    return labels, np.where((times > 0) & (times < INFINITE), times + 1, times)


def doomed_by_one_action(model: SafeMDP) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    assert model.next_state is not None
    return python(SafeMDP.deterministic(model.next_state[:, :1].copy(), model.fail))


@pytest.mark.usefixtures("coq")
@pytest.mark.parametrize("wrong", [one_step_late, doomed_by_one_action])
def test_other_labels_are_noticed(wrong: Classifier) -> None:
    assert disagreements(wrong, *all_tables(3, 2)) > 1_000


@pytest.mark.usefixtures("coq")
@pytest.mark.parametrize(
    ("mode", "line", "message"),
    [
        ("label", "2 1 1 1 0", "line 2: too few numbers"),
        ("label", "2 1 1 1 0 1 1", "line 2: too many numbers"),
        ("label", "2 1 1 x 0 1", "line 2: not an integer: 'x'"),
        ("label", "2 1 2 1 0 1", "line 2: a successor out of range"),
        ("label", "2 1 -1 1 0 1", "line 2: a state without an action"),
        ("label", "-2 1", "line 2: n is negative"),
        ("check", "0 1 1 0 -1", "line 2: a number of successors is negative"),
    ],
)
def test_an_unreadable_line_is_named(mode: kernel.Mode, line: str, message: str) -> None:
    first = {"label": "1 1 0 0", "check": "0 1 1 0 1 0 2 0 0 0"}[mode]
    assert kernel.run_checker(mode, [first]) == [{"label": "2 -1", "check": "accept"}[mode]]
    with pytest.raises(kernel.KernelError, match=f"^{message}$"):
        kernel.run_checker(mode, [first, line])


# --- The extracted checker --------------------------------------------------------------------


def random_model(rng: np.random.Generator, deterministic: bool) -> SafeMDP:
    """A few states, sparse, often with dead-ends; sometimes goals and missing actions."""
    n, m = int(rng.integers(2, 7)), int(rng.integers(1, 4))
    fail = np.arange(n) == n - 1
    terminal = (rng.random(n) < 0.1) & ~fail
    missing = rng.random((n, m)) < 0.2
    missing[np.arange(n), rng.integers(m, size=n)] = False
    if deterministic:
        table = np.where(missing, -1, rng.integers(n, size=(n, m)))
        return SafeMDP.deterministic(table, fail, terminal=terminal)
    P = np.zeros((n, m, n))
    for state, action in product(range(n), range(m)):
        targets = rng.choice(n, size=int(rng.integers(1, 3)), replace=False)
        P[state, action, targets] = 1 / len(targets)
    return SafeMDP.stochastic(P, fail, ~missing, terminal=terminal)


def single_changes(certificate: Certificate) -> Iterator[Certificate]:
    """The certificates that differ in one entry by one, or in one label."""
    for name in ("labels", "rank", "escape", "action"):
        column = getattr(certificate, name).astype(np.int32)
        for state, value in enumerate(column.tolist()):
            for other in range(4) if name == "labels" else (value - 1, value + 1):
                if other != value:
                    changed = column.copy()
                    changed[state] = other
                    yield replace(certificate, **{name: changed})


def accepted_by_python(model: SafeMDP, certificate: Certificate) -> bool:
    try:
        check_certificate(model, certificate)
    except CertificateError:
        return False
    return True


@pytest.mark.usefixtures("coq")
@pytest.mark.parametrize("deterministic", [True, False])
def test_the_checkers_agree(deterministic: bool) -> None:
    rng = np.random.default_rng(7)
    cases: list[tuple[SafeMDP, Certificate, bool]] = []
    for _ in range(120):
        model = random_model(rng, deterministic)
        certificate = certify(model)
        cases.append((model, certificate, True))
        cases += [
            (model, changed, accepted_by_python(model, changed))
            for changed in single_changes(certificate)
        ]
    lines = (kernel.certificate_line(model, certificate) for model, certificate, _ in cases)
    expected = ["accept" if accepted else "reject" for *_, accepted in cases]
    assert kernel.run_checker("check", lines) == expected
    # Changed certificates may be true ones as well; the tests have met both.
    assert 120 < expected.count("accept") < len(cases) // 2


@pytest.mark.usefixtures("coq")
def test_a_certificate_of_another_model_is_rejected() -> None:
    fail = np.array([False, False, True])
    model = SafeMDP.deterministic(np.array([[1], [2], [2]]), fail)
    other = SafeMDP.deterministic(np.array([[1], [1], [2]]), fail)
    assert kernel.run_checker(
        "check",
        [
            kernel.certificate_line(model, certify(model)),
            kernel.certificate_line(other, certify(model)),
        ],
    ) == ["accept", "reject"]
