"""Slopes of bump maps, against heights looked up one by one."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.jit.cpu import kernel
from raystream.rendering.shading.bump_maps import bump_slopes
from raystream.rendering.shading.textures import pack_textures, texture_color
from raystream.scene.material import Material
from raystream.scene.texture import Texture


@kernel
def slopes(tables, texture, u, v):
    return bump_slopes(tables, texture, u, v)


@kernel
def grey(tables, texture, u, v):
    return texture_color(tables, texture, u, v, tables.plain)[0]


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("size", [(1, 1), (2, 1), (1, 3), (4, 5)])
def test_slopes_are_those_between_heights_two_texels_apart(size, wrap):
    height, width = size
    pixels = np.random.default_rng(3).integers(0, 256, size, np.uint8)
    texture = Texture(np.repeat(pixels[:, :, None], 3, axis=2), wrap=wrap)
    material = Material("one", textures={"diffuse": texture, "bump": texture})
    tables, _kept = pack_textures([material])
    colors, heights = np.int32(0), np.int32(1)
    for u, v in np.random.default_rng(4).uniform(-1.0, 2.0, (40, 2)):
        found = slopes(tables, heights, u, v)
        x, y = 1.0 / width, 1.0 / height
        expected = (
            grey(tables, colors, u - x, v) - grey(tables, colors, u + x, v),
            grey(tables, colors, u, v - y) - grey(tables, colors, u, v + y),
        )
        np.testing.assert_allclose(found, expected, atol=2e-5)
    assert slopes(tables, heights, np.nan, 0.5) == (0.0, 0.0)
