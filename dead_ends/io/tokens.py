"""Text files as tables of tokens, fast enough for millions of lines.

A token is a run of bytes without blanks, where the blanks are those of C: space, tab, line feed,
vertical tab, form feed and carriage return. One compiled pass finds where the tokens and the
lines of a file are; numbers are read in compiled passes over many tokens at once. What is wrong
is reported with the file and the line. Names are UTF-8, and two names are equal only if their
bytes are.

Numbers are read exactly as Python reads them: where mantissa and power of ten are exact
doubles the quotient is correctly rounded, everything else is left to ``float``.

This module imports numba, so it is imported when a text model is first read.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dead_ends.io.compressed import read_bytes
from dead_ends.model.checks import read_fraction

__all__ = ["Tokens"]

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]

_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_FRACTION = re.compile(rb"[+-]?\d+/0*[1-9]\d*")
_TENS = 10.0 ** np.arange(23)
"""The powers of ten that are exact doubles."""


class Tokens:
    """The tokens of one file, which may be compressed (``.gz``).

    Attributes:
        path: for messages.
        first: (L + 1,) line l (from 0) has the tokens first[l] to first[l + 1] - 1.
        counts: (L,) the number of tokens of each line.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._data: Bytes = np.frombuffer(read_bytes(path), dtype=np.uint8)
        tokens, lines = _count(self._data)
        self._start, self._stop = np.empty(tokens, np.int64), np.empty(tokens, np.int64)
        self.first: Integers = np.empty(lines + 1, dtype=np.int64)
        _find(self._data, self._start, self._stop, self.first)
        self.counts: Integers = np.diff(self.first)

    @property
    def ended(self) -> bool:
        """Whether the last line has its end."""
        return len(self._data) > 0 and self._data[-1] == ord("\n")

    def lines_of(self, tokens: Integers) -> Integers:
        """The line (from 0) of each token."""
        return np.searchsorted(self.first, tokens, side="right") - 1

    def error(self, line: int, message: str) -> ValueError:
        """An error at a line (from 0)."""
        return ValueError(f"{self.path}: line {line + 1}: {message}")

    def error_at(self, token: int, message: str) -> ValueError:
        """An error at a token's line."""
        return self.error(int(self.lines_of(np.array([token]))[0]), message)

    def raw(self, token: int) -> bytes:
        """The bytes of one token."""
        return self._data[self._start[token] : self._stop[token]].tobytes()

    def text(self, token: int) -> str:
        """One token, for a message."""
        return self.raw(token).decode("utf-8", errors="replace")

    def line_text(self, line: int) -> str:
        """A line from its first to its last token, blanks between them included.

        Raises:
            ValueError: naming the file and line, if it is not UTF-8.
        """
        first, after = int(self.first[line]), int(self.first[line + 1])
        return self._decoded(first, after - 1) if first < after else ""

    def name(self, token: int) -> str:
        """One token.

        Raises:
            ValueError: naming the file and line, if it is not UTF-8.
        """
        return self._decoded(token, token)

    def initials(self, tokens: Integers) -> Bytes:
        """The first byte of each token."""
        first: Bytes = self._data[self._start[tokens]]
        return first

    def finals(self, tokens: Integers) -> Bytes:
        """The last byte of each token."""
        last: Bytes = self._data[self._stop[tokens] - 1]
        return last

    def behind(self, tokens: Integers, skip: int = 0) -> Bytes:
        """The byte after each token (and ``skip`` more), a line feed after the file's last."""
        place = self._stop[tokens] + skip
        known: Bytes = self._data[np.minimum(place, len(self._data) - 1)]
        return np.where(place < len(self._data), known, np.uint8(ord("\n")))

    def adjacent(self, tokens: Integers) -> NDArray[np.bool_]:
        """Whether only one blank separates each token from the next."""
        adjacent: NDArray[np.bool_] = self._start[tokens + 1] - self._stop[tokens] == 1
        return adjacent

    def closed(self, tokens: Integers) -> NDArray[np.bool_]:
        """Whether a space or the line's end, with or without carriage return, comes next."""
        last = (self.behind(tokens) == ord("\r")) & (self.behind(tokens, 1) == ord("\n"))
        closed: NDArray[np.bool_] = last | np.isin(self.behind(tokens), (ord(" "), ord("\n")))
        return closed

    def integers(self, tokens: Integers, what: str, trim: int = 0) -> Integers:
        """Natural numbers below 2**31.

        Args:
            tokens: which.
            what: for the message.
            trim: bytes at the end of each token that do not belong to the number.

        Raises:
            ValueError: naming the file and line of the first token that is no such number.
        """
        values: Integers = _integers(self._data, self._start[tokens], self._stop[tokens] - trim)
        bad = np.flatnonzero(values < 0)
        if len(bad):
            token = int(tokens[bad[0]])
            raise self.error_at(token, f"'{self.text(token)}' is not {what}")
        return values

    def numbers(
        self,
        tokens: Integers,
        what: str,
        named: Mapping[bytes, bytes] | None = None,
        hint: Callable[[str], str] | None = None,
    ) -> NDArray[Any]:
        """Finite numbers as float64; as Fractions (dtype object) if one is written like 1/3.

        Args:
            tokens: which.
            what: for the message.
            named: tokens that stand for others, which are numbers.
            hint: what the message says besides about a token that is no number.

        Raises:
            ValueError: naming the file and line of the first token that is no number.
        """
        values: NDArray[np.float64]
        values, hard = _numbers(self._data, self._start[tokens], self._stop[tokens], _TENS)
        known: dict[bytes, float | None] = {}
        for place in np.flatnonzero(hard).tolist():
            token = int(tokens[place])
            written = self.raw(token)
            raw = (named or {}).get(written, written)
            if raw not in known:
                known[raw] = float(raw) if _NUMBER.fullmatch(raw) else None
            value = known[raw]
            if value is None and _FRACTION.fullmatch(raw):
                return self._fractions(tokens, what, named or {}, hint)
            if value is None or not np.isfinite(value):
                raise self._no_number(token, what, hint)
            values[place] = value
        return values

    def distinct(
        self, tokens: Integers, last: Integers | None = None
    ) -> tuple[list[str], Integers]:
        """The different texts among the tokens, and which of them each token is.

        With ``last``, texts reach from a token to another, blanks between them included.

        Raises:
            ValueError: naming the file and line of the first text that is not UTF-8.
        """
        last = tokens if last is None else last
        start, stop = self._start[tokens], self._stop[last]
        hashes = _hashes(self._data, start, stop)
        _, examples, which = np.unique(hashes, return_index=True, return_inverse=True)
        like = examples[which]
        if not _same(self._data, start, stop, start[like], stop[like]):  # two texts, one hash
            examples, which = self._exactly_distinct(start, stop)
        order = np.argsort(examples)  # by first appearance
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        names = [self._decoded(int(tokens[at]), int(last[at])) for at in examples[order]]
        return names, place[which]

    def _exactly_distinct(self, start: Integers, stop: Integers) -> tuple[Integers, Integers]:
        """The first place of each different text, and which of them each text is."""
        known: dict[bytes, int] = {}
        content = self._data.tobytes()
        texts = (content[a:b] for a, b in zip(start.tolist(), stop.tolist(), strict=True))
        which = np.array([known.setdefault(text, len(known)) for text in texts], dtype=np.int64)
        return np.unique(which, return_index=True)[1], which

    def _decoded(self, token: int, last: int) -> str:
        content = self._data[self._start[token] : self._stop[last]].tobytes()
        try:
            return content.decode("utf-8")
        except UnicodeDecodeError:
            raise self.error_at(token, f"{content!r} is not UTF-8") from None

    def _no_number(self, token: int, what: str, hint: Callable[[str], str] | None) -> ValueError:
        text = self.text(token)
        return self.error_at(token, f"'{text}' is not {what}{hint(text) if hint else ''}")

    def _fractions(
        self,
        tokens: Integers,
        what: str,
        named: Mapping[bytes, bytes],
        hint: Callable[[str], str] | None,
    ) -> NDArray[np.object_]:
        values = np.empty(len(tokens), dtype=object)
        for place, token in enumerate(tokens.tolist()):
            written = self.raw(token)
            raw = named.get(written, written)
            if not (_NUMBER.fullmatch(raw) or _FRACTION.fullmatch(raw)):
                raise self._no_number(token, what, hint)
            try:
                values[place] = read_fraction(raw.decode())
            except ValueError as error:
                raise self.error_at(token, str(error)) from None
        return values


@njit(cache=True)
def _is_blank(byte):  # type: ignore[no-untyped-def]  # numba infers types
    return byte == 32 or 9 <= byte <= 13


@njit(cache=True)
def _count(data):  # type: ignore[no-untyped-def]  # numba infers types
    """The numbers of tokens and of lines; a last line need not be ended."""
    tokens, lines, inside, ended = 0, 0, False, True
    for byte in data:
        blank = _is_blank(byte)
        if not blank and not inside:
            tokens += 1
        inside = not blank
        ended = byte == 10
        if ended:
            lines += 1
    return tokens, lines if ended else lines + 1


@njit(cache=True)
def _find(data, start, stop, first):  # type: ignore[no-untyped-def]  # numba infers types
    token, line, inside = 0, 0, False
    first[0] = 0
    for place in range(len(data)):
        blank = _is_blank(data[place])
        if not blank and not inside:
            start[token] = place
        if blank and inside:
            stop[token] = place
            token += 1
        inside = not blank
        if data[place] == 10:
            line += 1
            first[line] = token
    if inside:
        stop[token] = len(data)
    first[len(first) - 1] = len(start)


@njit(cache=True)
def _integers(data, start, stop):  # type: ignore[no-untyped-def]  # numba infers types
    """-1 where a token is not a natural number below 2**31."""
    values = np.empty(len(start), dtype=np.int64)
    for token in range(len(start)):
        value, good = np.int64(0), 0 < stop[token] - start[token] <= 10
        for place in range(start[token], stop[token] if good else start[token]):
            digit = np.int64(data[place]) - 48
            good &= 0 <= digit <= 9
            value = value * 10 + digit
        values[token] = value if good and value < 2**31 else -1
    return values


@njit(cache=True)
def _numbers(data, start, stop, tens):  # type: ignore[no-untyped-def]  # numba infers types
    """Plain decimals with at most 15 digits; the others are marked as hard."""
    values = np.zeros(len(start), dtype=np.float64)
    hard = np.zeros(len(start), dtype=np.bool_)
    for token in range(len(start)):
        mantissa, digits, decimals, after_point = np.int64(0), 0, 0, False
        for place in range(start[token], stop[token]):
            digit = np.int64(data[place]) - 48
            if 0 <= digit <= 9 and digits < 15:
                mantissa = mantissa * 10 + digit
                digits += 1
                decimals += after_point
            elif data[place] == 46 and not after_point:
                after_point = True
            else:
                hard[token] = True
                break
        hard[token] |= digits == 0
        values[token] = mantissa / tens[decimals]
    return values, hard


@njit(cache=True)
def _hashes(data, start, stop):  # type: ignore[no-untyped-def]  # numba infers types
    """FNV-1a, 64 bit."""
    values = np.empty(len(start), dtype=np.uint64)
    for token in range(len(start)):
        value = np.uint64(14695981039346656037)
        for place in range(start[token], stop[token]):
            value = (value ^ np.uint64(data[place])) * np.uint64(1099511628211)
        values[token] = value
    return values


@njit(cache=True)
def _same(data, start, stop, other, end):  # type: ignore[no-untyped-def]  # numba infers types
    """Whether each text equals the other one at its place."""
    for text in range(len(start)):
        if stop[text] - start[text] != end[text] - other[text]:
            return False
        for place in range(stop[text] - start[text]):
            if data[start[text] + place] != data[other[text] + place]:
                return False
    return True
