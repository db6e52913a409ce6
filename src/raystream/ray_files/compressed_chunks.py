"""Compressed chunks of untrusted stores: their decompressed length, before decompression.

Decompressors trust a chunk's header. A chunk of a few kilobytes can fill all memory, and
Blosc reads past the end of a truncated one.
"""

from __future__ import annotations

import struct
import zlib

__all__ = ["check_chunk"]

_ZSTD_MAGIC = 0xFD2FB528

#: Maximum ratio of deflate.
_DEFLATE_RATIO = 1032

#: Bytes decompressed at a time while measuring.
_STEP = 1 << 20


def check_chunk(compressor: str | None, frame: bytes | memoryview, limit: int) -> None:
    """Reject a chunk that is truncated or decompresses to more than the limit.

    Parameters
    ----------
    compressor : {"blosc", "zstd", "lz4", "zlib", "gzip", None}
    frame : bytes
    limit : int
        Maximum decompressed bytes.

    Raises
    ------
    ValueError
        If it is truncated, malformed or too long.
    """
    if compressor == "blosc":
        length = _blosc_length(frame)
    elif compressor == "zstd":
        length = _zstd_length(frame)
    elif compressor == "lz4":
        length = struct.unpack_from("<I", frame)[0] if len(frame) >= 4 else -1
    elif compressor in ("zlib", "gzip"):
        length = _deflated_length(frame, limit)
    else:
        length = len(frame)
    if length < 0:
        raise ValueError("a chunk is truncated or malformed")
    if length > limit:
        raise ValueError(f"a chunk claims {length:,} bytes; the limit is {limit:,}")


def _blosc_length(frame: bytes | memoryview) -> int:
    if len(frame) < 16:
        return -1
    length, _, packed_length = struct.unpack_from("<III", frame, 4)
    return length if packed_length == len(frame) else -1


def _zstd_length(frame: bytes | memoryview) -> int:
    """Read the length in the frame's header (RFC 8878, section 3.1.1)."""
    if len(frame) < 6 or struct.unpack_from("<I", frame)[0] != _ZSTD_MAGIC:
        return -1
    descriptor = frame[4]
    is_single_segment = descriptor >> 5 & 1
    size = (is_single_segment, 2, 4, 8)[descriptor >> 6]
    begin = 5 + (1 - is_single_segment) + (0, 1, 2, 4)[descriptor & 3]
    if size == 0:
        raise ValueError("a chunk does not state its length; store it with Zarr's own zstd")
    if len(frame) < begin + size:
        return -1
    length = int.from_bytes(frame[begin : begin + size], "little")
    return length + 256 if size == 2 else length


def _deflated_length(frame: bytes | memoryview, limit: int) -> int:
    """Measure the decompressed length, stopping past `limit`; 0 if too short to exceed it."""
    if len(frame) * _DEFLATE_RATIO <= limit:
        return 0
    unpacking = zlib.decompressobj(47)  # either header
    length, rest = 0, bytes(frame)
    while rest and not unpacking.eof and length <= limit:
        length += len(unpacking.decompress(rest, _STEP))
        rest = unpacking.unconsumed_tail
    return length
