"""Packing arrays into text or bytes, and out again in JavaScript; see ``page/pack.js``."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Format of the packed text; the page refuses others.
VERSION = 1


def pack(manifest: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """Pack named arrays and what describes them, in Base64; see `packed_bytes`."""
    return base64.b64encode(packed_bytes(manifest, arrays)).decode("ascii")


def packed_bytes(
    manifest: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, level: int = 9
) -> bytes:
    """Pack named arrays and what describes them.

    The bytes of each array's words are sorted by significance, those of integers after
    subtracting their predecessor: neighbours are alike, so they compress better. What follows is
    compressed as a whole.

    Parameters
    ----------
    manifest : mapping
        Of what JSON has: numbers are finite.
    arrays : mapping of str to ndarray
        Of four-byte numbers, with any shape.
    level : int
        Of compression: 1 is the fastest, 9 the smallest.
    """
    entries, parts = {}, []
    for name, array in arrays.items():
        words = np.ascontiguousarray(array).reshape(-1)
        if words.dtype.itemsize != 4:
            raise TypeError(f"{name}: expected numbers of four bytes, got {words.dtype}")
        entries[name] = {"type": words.dtype.kind, "length": len(words)}
        parts.append(_sorted_bytes(words))
    content = b"".join(parts)
    head = json.dumps(
        {**manifest, "version": VERSION, "arrays": entries},
        separators=(",", ":"),
        allow_nan=False,
    ).encode()
    whole = len(head).to_bytes(4, "little") + head + content
    whole = zlib.crc32(whole).to_bytes(4, "little") + whole
    deflater = zlib.compressobj(level, zlib.DEFLATED, -15)
    return deflater.compress(whole) + deflater.flush()


def _sorted_bytes(words: NDArray[Any]) -> bytes:
    bits = words.view(np.uint32)
    if words.dtype.kind in "iu":
        steps = np.diff(bits, prepend=np.uint32(0)).view(np.int32)
        bits = ((steps << 1) ^ (steps >> 31)).view(np.uint32)  # small ones of either sign
    return bits.view(np.uint8).reshape(-1, 4).T.tobytes()
