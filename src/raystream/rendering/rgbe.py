"""Radiance images (``.hdr``): RGBE, three 8-bit mantissas with a shared exponent.

References
----------
Ward, "Real Pixels", Graphics Gems II, 1991; "Radiance File Formats" of the Radiance manual.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.core.memory import check_memory
from raystream.rendering.rgbe_rows import BAD_RUN, BAD_WIDTH, TRUNCATED, WHOLE, unpack_rows
from raystream.rendering.software_tag import SOFTWARE

_MAX_PIXELS = 1 << 28
_BYTES_PER_PIXEL = 32  # as bytes, and as float32 with temporaries

#: Longest header in bytes.
_MAX_HEADER = 1 << 16

#: Largest number of the format: an exponent of 127 and a mantissa of 255 of 256.
_MOST = np.float32(2.0**127 * 255.0 / 256.0)

_FAULTS = {
    TRUNCATED: "is truncated",
    BAD_RUN: "is corrupt: a run does not fit its row",
    BAD_WIDTH: "is corrupt: a row is not as wide as the image",
}


def read_rgbe(path: str) -> NDArray[np.float32]:
    """Read a Radiance image.

    Parameters
    ----------
    path : str
        Rows may be flat, or run-length encoded in the old or the new format. The header's
        exposures are divided out.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        Linear RGB, top row first: mantissa times 2**(exponent - 136).

    Raises
    ------
    FileFormatError
        If the file is missing, corrupt, too large, in XYZ, or stored by columns.
    MemoryError
        If it does not fit into memory.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(_MAX_HEADER)
            content = head
            if head.startswith(b"#?"):
                file.seek(0)
                content = file.read(_MAX_HEADER + 4 * _MAX_PIXELS)
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise FileFormatError(path, f"cannot be read ({reason})") from error
    header, end, rest = head.partition(b"\n\n")
    if not (header.startswith(b"#?") and end):
        raise FileFormatError(path, "is not a Radiance image: its header has no beginning or end")
    exposure = _exposure_of(path, header)
    line = rest.partition(b"\n")[0]
    found = re.fullmatch(rb"([-+])Y (\d{1,9}) ([-+])X (\d{1,9})\s*", line)
    if found is None:
        shown = line[:40].decode("ascii", "replace")
        raise FileFormatError(path, f"expected a size such as -Y 512 +X 1024, got {shown!r}")
    height, width = int(found[2]), int(found[4])
    if not 0 < width * height <= _MAX_PIXELS:
        raise FileFormatError(path, f"image of {width}x{height} is empty or too large")
    check_memory(width * height * _BYTES_PER_PIXEL, f"{path}: {width}x{height} pixels would")
    pixels = np.empty((height, width, 4), np.uint8)
    start = len(header) + len(end) + len(line) + 1
    fault = unpack_rows(np.frombuffer(content, np.uint8), start, pixels)
    if fault != WHOLE:
        raise FileFormatError(path, _FAULTS[fault])
    # In float64: 2**-136 underflows in float32, the products do not.
    factor = np.ldexp(1.0 / exposure, np.arange(256) - 136)
    factor[0] = 0.0
    with np.errstate(over="ignore", under="ignore"):
        colors = pixels[:, :, :3] * factor[pixels[:, :, 3:]]
        colors = colors.astype(np.float32)
    if found[1] == b"+":
        colors = colors[::-1]
    if found[3] == b"-":
        colors = colors[:, ::-1]
    return np.ascontiguousarray(colors)


def _exposure_of(path: str, header: bytes) -> float:
    """Check the format in a header, and return the product of its exposures."""
    exposure = 1.0
    for line in header.split(b"\n"):
        name, _, value = line.partition(b"=")
        if name == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            shown = value.strip()[:40].decode("ascii", "replace")
            raise FileFormatError(path, f"expected the format 32-bit_rle_rgbe, got {shown!r}")
        if name == b"EXPOSURE":
            try:
                exposure *= float(value)
            except ValueError:
                exposure = math.nan
            if not 0.0 < exposure < math.inf:
                raise FileFormatError(path, "has an exposure that is not a number above 0")
    return exposure


def write_rgbe(path: str, pixels: NDArray[np.float32]) -> None:
    """Write a Radiance image, with flat rows.

    Parameters
    ----------
    path : str
    pixels : ndarray of shape (H, W, 3), float32
        Linear RGB. Numbers are rounded to 8 bits relative to the largest of the pixel; negative
        ones and NaN become 0, larger ones than the format has, its largest (1.7e38).

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    height, width, _ = pixels.shape
    colors = np.clip(np.nan_to_num(pixels, nan=0.0), 0.0, _MOST).astype(np.float64)
    most = colors.max(axis=2, keepdims=True)
    exponents = np.frexp(most)[1]
    exponents += np.rint(np.ldexp(most, 8 - exponents)) > 255.0  # rounded up to the next power
    encoded = np.empty((height, width, 4), np.uint8)
    encoded[:, :, :3] = np.rint(np.ldexp(colors, 8 - exponents))
    encoded[:, :, 3:] = np.maximum(exponents + 128, 0)
    encoded[(most[:, :, 0] == 0.0) | (encoded[:, :, 3] == 0)] = 0
    with open(path, "wb") as file:
        file.write(b"#?RADIANCE\nSOFTWARE=%s\nFORMAT=32-bit_rle_rgbe\n\n" % SOFTWARE.encode())
        file.write(b"-Y %d +X %d\n" % (height, width))
        file.write(encoded.tobytes())
