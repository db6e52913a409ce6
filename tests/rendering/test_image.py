import io
import sys

import numpy as np
import pytest
from PIL import Image as PillowImage

import raystream as rs
from extras import need
from raystream.rendering.color import decode_srgb, encode_srgb


@pytest.fixture
def image():
    pixels = np.linspace(0, 1, 5 * 7 * 3).reshape(5, 7, 3)
    return rs.Image(pixels)


def test_png_holds_srgb(image, tmp_path):
    image.save(tmp_path / "x.png")
    with PillowImage.open(tmp_path / "x.png") as read:
        assert read.size == image.size == (7, 5)
        np.testing.assert_array_equal(np.asarray(read), image.to_bytes())


def test_exr_holds_linear_floats(image, tmp_path):
    need("OpenEXR")
    import OpenEXR

    image.pixels[0, 0] = [1e-5, 3.5, 1e4]
    image.save(tmp_path / "x.exr", exposure=2.0)
    with OpenEXR.File(str(tmp_path / "x.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, image.pixels)


def test_exr_without_openexr_says_what_to_install(image, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ImportError, match=r"raystream\[exr\]"):
        image.save(tmp_path / "x.exr")
    assert not list(tmp_path.iterdir())


def test_files_are_replaced_as_a_whole(image, tmp_path, monkeypatch):
    image.save(tmp_path / "x.png")
    before = (tmp_path / "x.png").read_bytes()

    def fail(*arguments, **options):
        raise OSError("no space left")

    monkeypatch.setattr(PillowImage.Image, "save", fail)
    with pytest.raises(OSError, match="no space"):
        image.save(tmp_path / "x.png")
    assert (tmp_path / "x.png").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["x.png"]


@pytest.mark.parametrize("name", ["x.jpg", "x", "x.png.txt"])
def test_other_names_are_refused(image, tmp_path, name):
    with pytest.raises(ValueError, match=r"must end in \.png or \.exr"):
        image.save(tmp_path / name)


@pytest.mark.parametrize("exposure", [0, -1, np.nan, np.inf])
def test_exposure_is_checked(image, tmp_path, exposure):
    with pytest.raises(ValueError, match="exposure"):
        image.save(tmp_path / "x.png", exposure=exposure)


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 4), (0, 7, 3)])
def test_shapes_are_checked(shape):
    with pytest.raises(ValueError, match="pixels"):
        rs.Image(np.zeros(shape))


def test_srgb_by_its_definition():
    """IEC 61966-2-1 at its corners; encoding is the inverse of decoding."""
    assert encode_srgb(np.array([0.0, 1.0, 2.0, -1.0, np.nan, 0.5])).tolist() == [
        0,
        255,
        255,
        0,
        0,
        188,
    ]
    assert encode_srgb(np.array([0.25]), exposure=2.0) == 188
    every = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(encode_srgb(decode_srgb(every)), every)
    np.testing.assert_allclose(
        decode_srgb(every[[0, 10, 128, 255]]), [0, 0.0030353, 0.2158605, 1], atol=1e-6
    )


def test_notebooks_show_it(image):
    assert image._repr_png_().startswith(b"\x89PNG")
    assert repr(image) == "Image(7x5)"


@pytest.mark.parametrize(("width", "shown"), [(2048, (2048, 5)), (2052, (1026, 3))])
def test_notebooks_show_large_pictures_smaller(width, shown):
    """Light is averaged, and not bytes."""
    pixels = np.zeros((5, width, 3), np.float32)
    pixels[:, ::2] = 1.0
    with PillowImage.open(io.BytesIO(rs.Image(pixels)._repr_png_())) as picture:
        assert picture.size == shown
        assert set(np.asarray(picture).flat) == ({0, 255} if width == 2048 else {188})
