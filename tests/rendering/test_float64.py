"""Images by rays in float64 are those by rays in float32, but for pixels at edges."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs


@pytest.mark.parametrize("mode", rs.MODES)
def test_images_are_those_of_float32(mode: str) -> None:
    scene = rs.load("cornell")
    wide, near = (
        rs.render(rs.Tracer(scene, precision=one), mode, size=(32, 32)).pixels
        for one in ("float64", "float32")
    )
    differs = np.abs(wide - near).max(axis=-1) > 1e-3 + 1e-2 * np.abs(near).max(axis=-1)
    assert np.count_nonzero(differs) <= 0.03 * differs.size
