"""Radiance images: all three kinds of rows, and damaged files."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.rgbe import read_rgbe, write_rgbe

HEADER = b"#?RADIANCE\nSOFTWARE=none\nFORMAT=32-bit_rle_rgbe\n\n"


def picture(height, width):
    """Pixels of which some repeat, along rows and by channel."""
    random = np.random.default_rng(5)
    pixels = random.integers(0, 256, (height, width, 4), np.uint8)
    pixels[:, :, 3] = random.integers(120, 140, (height, width))
    pixels[0, 1:] = pixels[0, 0]
    pixels[1, width // 2 :, :2] = 7
    pixels[2, 2:5] = 0
    pixels[:, :2, 2] |= 2  # neither 1, 1, 1 nor 2, 2 at a row's beginning
    pixels[:, 0, 0] = 9
    return pixels


def linear(pixels):
    """By the format's definition, number by number."""
    colors = np.zeros((*pixels.shape[:2], 3))
    for at in np.ndindex(*pixels.shape[:2]):
        *mantissas, exponent = pixels[at].tolist()
        colors[at] = [m * 2.0 ** (exponent - 136) if exponent else 0.0 for m in mantissas]
    return colors.astype(np.float32)


def flat(row):
    return row.tobytes()


def old(row):
    """Repeated pixels as 1, 1, 1 and a count, of two such pixels where one is not enough."""
    content, k = b"", 0
    while k < len(row):
        count = 1
        while k + count < len(row) and (row[k + count] == row[k]).all():
            count += 1
        content += row[k].tobytes()
        rest = count - 1
        while rest:
            content += bytes([1, 1, 1, rest & 255])
            rest >>= 8
        k += count
    return content


def new(row):
    content = bytes([2, 2, len(row) >> 8, len(row) & 255])
    for channel in row.T:
        k = 0
        while k < len(row):
            count = 1
            while k + count < len(row) and count < 127 and channel[k + count] == channel[k]:
                count += 1
            if count > 1:
                content += bytes([128 + count, channel[k]])
            else:
                content += bytes([1, channel[k]])
            k += count
    return content


def packed(pixels, pack, header=HEADER, size=None):
    height, width = pixels.shape[:2]
    size = size or f"-Y {height} +X {width}\n".encode()
    return header + size + b"".join(pack(row) for row in pixels)


def read(folder, content):
    path = folder / "sky.hdr"
    path.write_bytes(content)
    return read_rgbe(str(path))


@pytest.mark.parametrize(
    ("pack", "width"),
    [(flat, 5), (flat, 40), (old, 5), (old, 700), (new, 8), (new, 40), (new, 700)],
)
def test_rows_are_unpacked(tmp_path, pack, width):
    pixels = picture(3, width)
    found = read(tmp_path, packed(pixels, pack))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, linear(pixels))


def test_literals_of_many_bytes_are_unpacked(tmp_path):
    pixels = picture(3, 100)
    content = b"".join(
        bytes([2, 2, 0, 100])
        + b"".join(bytes([60, *c[:60].tolist(), 40, *c[60:].tolist()]) for c in row.T)
        for row in pixels
    )
    found = read(tmp_path, HEADER + b"-Y 3 +X 100\n" + content)
    np.testing.assert_array_equal(found, linear(pixels))


def test_sides_may_be_turned_and_exposures_are_taken_back(tmp_path):
    pixels = picture(3, 9)
    header = b"#?RGBE\nEXPOSURE=4\nEXPOSURE= 0.5\n\n"
    found = read(tmp_path, packed(pixels, new, header, b"+Y 3 -X 9\n"))
    np.testing.assert_array_equal(found, linear(pixels)[::-1, ::-1] / 2)


PIXELS = picture(3, 40)
WHOLE = packed(PIXELS, new)
SIZE = b"-Y 3 +X 40\n"
START = len(HEADER) + len(SIZE)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not a Radiance image"),
        (b"\x89PNG\r\n\x1a\n\n\n", "not a Radiance image"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", "not a Radiance image"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n1234", "expected the format"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n1234", "exposure"),
        (b"#?RADIANCE\nEXPOSURE=much\n\n-Y 1 +X 1\n1234", "exposure"),
        (HEADER, "expected a size"),
        (HEADER + b"+X 4 -Y 3\n", "expected a size"),
        (HEADER + b"-Y 3\n", "expected a size"),
        (HEADER + b"-Y 0 +X 4\n", "empty or too large"),
        (HEADER + b"-Y 999999999 +X 999999999\n", "empty or too large"),
        (HEADER + b"-Y 20000 +X 20000\n", "empty or too large"),
        (HEADER + SIZE, "is truncated"),
        (WHOLE[: START + 3], "is truncated"),
        (WHOLE[: START + 5], "is truncated"),
        (WHOLE[:-1], "is truncated"),
        (packed(PIXELS, flat)[:-1], "is truncated"),
        (HEADER + SIZE + bytes([2, 2, 0, 41]) + bytes(400), "not as wide"),
        (HEADER + SIZE + bytes([2, 2, 0, 40, 0]) + bytes(400), "a run does not fit"),
        (HEADER + SIZE + bytes([2, 2, 0, 40, 128 + 41]) + bytes(400), "a run does not fit"),
        (HEADER + SIZE + bytes([2, 2, 0, 40, 41]) + bytes(400), "a run does not fit"),
        (HEADER + SIZE + bytes([1, 1, 1, 4]) + bytes(400), "a run does not fit"),
        (HEADER + SIZE + bytes([9, 9, 9, 9, 1, 1, 1, 40]) + bytes(400), "a run does not fit"),
        (HEADER + SIZE + bytes([9] * 4 + [1, 1, 1, 0] * 5) + bytes(400), "a run does not fit"),
    ],
)
def test_a_damaged_file_is_one_clear_error(tmp_path, content, reason):
    with pytest.raises(rs.FileFormatError, match=rf"sky\.hdr: .*{reason}") as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    for path in (tmp_path / "none.hdr", tmp_path):
        with pytest.raises(rs.FileFormatError, match="cannot be read"):
            read_rgbe(str(path))


@pytest.mark.parametrize("width", [1, 7, 40])
def test_written_images_are_read_to_eight_bits(tmp_path, width):
    random = np.random.default_rng(3)
    shape = (5, width, 3)
    pixels = (random.random(shape) * 10.0 ** random.integers(-30, 30, shape)).astype(np.float32)
    pixels[0, 0] = [0.99999, 5e-3, 0.0]  # rounds up to the next power of two
    pixels[1, 0] = 0.0
    path = tmp_path / "x.hdr"
    rs.Image(pixels).save(path, exposure=3.0, tone="aces")
    content = path.read_bytes()
    found = rs.Image.load(path).pixels
    stored = np.frombuffer(content[-5 * width * 4 :], np.uint8).reshape(5, width, 4)
    np.testing.assert_array_equal(found, linear(stored))
    assert (np.abs(found - pixels) <= pixels.max(axis=2, keepdims=True) / 255).all()
    np.testing.assert_array_equal(found[0, 0], [1.0, 2.0**-7, 0.0])


def test_written_numbers_are_those_that_the_format_has(tmp_path):
    hard = np.array([[[np.inf, 1.0, -1.0], [np.nan, 3e38, 1.0], [-np.inf, 0.5, np.nan]]])
    hard = np.concatenate([hard, np.full((1, 3, 3), 1e-44)]).astype(np.float32)
    write_rgbe(str(tmp_path / "x.hdr"), hard)
    most = 255 * 2.0**119
    expected = np.zeros((2, 3, 3), np.float32)
    expected[0] = [[most, 0, 0], [0, most, 0], [0, 0.5, 0]]
    np.testing.assert_array_equal(read_rgbe(str(tmp_path / "x.hdr")), expected)
