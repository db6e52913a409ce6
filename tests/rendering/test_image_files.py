"""Layers of images, written to files and read back."""

from __future__ import annotations

import sys
import zlib

import numpy as np
import pytest
from PIL import Image as PillowImage

import raystream as rs
from extras import need
from raystream.core.errors import FileFormatError
from raystream.rendering.color import decode_srgb
from raystream.rendering.layers import channels_of, layers_of

HEIGHT, WIDTH = 5, 7


@pytest.fixture
def layered():
    """An image with every kind of layer, and hard numbers in them."""
    rng = np.random.default_rng(2)
    pixels = rng.normal(0, 1e3, (HEIGHT, WIDTH, 3)).astype(np.float32)
    pixels[0, 0] = [np.inf, 1e-40, 3e38]
    prim_id = rng.integers(-1, 1 << 30, (HEIGHT, WIDTH)).astype(np.int32)
    prim_id[0, :3] = [-1, np.iinfo(np.int32).max, np.iinfo(np.int32).min]
    depth = rng.random((HEIGHT, WIDTH)).astype(np.float32)
    depth[1, 1] = np.inf
    layers = {
        "depth": depth,
        "normal": rng.normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32),
        "albedo": rng.random((HEIGHT, WIDTH, 3)),
        "prim_id": prim_id,
        "samples": np.full((HEIGHT, WIDTH), 4),
        "variance": rng.random((HEIGHT, WIDTH, 3)).astype(np.float32),
        "steps": rng.integers(0, 9, (HEIGHT, WIDTH, 3)),
    }
    return rs.Image(pixels, layers, {"rays": 3})


def test_layers_become_arrays(layered):
    assert layered.layers["albedo"].dtype == np.float32
    assert layered.layers["samples"].dtype == layered.layers["steps"].dtype == np.int32
    assert layered.figures == {"rays": 3}
    assert rs.Image(layered.pixels).layers == {}


@pytest.mark.parametrize(
    ("name", "layer"),
    [
        ("depth", np.zeros((HEIGHT, WIDTH + 1))),
        ("depth", np.zeros((HEIGHT, WIDTH, 2))),
        ("depth", np.zeros((HEIGHT, WIDTH), complex)),
        ("prim_id", np.full((HEIGHT, WIDTH), 1 << 31)),
        ("", np.zeros((HEIGHT, WIDTH))),
        ("a\0b", np.zeros((HEIGHT, WIDTH))),
        ("long" * 100, np.zeros((HEIGHT, WIDTH))),
    ],
)
def test_bad_layer_is_refused(name, layer):
    with pytest.raises(ValueError, match=r"^layers: "):
        rs.Image(np.zeros((HEIGHT, WIDTH, 3)), {name: layer})


def test_channels_have_the_usual_names(layered):
    names = [name for name, _ in channels_of(layered.layers)]
    assert names[:7] == ["Z", "N.X", "N.Y", "N.Z", "albedo.R", "albedo.G", "albedo.B"]
    assert {"prim_id", "samples", "variance.R", "steps.B"} <= set(names)


def test_channels_of_others_are_kept_apart():
    """Three colours are a layer only if all are there, alike, and the name is free."""
    plane, whole = np.zeros((2, 2), np.float32), np.zeros((2, 2), np.int32)
    channels = {"a.R": plane, "a.G": plane, "b.R": plane, "b.G": plane, "b.B": whole}
    channels |= {"c.R": plane, "c.G": plane, "c.B": plane, "c": whole, "Z": plane, "depth": whole}
    assert layers_of(channels).keys() == channels.keys()


# EXR.


@pytest.fixture
def openexr():
    need("OpenEXR")
    import OpenEXR

    return OpenEXR


def test_exr_comes_back_bit_for_bit(layered, tmp_path, openexr):
    layered.save(tmp_path / "x.exr")
    found = rs.Image.load(tmp_path / "x.exr")
    assert found.pixels.tobytes() == layered.pixels.tobytes()
    assert found.layers.keys() == layered.layers.keys()
    for name, layer in layered.layers.items():
        assert found.layers[name].dtype == layer.dtype
        assert found.layers[name].tobytes() == layer.tobytes(), name


def test_exr_has_channels_that_others_know(layered, tmp_path, openexr):
    layered.save(tmp_path / "x.exr")
    with openexr.File(str(tmp_path / "x.exr"), separate_channels=True) as file:
        channels = file.channels()
        np.testing.assert_array_equal(channels["Z"].pixels, layered.layers["depth"])
        np.testing.assert_array_equal(channels["G"].pixels, layered.pixels[..., 1])
        np.testing.assert_array_equal(channels["N.Y"].pixels, layered.layers["normal"][..., 1])
        assert channels["prim_id"].pixels.dtype == np.uint32


def write_exr(openexr, path, channels, **header):
    with openexr.File(header, channels) as file:
        file.write(str(path))


def test_exr_of_others(tmp_path, openexr):
    """Half floats, opacity and greys."""
    half = np.arange(6, dtype=np.float16).reshape(2, 3)
    write_exr(openexr, tmp_path / "x.exr", dict.fromkeys("RGBA", half))
    image = rs.Image.load(tmp_path / "x.exr")
    np.testing.assert_array_equal(image.pixels, np.stack([half] * 3, axis=2))
    assert image.layers["A"].dtype == np.float32
    write_exr(openexr, tmp_path / "y.exr", {"Y": half})
    np.testing.assert_array_equal(rs.Image.load(tmp_path / "y.exr").pixels, image.pixels)


def test_exr_without_colours_is_refused(tmp_path, openexr):
    write_exr(openexr, tmp_path / "x.exr", {"Z": np.zeros((2, 3), np.float32)})
    with pytest.raises(FileFormatError, match="no colours"):
        rs.Image.load(tmp_path / "x.exr")


def test_exr_of_several_parts_is_refused(tmp_path, openexr):
    plane = {"R": np.zeros((2, 3), np.float32)}
    parts = [openexr.Part({}, plane, name) for name in ("a", "b")]
    with openexr.File(parts) as file:
        file.write(str(tmp_path / "x.exr"))
    with pytest.raises(FileFormatError, match="2 parts"):
        rs.Image.load(tmp_path / "x.exr")


def test_exr_that_claims_too_much_is_refused_unread(layered, tmp_path, openexr):
    path = tmp_path / "x.exr"
    layered.save(path)
    content = bytearray(path.read_bytes())
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    for corner in ((60_000, 60_000), (-3, 2)):
        content[at + 8 : at + 16] = np.array(corner, "<i4").tobytes()
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=r"x\.exr: "):
            rs.Image.load(path)


def test_picture_that_memory_cannot_hold_is_refused(layered, tmp_path, monkeypatch):
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 100)
    layered.save(tmp_path / "x.png")
    with pytest.raises(MemoryError, match=r"x\.png.* 7x5"):
        rs.Image.load(tmp_path / "x.png")
    need("OpenEXR")
    layered.save(tmp_path / "x.exr")
    with pytest.raises(MemoryError, match=r"x\.exr.* 7x5"):
        rs.Image.load(tmp_path / "x.exr")


@pytest.mark.parametrize("cut", [0, 4, 60, -30])
@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_file_that_is_cut_off_is_refused(layered, tmp_path, suffix, cut):
    if suffix == ".exr":
        need("OpenEXR")
    path = tmp_path / f"x{suffix}"
    layered.save(path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(FileFormatError, match=rf"x\{suffix}: is not a complete"):
        rs.Image.load(path)


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_missing_file_and_folder_are_refused(tmp_path, suffix):
    if suffix == ".exr":
        need("OpenEXR")
    with pytest.raises(FileFormatError, match="no such file"):
        rs.Image.load(tmp_path / f"x{suffix}")
    (tmp_path / f"y{suffix}").mkdir()
    with pytest.raises(FileFormatError, match="folder"):
        rs.Image.load(tmp_path / f"y{suffix}")


def test_other_names_are_refused():
    with pytest.raises(ValueError, match=r"must end in \.png or \.exr or \.hdr"):
        rs.Image.load("x.jpg")


def test_reading_exr_without_openexr_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ImportError, match=r"reading .*raystream\[exr\]"):
        rs.Image.load(tmp_path / "x.exr")


def test_layers_that_share_a_channel_are_refused(tmp_path, openexr):
    plane = np.zeros((2, 3))
    for layers in ({"R": plane}, {"depth": plane, "Z": plane}):
        with pytest.raises(ValueError, match="channel"):
            rs.Image(np.zeros((2, 3, 3)), layers).save(tmp_path / "x.exr")
    assert not list(tmp_path.iterdir())


# PNG.


def test_png_comes_back_as_it_is_shown(tmp_path):
    every = np.arange(256, dtype=np.uint8).reshape(16, 16)
    shown = np.stack([every, every.T, 255 - every], axis=2)
    rs.Image(decode_srgb(shown)).save(tmp_path / "x.png")
    found = rs.Image.load(tmp_path / "x.png")
    np.testing.assert_array_equal(found.to_bytes(), shown)
    assert found.layers == {}


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGBA", "I;16"])
def test_every_level_of_png_of_every_mode(tmp_path, mode):
    """Alpha is dropped, and 16 bits are rounded to 8."""
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    ramp = PillowImage.fromarray(levels)
    alpha = PillowImage.new("L", ramp.size, 9)
    if mode == "1":
        levels = np.where(levels > 127, 255, 0)
        ramp = PillowImage.fromarray(levels > 127)
    elif mode == "LA":
        ramp = PillowImage.merge(mode, [ramp, alpha])
    elif mode == "RGBA":
        ramp = PillowImage.merge(mode, [ramp, ramp, ramp, alpha])
    elif mode == "P":
        ramp.putpalette(np.repeat(255 - levels, 3).tolist())
        levels = 255 - levels
    elif mode == "I;16":
        words = np.arange(65536, dtype=np.uint16).reshape(256, 256)
        levels = (words.astype(int) + 128) // 257
        ramp = PillowImage.fromarray(words)
    assert ramp.mode == mode
    ramp.save(tmp_path / "x.png")
    expected = decode_srgb(np.repeat(levels.astype(np.uint8)[:, :, None], 3, axis=2))
    np.testing.assert_array_equal(rs.Image.load(tmp_path / "x.png").pixels, expected)


def test_light_of_any_strength_is_white_in_a_png(tmp_path):
    rs.Image(np.full((1, 2, 3), np.finfo(np.float32).max)).save(tmp_path / "x.png", exposure=9.0)
    assert (rs.Image.load(tmp_path / "x.png").pixels == 1.0).all()


def test_other_formats_under_the_name_of_png_are_refused(tmp_path):
    PillowImage.new("RGB", (2, 2)).save(tmp_path / "x.png", format="BMP")
    with pytest.raises(FileFormatError, match=r"x\.png"):
        rs.Image.load(tmp_path / "x.png")


def test_png_that_claims_too_much_is_refused_unread(tmp_path):
    """Even one that Pillow would treat as a decompression bomb: the error is ours."""

    def chunk(kind, content):
        crc = zlib.crc32(kind + content).to_bytes(4, "big")
        return len(content).to_bytes(4, "big") + kind + content + crc

    size = (60_000).to_bytes(4, "big") * 2
    header = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size + bytes([8, 2, 0, 0, 0]))
    (tmp_path / "x.png").write_bytes(header + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    with pytest.raises(FileFormatError, match=r"x\.png: "):
        rs.Image.load(tmp_path / "x.png")
