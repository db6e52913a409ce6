"""Lights of glTF."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from raystream.core.errors import FileFormatError
from raystream.scene.lights import Light, SpotLight
from scene.io import tiny
from scene.io.test_gltf import read


def lights_of(tmp_path: Path, light: dict[str, Any], **node: Any) -> tuple[Light, ...]:
    document = tiny.gltf_document()
    document["nodes"].append({"extensions": {"KHR_lights_punctual": {"light": 0}}, **node})
    document["scenes"][0]["nodes"].append(2)
    document["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    return tuple(read(tmp_path, document).lights)


def test_spots(tmp_path: Path) -> None:
    half = 0.5**0.5
    node = {"translation": [1, 2, 3], "rotation": [-half, 0, 0, half], "scale": [7, 7, 7]}
    cone = {"innerConeAngle": math.pi / 6, "outerConeAngle": 1.5707963705062866}  # float32
    light = {"type": "spot", "intensity": 4, "color": [1, 0.5, 0], "spot": cone, "range": 0.1}
    (spot,) = lights_of(tmp_path, light, **node)
    assert isinstance(spot, SpotLight)
    assert (spot.position, spot.intensity) == ((1, 2, 3), (4, 2, 0))
    assert spot.direction == pytest.approx((0, -7, 0), abs=1e-6)
    assert (spot.inner_angle, spot.outer_angle) == (pytest.approx(30), 90)


def test_the_default_cone(tmp_path: Path) -> None:
    (spot,) = lights_of(tmp_path, {"type": "spot"})
    assert isinstance(spot, SpotLight)
    assert (spot.inner_angle, spot.outer_angle) == (0, 45)
    assert spot.direction == (0, 0, -1)


def test_a_light_without_a_direction(tmp_path: Path) -> None:
    for kind in ("spot", "directional"):
        assert lights_of(tmp_path, {"type": kind}, scale=[1, 1, 0]) == ()


@pytest.mark.parametrize(
    ("light", "reason"),
    [
        ({"spot": {"innerConeAngle": 1, "outerConeAngle": 0.5}}, "cone"),
        ({"spot": {"innerConeAngle": -1}}, "cone"),
        ({"spot": {"outerConeAngle": "wide"}}, "not a number"),
        ({"spot": 3}, "not an object"),
        ({"intensity": 1e308, "color": [1e308, 1, 1]}, "not finite"),
    ],
)
def test_damaged_lights(tmp_path: Path, light: dict[str, Any], reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        lights_of(tmp_path, {"type": "spot", **light})
