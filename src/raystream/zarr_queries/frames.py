"""Packed chunks that may come from anywhere: how long they are unpacked, before they are.

Unpackers trust what a chunk says of itself. One of a few kilobytes can fill all memory, and
Blosc reads behind the end of one that was cut off.
"""

from __future__ import annotations

import struct
import zlib

__all__ = ["check_frame"]

_ZSTD_MAGIC = 0xFD2FB528

#: Deflated bytes take at least this part of what they become.
_DEFLATE_RATIO = 1032

#: Bytes that are unpacked at a time, to be counted.
_STEP = 1 << 20


def check_frame(compressor: str | None, frame: bytes | memoryview, limit: int) -> None:
    """Refuse a chunk that is cut off, or becomes longer than a chunk is.

    Parameters
    ----------
    compressor : {"blosc", "zstd", "lz4", "zlib", "gzip", None}
    frame : bytes
    limit : int
        Bytes that it may become.

    Raises
    ------
    ValueError
        If it does.
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
        raise ValueError("a chunk is cut off, or none")
    if length > limit:
        raise ValueError(f"a chunk claims {length:,} bytes, of at most {limit:,}")


def _blosc_length(frame: bytes | memoryview) -> int:
    if len(frame) < 16:
        return -1
    length, _, packed_length = struct.unpack_from("<III", frame, 4)
    return length if packed_length == len(frame) else -1


def _zstd_length(frame: bytes | memoryview) -> int:
    """What the frame's header says (RFC 8878, section 3.1.1)."""
    if len(frame) < 6 or struct.unpack_from("<I", frame)[0] != _ZSTD_MAGIC:
        return -1
    descriptor = frame[4]
    is_single_segment = descriptor >> 5 & 1
    size = (is_single_segment, 2, 4, 8)[descriptor >> 6]
    begin = 5 + (1 - is_single_segment) + (0, 1, 2, 4)[descriptor & 3]
    if size == 0:
        raise ValueError("a chunk does not say how long it is; store it with Zarr's own zstd")
    if len(frame) < begin + size:
        return -1
    length = int.from_bytes(frame[begin : begin + size], "little")
    return length + 256 if size == 2 else length


def _deflated_length(frame: bytes | memoryview, limit: int) -> int:
    """How long it becomes, or more than `limit`; 0 if it is too short to become too long."""
    if len(frame) * _DEFLATE_RATIO <= limit:
        return 0
    unpacking = zlib.decompressobj(47)  # either header
    length, rest = 0, bytes(frame)
    while rest and not unpacking.eof and length <= limit:
        length += len(unpacking.decompress(rest, _STEP))
        rest = unpacking.unconsumed_tail
    return length
