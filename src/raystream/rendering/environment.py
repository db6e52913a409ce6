"""Environment maps: images of environment lights, loaded once, and their orientation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.rendering.color import decode_srgb
from raystream.rendering.exr import read_exr
from raystream.rendering.rgbe import read_rgbe
from raystream.scene.lights import EnvironmentLight, Light, texel_fault
from raystream.scene.material import Color
from raystream.scene.texture import Texture

MAP_SUFFIXES = (".hdr", ".exr", ".png", ".jpg", ".jpeg")

_read: WeakKeyDictionary[EnvironmentLight, NDArray[np.float32]] = WeakKeyDictionary()


def texels_of(light: EnvironmentLight) -> NDArray[np.float32]:
    """The texels of a light with an image; files are read on the first call.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        Linear radiance, without the light's factor, top row first.

    Raises
    ------
    FileFormatError
        If the file is missing, corrupt, too large, of an unsupported kind, or has radiance that
        is negative or not finite.
    ImportError
        If it is an EXR, and OpenEXR is not installed.
    """
    assert light.image is not None
    if not isinstance(light.image, Path):
        return light.image
    texels = _read.get(light)
    if texels is None:
        texels = _read[light] = _read_map(light.image)
    return texels


def _read_map(path: Path) -> NDArray[np.float32]:
    suffix = path.suffix.lower()
    if suffix not in MAP_SUFFIXES:
        raise FileFormatError(path, f"the name must end in {' or '.join(MAP_SUFFIXES)}")
    if suffix == ".hdr":
        texels = read_rgbe(str(path))
    elif suffix == ".exr":
        texels = np.ascontiguousarray(read_exr(str(path))[0])
    else:
        pixels = Texture(path).pixels()
        gray_or_color = pixels if pixels.shape[2] == 1 else pixels[:, :, :3]
        linear = decode_srgb(gray_or_color)
        texels = np.ascontiguousarray(np.broadcast_to(linear, (*linear.shape[:2], 3)))
    fault = texel_fault(texels)
    if fault:
        raise FileFormatError(path, fault)
    return texels


def image_light(lights: Sequence[Light]) -> EnvironmentLight | None:
    """The environment light with an image, or None.

    Raises
    ------
    ValueError
        If there are several.
    """
    found = [light for light in lights if isinstance(light, EnvironmentLight)]
    found = [light for light in found if light.image is not None]
    if len(found) > 1:
        raise ValueError(f"lights: only one environment light may have an image, not {len(found)}")
    return found[0] if found else None


def axes_of(light: EnvironmentLight) -> NDArray[np.float64]:
    """The image's right, up and centre directions: rows of shape (3, 3), float64, world space."""
    up = np.array(light.up) / np.abs(light.up).max()
    up /= np.linalg.norm(up)
    # Along x up to rounding, so that tiny changes of `up` do not turn the image by 90 degrees.
    is_along_x = abs(up[0]) > 1.0 - 1e-12
    axis = np.array([0.0, 0.0, 1.0] if is_along_x else [1.0, 0.0, 0.0])
    right = axis - (axis @ up) * up
    right /= np.linalg.norm(right)
    middle = np.cross(up, right)
    angle = math.radians(math.fmod(light.rotation, 360.0))
    # Counterclockwise, the centre turns to the left.
    turned = math.cos(angle) * middle - math.sin(angle) * right
    return np.array([np.cross(turned, up), up, turned])


def row_heights(count: int) -> NDArray[np.float64]:
    """Heights of the unit sphere's slices between latitudes: the area of each row over 2 pi."""
    middles = (np.arange(count) + 0.5) * (math.pi / count)
    return 2.0 * math.sin(math.pi / 2.0 / count) * np.sin(middles)


def mean_radiance(light: EnvironmentLight) -> Color:
    """Mean radiance, over all directions, of a light with an image."""
    rows = texels_of(light).mean(axis=1, dtype=np.float64)
    red, green, blue = np.array(light.radiance) * (row_heights(len(rows)) @ rows) / 2.0
    return float(red), float(green), float(blue)
