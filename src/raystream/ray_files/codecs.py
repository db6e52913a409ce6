"""Codecs of untrusted stores: only codecs that decode numbers are allowed.

Zarr decodes with any codec that a store names, including some that unpickle. Only the codecs
listed below are accepted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

__all__ = ["Coding", "find_coding"]

#: Compressors whose chunks `compressed_chunks` can measure before decompression.
COMPRESSORS = frozenset(("blosc", "zstd", "lz4", "zlib", "gzip"))

#: numcodecs ids, as named by Zarr v2, and by v3 with a prefix.
_NUMCODECS = COMPRESSORS | {
    "shuffle",
    "delta",
    "bitround",
    "fixedscaleoffset",
    "quantize",
    "astype",
}

_V3 = frozenset(("bytes", "transpose", "blosc", "zstd", "gzip", "crc32c"))
_PREFIX = "numcodecs."
_SHARDING = "sharding_indexed"


class Coding(NamedTuple):
    """How chunks of an array are stored.

    Attributes
    ----------
    compressor : str or None
        The compressor of its chunks.
    trailer : int
        Bytes of a checksum at the end of a chunk.
    is_sharded : bool
        Whether files hold several chunks (shards).
    """

    compressor: str | None
    trailer: int
    is_sharded: bool


def find_coding(metadata: Mapping[str, Any]) -> Coding:
    """Find how an array is stored, and reject codecs not known to be safe.

    Parameters
    ----------
    metadata : mapping
        Parsed metadata file: ``.zarray`` or ``zarr.json``.

    Raises
    ------
    ValueError
        If it names another codec, or an unsupported combination; the message says which.
    """
    if metadata.get("zarr_format") == 2:
        named = [*(metadata.get("filters") or ()), metadata.get("compressor")]
        ids = [codec.get("id") for codec in named if codec is not None]
        return _coding([_known(name, _NUMCODECS) for name in ids], False)
    codecs: list[Any] = list(metadata.get("codecs") or ())
    names = [codec if isinstance(codec, str) else codec.get("name") for codec in codecs]
    if names != [_SHARDING]:
        return _coding(_v3_names(names), False)
    inside = codecs[0]["configuration"]
    for codec in inside.get("index_codecs") or ():
        _known(codec.get("name"), frozenset(("bytes", "crc32c")))
    coding = _coding(_v3_names([codec.get("name") for codec in inside["codecs"]]), True)
    if coding.compressor == "blosc":
        raise ValueError("uses the codec 'blosc' in shards, which is not supported")
    return coding


def _v3_names(names: Iterable[Any]) -> list[str]:
    return [
        _known(name.removeprefix(_PREFIX), _NUMCODECS, name)
        if isinstance(name, str) and name.startswith(_PREFIX)
        else _known(name, _V3)
        for name in names
    ]


def _known(name: Any, known: frozenset[str], shown: Any = None) -> str:
    if not isinstance(name, str) or name not in known:
        raise ValueError(f"uses the codec {shown or name!r:.40}, which is not supported")
    return name


def _coding(names: list[str], is_sharded: bool) -> Coding:
    trailer = 0
    if names and names[-1] == "crc32c":
        names, trailer = names[:-1], 4
    found = [name for name in names if name in COMPRESSORS]
    if len(found) > 1 or (found and names[-1] not in COMPRESSORS) or "crc32c" in names:
        raise ValueError("is compressed more than once, which is not supported")
    return Coding(found[0] if found else None, trailer, is_sharded)
