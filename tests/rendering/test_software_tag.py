"""The software tag of images and videos."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image as Picture

import raystream as rs
from extras import need
from raystream.rendering.software_tag import SOFTWARE, is_tagged


@pytest.fixture
def image() -> rs.Image:
    rng = np.random.default_rng(4)
    return rs.Image(rng.random((48, 64, 3), np.float32), {"depth": np.ones((48, 64))})


@pytest.mark.parametrize("suffix", ["png", "exr", "hdr"])
def test_saved_images_are_tagged(tmp_path, image, suffix):
    if suffix == "exr":
        need("OpenEXR")
    path = tmp_path / f"a.{suffix}"
    image.save(path)
    assert is_tagged(path)
    assert rs.Image.load(path).size == image.size
    path.write_bytes(path.read_bytes().replace(SOFTWARE.encode(), b"something"))
    assert not is_tagged(path)


def test_a_png_says_it_as_text(tmp_path, image):
    image.save(tmp_path / "a.png")
    with Picture.open(tmp_path / "a.png") as picture:
        assert picture.info == {"Software": "raystream"}
        np.testing.assert_array_equal(np.asarray(picture), image.to_bytes())


@pytest.mark.parametrize("suffix", ["gif", "webp", "apng", "mp4", "webm", "mkv", "mov"])
def test_videos_are_tagged(tmp_path, image, suffix):
    if suffix in ("mp4", "webm", "mkv", "mov"):
        need("imageio_ffmpeg")
    path = tmp_path / f"a.{suffix}"
    frames = [np.roll(image.to_bytes(), k, axis=0) for k in range(3)]
    rs.write_video(path, frames)
    assert is_tagged(path)


@pytest.mark.parametrize("name", ["a.png", "a.gif", "a.webp"])
def test_files_of_other_programs_are_not(tmp_path, name):
    path = tmp_path / name
    Picture.new("RGB", (4, 3)).save(path)
    assert not is_tagged(path)
    path.write_bytes(b"")
    assert not is_tagged(path)


def test_text_elsewhere_in_a_png_is_no_tag(tmp_path):
    from PIL.PngImagePlugin import PngInfo

    about = PngInfo()
    about.add_text("Comment", "converted from an image of raystream")
    Picture.new("RGB", (4, 3)).save(tmp_path / "a.png", pnginfo=about)
    assert not is_tagged(tmp_path / "a.png")


def test_missing_files_raise(tmp_path):
    with pytest.raises(FileNotFoundError):
        is_tagged(tmp_path / "a.png")
