"""The kernel-checked proofs in ``coq/``: build them, ask what they prove, run their programs.

``coq/Statements.v`` says what is claimed of the paper, ``coq/CheckerStatements.v`` what is claimed
of two programs, a labelling and a checker of certificates, which are extracted to OCaml. Coq
checks that each theorem has the type of its statement and prints the axioms that it rests on;
a theorem counts as proved if these are among those of ``coq/allowed_axioms.txt``, the axioms of
the real numbers in Coq's standard library.

Everything is compiled by ``coq/Makefile`` into ``coq/_build`` and compiled again only when a
source or Coq's version has changed.
"""

from __future__ import annotations

import fcntl
import hashlib
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from dead_ends.certificates.checker import Certificate
from dead_ends.model.safe_mdp import SafeMDP

FOLDER = Path(__file__).parents[1] / "coq"
BUILD = FOLDER / "_build"

Mode = Literal["label", "check"]


class KernelError(RuntimeError):
    """Coq rejected a proof, or a program of the kernel failed."""


def coq_available() -> bool:
    """Whether Coq is installed (Debian: coq, libcoq-stdlib, ocaml-nox)."""
    return shutil.which("coqc") is not None


def build() -> None:
    """Compile the proofs, print their axioms, build the extracted programs.

    Raises:
        KernelError: with the end of Coq's output, if a file is not accepted.
    """
    _make("all", "built")


def recheck(*, standard_library: bool = False) -> str:
    """Have coqchk check the compiled proofs again, and return its summary.

    Args:
        standard_library: also what they use of Coq's standard library (most of a minute).

    Raises:
        KernelError: with the end of coqchk's output, if it objects.
    """
    build()
    target, name = ("check-all", "coqchk-all") if standard_library else ("check", "coqchk")
    _make(target, name)
    return (BUILD / f"{name}.txt").read_text(encoding="utf-8")


def statement_names() -> tuple[str, ...]:
    """The names of all statements, X for each ``X_statement``."""
    text = "".join(
        (FOLDER / name).read_text(encoding="utf-8")
        for name in ("Statements.v", "CheckerStatements.v")
    )
    return tuple(re.findall(r"^Definition (\w+)_statement\b", text, re.MULTILINE))


def proved_statements() -> dict[str, tuple[str, ...]]:
    """The axioms of each theorem whose type Coq found to be the statement of its name."""
    build()
    return parse_assumptions((BUILD / "assumptions.txt").read_text(encoding="utf-8"))


def parse_assumptions(printed: str) -> dict[str, tuple[str, ...]]:
    """What ``Check (X : X_statement). Print Assumptions X.`` printed, by theorem.

    Raises:
        KernelError: if a part of the text has another form.
    """
    stated = r"\s+:\s+\w+\.\1_statement"  # Coq breaks the lines of long names
    theorem = re.compile(rf"^\w+\.(\w+){stated}{stated}\n", re.MULTILINE)
    first, *parts = theorem.split(printed)
    if first:
        raise KernelError(f"unexpected output of Coq: {first[:200]!r}")
    names, bodies = parts[::2], parts[1::2]
    return {name: _axioms(name, body) for name, body in zip(names, bodies, strict=True)}


def _axioms(name: str, body: str) -> tuple[str, ...]:
    if body == "Closed under the global context\n":
        return ()
    head, _, rest = body.partition("\n")
    axioms = tuple(re.findall(r"^([\w.]+)(?= :|$)", rest, re.MULTILINE))
    if head != "Axioms:" or not axioms:
        raise KernelError(f"unexpected assumptions of {name}: {body[:200]!r}")
    return axioms


def allowed_axioms() -> frozenset[str]:
    """The axioms that a theorem may rest on."""
    return frozenset((FOLDER / "allowed_axioms.txt").read_text(encoding="utf-8").split())


def run_program(mode: Mode, models: str) -> str:
    """Run an extracted program on models, one a line; the formats are in ``coq/main.ml``.

    Raises:
        KernelError: naming the first line that the program could not read.
    """
    build()
    done = subprocess.run(
        [BUILD / "kernel", mode], input=models, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise KernelError(done.stderr.strip())
    return done.stdout


def run_checker(mode: Mode, lines: Iterable[str]) -> list[str]:
    """The answers of an extracted program, a line for each model."""
    return run_program(mode, "".join(f"{line}\n" for line in lines)).splitlines()


def certificate_line(model: SafeMDP, certificate: Certificate) -> str:
    """A model and a certificate as the extracted checker reads them."""
    kernel = model.transitions()
    starts, targets = kernel.indptr.tolist(), kernel.indices.tolist()
    successors = (targets[i:j] for i, j in pairwise(starts))
    columns = (certificate.labels, certificate.rank, certificate.escape, certificate.action)
    fields: list[int] = [
        0 if model.is_deterministic else 1,
        model.num_states,
        model.num_actions,
        *np.where(model.fail, 1, np.where(model.terminal, 2, 0)).tolist(),
        *(field for row in successors for field in (len(row), *row)),
        *(field for column in columns for field in column.tolist()),
    ]
    return " ".join(map(str, fields))


def _make(target: str, name: str) -> None:
    """Run make unless it has been run on the same sources."""
    with _locked():
        stamp, digest = BUILD / f"{name}.digest", _digest()
        if stamp.exists() and stamp.read_text(encoding="utf-8") == digest:
            return
        version = BUILD / "version"
        if version.exists() and version.read_text(encoding="utf-8") != _version():
            _run_make("clean-compiled")
        version.write_text(_version(), encoding="utf-8")
        _run_make(target)
        stamp.write_text(digest, encoding="utf-8")


def _run_make(target: str) -> None:
    done = subprocess.run(
        ["make", "--silent", "-C", FOLDER, target],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        raise KernelError(f"make {target} failed:\n{done.stdout[-4_000:]}")


@contextmanager
def _locked() -> Iterator[None]:
    """One build at a time, also among the processes of a parallel test run."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _version() -> str:
    return subprocess.run(["coqc", "--version"], capture_output=True, text=True, check=True).stdout


def _digest() -> str:
    """Of the sources and of Coq's version."""
    content = hashlib.sha256(_version().encode())
    for path in sorted(
        p for p in FOLDER.iterdir() if p.suffix in {".v", ".ml", ""} and p.is_file()
    ):
        content.update(f"{path.name}\n".encode() + path.read_bytes())
    return content.hexdigest()
