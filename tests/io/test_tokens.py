"""Tokens and numbers of text files, against Python's own reading."""

import random
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dead_ends.io.tokens import Tokens


def tokens_of(tmp_path: Path, content: bytes) -> Tokens:
    path = tmp_path / "file.txt"
    path.write_bytes(content)
    return Tokens(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"\n", b"a", b"a b\nc\n", b"  a\t b \r\n\r\n\nc d", b"\n\nx\n \n", "é ★\nb".encode()],
)
def test_lines_and_tokens_are_those_of_split(content: bytes, tmp_path: Path) -> None:
    tokens = tokens_of(tmp_path, content)
    lines = content.split(b"\n")
    if lines[-1] == b"":
        lines.pop()
    assert tokens.counts.tolist() == [len(line.split()) for line in lines]
    assert [tokens.raw(i) for i in range(tokens.first[-1])] == content.split()
    assert [tokens.line_text(i).split() for i in range(len(lines))] == [
        line.decode().split() for line in lines
    ]


def test_a_byte_order_mark_is_no_text(tmp_path: Path) -> None:
    assert tokens_of(tmp_path, "\ufeffa \ufeff".encode()).line_text(0) == "a \ufeff"


def test_numbers_are_those_of_float(tmp_path: Path) -> None:
    rng = random.Random(0)
    texts = ["0", "1", "1.", ".5", "0.1", "-2.5", "+3", "1e-3", "2E5", "0.000000000000001"]
    texts += ["5e-324", "1e300", "9007199254740993", "0.30000000000000004", "00.10", "1e-400"]
    texts += [repr(rng.random()) for _ in range(2000)]
    texts += [f"{rng.random():.{rng.randrange(1, 18)}f}" for _ in range(2000)]
    texts += [f"{rng.random() * 10 ** rng.randrange(-30, 30):.17g}" for _ in range(2000)]
    tokens = tokens_of(tmp_path, " ".join(texts).encode())
    values = tokens.numbers(np.arange(len(texts)), "a number")
    assert values.tolist() == [float(text) for text in texts]


def test_fractions_make_all_numbers_exact(tmp_path: Path) -> None:
    tokens = tokens_of(tmp_path, b"1/3 0.1 2 -4/6 1e-2")
    values = tokens.numbers(np.arange(5), "a number")
    assert values.tolist() == [
        Fraction(1, 3), Fraction(1, 10), Fraction(2), Fraction(-2, 3), Fraction(1, 100),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["x", ".", "1..2", "1e", "--1", "nan", "inf", "1_0", "0x1", "1e999", "1/0", "1/x", "1,5"],
)
def test_what_is_no_number(text: str, tmp_path: Path) -> None:
    tokens = tokens_of(tmp_path, f"1\n0.5 {text}\n".encode())
    with pytest.raises(ValueError, match="line 2: '.*' is not a number"):
        tokens.numbers(np.arange(3), "a number")


def test_no_number_among_fractions(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="line 2: 'x' is not a number"):
        tokens_of(tmp_path, b"1/2\nx").numbers(np.arange(2), "a number")


@pytest.mark.parametrize("text", ["-1", "1.0", "x", "2147483648", "99999999999999999999", "+1"])
def test_what_is_no_natural_number(text: str, tmp_path: Path) -> None:
    tokens = tokens_of(tmp_path, f"7 2147483647\n{text}".encode())
    assert tokens.integers(np.arange(2), "a state").tolist() == [7, 2147483647]
    with pytest.raises(ValueError, match=r"file.txt: line 2: '.*' is not a state"):
        tokens.integers(np.arange(3), "a state")


def test_distinct_texts_by_first_appearance(tmp_path: Path) -> None:
    names, which = tokens_of(tmp_path, b"b a b c a").distinct(np.arange(5))
    assert names == ["b", "a", "c"]
    assert which.tolist() == [0, 1, 0, 2, 1]
