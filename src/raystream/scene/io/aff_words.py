"""AFF words: a tokenizer for BART's files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.files import read_model_bytes
from raystream.scene.io.text import parse_floats, parse_integers, plain_text, shown

#: Maximum count of numbers that are parsed one by one.
_FEW = 32

_COMMENT = re.compile(rb"[#%][^\n]*")


class Words:
    """The words of one file, read in order.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        text = _COMMENT.sub(b"", plain_text(read_model_bytes(path)))
        self._words = text.replace(b"{", b" { ").replace(b"}", b" } ").split()
        self._place = 0

    def error(self, reason: str) -> FileFormatError:
        """Make the error for this file."""
        return FileFormatError(self.path, reason)

    def done(self) -> bool:
        """Whether all words have been read."""
        return self._place >= len(self._words)

    def peek(self) -> bytes:
        """Return the next word without reading it; empty at the end."""
        return b"" if self.done() else self._words[self._place]

    def word(self) -> bytes:
        """Read the next word."""
        if self.done():
            raise self.error("is truncated: it ends within a statement")
        self._place += 1
        return self._words[self._place - 1]

    def name(self) -> str:
        """Read the next word as a name."""
        word = self.word()
        if word in (b"{", b"}"):
            raise self.error(f"expected a name, found {shown(word)}")
        return word.decode("utf-8", "replace")

    def expect(self, word: bytes) -> None:
        """Read the next word, which must be this one."""
        found = self.word()
        if found != word:
            raise self.error(f"expected {shown(word)}, found {shown(found)}")

    def number_follows(self) -> bool:
        """Whether the next word is a number."""
        try:
            parse_floats(self.peek(), 1)
        except ValueError:
            return False
        return True

    def count(self, words_each: int) -> int:
        """Read a number of items, each of at least this many words, which must follow."""
        word = self.word()
        if not word.isdigit() or len(word) > 18:
            raise self.error(f"expected a number of items, found {shown(word)}")
        count = int(word)
        if count * words_each > len(self._words) - self._place:
            raise self.error(f"is truncated: it declares {count:,} items and ends before")
        return count

    def floats(self, count: int) -> NDArray[np.float64]:
        """Read numbers."""
        return self._numbers(count, parse_floats)

    def integers(self, count: int) -> NDArray[np.int64]:
        """Read integers."""
        return self._numbers(count, parse_integers)

    def _numbers(self, count: int, parse: Any) -> NDArray[Any]:
        numbers: NDArray[Any] | None
        words = self._words[self._place : self._place + count]
        if count <= _FEW and parse is parse_floats and len(words) == count:
            numbers = _few_floats(words)
            if numbers is not None:
                self._place += count
                return numbers
        if len(words) < count:
            raise self.error("is truncated: it ends within a statement")
        try:
            numbers = parse(b" ".join(words), count)
        except ValueError:
            bad = next((w for w in words if not _is_number(w, parse)), words[0])
            raise self.error(f"expected a number, found {shown(bad)}") from None
        self._place += count
        return numbers


def _few_floats(words: list[bytes]) -> NDArray[np.float64] | None:
    """Parse a few numbers, for which array operations are slow; None if one is invalid."""
    try:
        return np.array([float(word) for word in words if b"_" not in word]).reshape(len(words))
    except ValueError:
        return None


def _is_number(word: bytes, parse: Any) -> bool:
    try:
        parse(word, 1)
    except ValueError:
        return False
    return True
