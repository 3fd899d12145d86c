"""Text files that may be compressed by gzip: model.tra.gz is read as model.tra."""

from __future__ import annotations

import gzip
import os
import zlib
from pathlib import Path

__all__ = ["GZIP", "plain_path", "read_bytes"]

GZIP = ".gz"


def plain_path(path: str | os.PathLike[str]) -> Path:
    """The path without a last ``.gz``: its suffix says the format."""
    path = Path(path)
    return path.with_suffix("") if path.suffix.lower() == GZIP else path


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The content of a file, uncompressed if the path ends in ``.gz``.

    Raises:
        ValueError: naming the file, if it is damaged.
        OSError: if it cannot be read.
    """
    content = Path(path).read_bytes()
    if Path(path).suffix.lower() != GZIP:
        return content
    try:
        return gzip.decompress(content)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged, or not compressed by gzip ({error})") from None
