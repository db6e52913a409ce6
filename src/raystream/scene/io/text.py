"""Text: fast parsing of numbers in text formats."""

from __future__ import annotations

import codecs
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Byte order mark that some editors put before UTF-8 text.
BYTE_ORDER_MARK = codecs.BOM_UTF8

#: Control characters count as spaces, except for line feeds.
_PLAIN = bytes(10 if c == 10 else 32 if c < 32 or c == 127 else c for c in range(256))


def plain_text(content: bytes) -> bytes:
    r"""Make every line end in ``\n`` and every other control character a space.

    Line ends may be CR LF, LF or CR. A byte order mark is removed; UTF-16 is decoded.
    """
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        content = content.decode("utf-16", "replace").encode()
    content = content.removeprefix(BYTE_ORDER_MARK)
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    content = content.translate(_PLAIN)
    return content if content.endswith(b"\n") else content + b"\n"


def decoded(name: bytes) -> str:
    """Decode a name: UTF-8, else Latin-1, so that different names stay different."""
    try:
        return name.decode()
    except UnicodeDecodeError:
        return name.decode("latin-1")


def shown(text: bytes) -> str:
    """Quote a piece of a file for an error message: printable, at most 40 characters."""
    piece = text[:41].decode("latin-1").strip()
    piece = "".join(c if c.isprintable() and ord(c) < 127 else "?" for c in piece)
    return f'"{piece[:37]}..."' if len(piece) > 40 or len(text) > 41 else f'"{piece}"'


def parse_floats(text: bytes, count: int) -> NDArray[np.float64]:
    """Parse exactly `count` numbers separated by white space.

    Raises
    ------
    ValueError
        If a word is not a number, or their count differs.
    """
    return _parse(text, count, np.float64)


def parse_integers(text: bytes, count: int) -> NDArray[np.int64]:
    """Parse exactly `count` integers; see `parse_floats`. Too large ones are clamped."""
    return _parse(text, count, np.int64)


def _parse(text: bytes, count: int, dtype: Any) -> NDArray[Any]:
    with warnings.catch_warnings():
        # Older NumPy warns where newer NumPy raises.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            numbers = np.fromstring(text, dtype, sep=" ") if text.strip() else np.empty(0, dtype)
        except (ValueError, DeprecationWarning) as error:
            raise ValueError("not a number") from error
    if len(numbers) != count:
        raise ValueError(f"expected {count} numbers, got {len(numbers)}")
    return numbers


class Lines:
    """Plain text as lines of words, split with array operations.

    Parameters
    ----------
    text : bytes
        From `plain_text`.

    Attributes
    ----------
    starts, ends : ndarray of shape (L,), int64
        Offsets of each line's first word and of its line feed.
    word_counts : ndarray of shape (L,), int64
        Words in each line.
    """

    def __init__(self, text: bytes) -> None:
        self.text = text
        letters = np.frombuffer(text, np.uint8)
        self.ends = np.flatnonzero(letters == 10)
        filled = letters > 32
        word_begins = filled.copy()
        word_begins[1:] &= ~filled[:-1]
        words = np.flatnonzero(word_begins)
        splits = np.searchsorted(words, self.ends)
        first_word = np.concatenate([[0], splits[:-1]])
        self.word_counts = np.diff(splits, prepend=0)
        begun = self.word_counts > 0
        self.starts = self.ends.copy()
        self.starts[begun] = words[first_word[begun]]

    def __len__(self) -> int:
        return len(self.ends)

    def line(self, index: int) -> bytes:
        """Return one line, without leading white space and line feed."""
        return self.text[self.starts[index] : self.ends[index]]

    def join(self, selected: NDArray[np.bool_]) -> bytes:
        """Join the selected lines, each with its line feed; runs are copied in one piece."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], selected.view(np.int8), [0]])))
        begins, stops = edges[::2], edges[1::2]
        text = self.text
        spans = zip(self.starts[begins].tolist(), self.ends[stops - 1].tolist(), strict=True)
        return b"".join([text[begin : end + 1] for begin, end in spans])
