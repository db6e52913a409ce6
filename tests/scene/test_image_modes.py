"""Ramps in image files of every mode that Pillow opens: as textures, and as images."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.core.errors import FileFormatError
from raystream.rendering.color import decode_srgb
from raystream.rendering.png import read_png

LEVELS = np.arange(256, dtype=np.uint8).reshape(16, 16)
WORDS = np.arange(65536, dtype=np.uint16).reshape(256, 256)
SPREAD = LEVELS.astype(np.uint16) * 257
FULL = np.full_like(LEVELS, 255)

#: Bytes nearest to all numbers of 16 bits.
ROUNDED = np.rint(np.arange(65536) / 65535 * 255).astype(np.uint8).reshape(256, 256)

PALETTE = np.stack([LEVELS, 255 - LEVELS, LEVELS // 2], axis=2)


def saved(image: Image.Image, kind: str = "PNG", **options: Any) -> bytes:
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


def of_bytes(mode: str, *channels: np.ndarray) -> Image.Image:
    height, width = channels[0].shape
    return Image.frombytes(mode, (width, height), np.stack(channels, axis=2).tobytes())


def palette_image() -> Image.Image:
    image = of_bytes("P", LEVELS)
    image.putpalette(PALETTE.reshape(-1, 3).tobytes())
    return image


def deep_png(kind: int, *channels: np.ndarray, transparent: bytes = b"") -> bytes:
    """A PNG of 16 bits per number; Pillow writes only grey ones."""

    def chunk(name: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(name + content))
        return struct.pack(">I", len(content)) + name + content + check

    height, width = channels[0].shape
    rows = np.stack(channels, axis=2).astype(">u2").reshape(height, -1)
    lines = b"".join(b"\0" + row.tobytes() for row in rows)
    head = struct.pack(">2I5B", width, height, 16, kind, 0, 0, 0)
    parts = chunk(b"IHDR", head) + (chunk(b"tRNS", transparent) if transparent else b"")
    return b"\x89PNG\r\n\x1a\n" + parts + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")


def tiff(content: bytes, size: int, bits: int, white: int) -> bytes:
    """A square TIFF; `white` is 0 or 1, as in the tag 262."""
    tags = {256: size, 257: size, 258: bits, 259: 1, 262: white, 273: 134, 277: 1, 278: size}
    tags[279] = len(content)
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    head = b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries
    return head.ljust(134, b"\0") + content


def tiff_of_12_bits(values: np.ndarray) -> bytes:
    first, second = values.reshape(-1, 2).T
    packed = np.stack([first >> 4, (first & 15) << 4 | second >> 8, second & 255], axis=1)
    return tiff(packed.astype(np.uint8).tobytes(), len(values), 12, 1)


def channels(*parts: np.ndarray) -> np.ndarray:
    return np.stack(parts, axis=2)


GREY = channels(LEVELS)
SEE_THROUGH = np.where(LEVELS == 7, 0, 255).astype(np.uint8)
FLOATS = (WORDS / 65535).astype(np.float32)
INTS = WORDS.astype(np.int32)

#: Mode in which Pillow opens it, the file, and its pixels.
FILES = {
    "1": (
        "1",
        saved(Image.fromarray(LEVELS > 99)),
        np.repeat(GREY > 99, 3, axis=2) * np.uint8(255),
    ),
    "grey": ("L", saved(of_bytes("L", LEVELS)), GREY),
    "grey with a transparent one": (
        "L",
        saved(of_bytes("L", LEVELS), transparency=7),
        channels(LEVELS, LEVELS, LEVELS, SEE_THROUGH),
    ),
    "grey and alpha": (
        "LA",
        saved(of_bytes("LA", LEVELS, 255 - LEVELS)),
        channels(LEVELS, LEVELS, LEVELS, 255 - LEVELS),
    ),
    "palette": ("P", saved(palette_image()), PALETTE),
    "palette with alpha": (
        "P",
        saved(palette_image(), transparency=bytes(range(255, -1, -1))),
        channels(*np.moveaxis(PALETTE, 2, 0), 255 - LEVELS),
    ),
    "palette of GIF": (
        "P",
        saved(palette_image(), "GIF", transparency=7, optimize=False),
        channels(*np.moveaxis(PALETTE, 2, 0), SEE_THROUGH),
    ),
    "color": ("RGB", saved(of_bytes("RGB", *np.moveaxis(PALETTE, 2, 0))), PALETTE),
    "color and alpha": (
        "RGBA",
        saved(of_bytes("RGBA", LEVELS, FULL, 255 - LEVELS, LEVELS)),
        channels(LEVELS, FULL, 255 - LEVELS, LEVELS),
    ),
    "CMYK": (
        "CMYK",
        saved(of_bytes("CMYK", LEVELS, 0 * LEVELS, 0 * LEVELS, 0 * LEVELS), "TIFF"),
        channels(255 - LEVELS, FULL, FULL),
    ),
    "16 bits": ("I;16", saved(Image.fromarray(WORDS)), channels(ROUNDED)),
    "16 bits with a transparent one": (
        "I;16",
        deep_png(0, SPREAD, transparent=struct.pack(">H", 7 * 257)),
        channels(LEVELS, LEVELS, LEVELS, SEE_THROUGH),
    ),
    "16 bits and alpha": (
        "RGBA",
        deep_png(4, SPREAD, SPREAD[::-1]),
        channels(LEVELS, LEVELS, LEVELS, LEVELS[::-1]),
    ),
    "color of 16 bits": (
        "RGB",
        deep_png(2, SPREAD, SPREAD[::-1], SPREAD.T),
        channels(LEVELS, LEVELS[::-1], LEVELS.T),
    ),
    "color of 16 bits and alpha": (
        "RGBA",
        deep_png(6, SPREAD, SPREAD[::-1], SPREAD.T, SPREAD),
        channels(LEVELS, LEVELS[::-1], LEVELS.T, LEVELS),
    ),
    "16 bits of TIFF": ("I;16", saved(Image.fromarray(WORDS), "TIFF"), channels(ROUNDED)),
    "16 bits of TIFF, big-endian": (
        "I;16B",
        saved(Image.frombytes("I;16B", (256, 256), WORDS.astype(">u2").tobytes()), "TIFF"),
        channels(ROUNDED),
    ),
    "12 bits of TIFF": (
        "I;16",
        tiff_of_12_bits(np.arange(4096).reshape(64, 64)),
        np.rint(np.arange(4096) / 4095 * 255).astype(np.uint8).reshape(64, 64, 1),
    ),
    "16 bits of TIFF, white is 0": (
        "I;16",
        tiff(WORDS.tobytes(), 256, 16, 0),
        255 - channels(ROUNDED),
    ),
    "16 bits of PGM": ("I", saved(Image.fromarray(INTS), "PPM"), channels(ROUNDED)),
    "32 bits of TIFF": ("I", saved(Image.fromarray(INTS), "TIFF"), channels(ROUNDED)),
    "floats of TIFF": ("F", saved(Image.fromarray(FLOATS), "TIFF"), channels(ROUNDED)),
    "floats of PFM": ("F", saved(Image.fromarray(FLOATS), "PPM"), channels(ROUNDED)),
}


@pytest.mark.parametrize("name", FILES)
def test_ramps_keep_their_values(tmp_path, name):
    mode, file, pixels = FILES[name]
    assert Image.open(io.BytesIO(file)).mode == mode
    found = rs.Texture(file).pixels()
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, pixels)
    if file.startswith(b"\x89PNG"):
        (tmp_path / "a.png").write_bytes(file)
        colors = np.broadcast_to(pixels[:, :, :3], (*pixels.shape[:2], 3))
        np.testing.assert_array_equal(read_png(str(tmp_path / "a.png")), decode_srgb(colors))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.array([[0.0, 1.5]], np.float32), "greys are from 0 to 1.5, not from 0 to 1;"),
        (np.array([[-0.5, 1.0]], np.float32), "greys are from -0.5 to 1,"),
        (np.array([[np.nan, 1.0]], np.float32), "greys are from nan"),
        (np.array([[0, 1 << 20]], np.int32), "not from 0 to 65535; scale them"),
        (np.array([[-1, 9]], np.int32), "greys are from -1 to 9"),
    ],
)
def test_greys_without_a_known_white_are_refused(values, says):
    with pytest.raises(FileFormatError, match=says):
        rs.Texture(saved(Image.fromarray(values), "TIFF")).pixels()


def test_the_alpha_of_a_transparent_grey_cuts_out():
    mask = rs.Texture(FILES["16 bits with a transparent one"][1]).alpha()
    np.testing.assert_array_equal(mask.pixels()[:, :, 0], SEE_THROUGH)
