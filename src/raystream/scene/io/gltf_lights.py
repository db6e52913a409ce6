"""glTF lights: points, spots and directions (``KHR_lights_punctual``)."""

from __future__ import annotations

import math

import numpy as np

from raystream.scene.io.gltf_file import GltfFile
from raystream.scene.io.gltf_nodes import Matrix
from raystream.scene.lights import DirectionalLight, Light, PointLight, SpotLight


def read_light(file: GltfFile, index: int, matrix: Matrix) -> Light | None:
    """Read a light on a node with a matrix to world space; None without a direction.

    Candela, lux, and the candela per square metre of materials' emission are numbers of one system:
    each is used as it is. A light's `range` is ignored: it is a hint for programs that compute no
    light beyond it.
    """
    extension = file.extension(file.root, "KHR_lights_punctual") or {}
    lights = file.entries(extension, "lights")
    if index >= len(lights) or not isinstance(lights[index], dict):
        raise file.error(f"is damaged: light {index} does not exist")
    light = lights[index]
    color = file.numbers(light, "color", (1.0, 1.0, 1.0))
    strength = file.number(light, "intensity", 1.0)
    red, green, blue = (max(0.0, c * strength) for c in color)
    if not np.isfinite(matrix).all() or not all(map(math.isfinite, (red, green, blue))):
        raise file.error(f"is damaged: light {index} is not finite")
    x, y, z = (-matrix[:3, 2]).tolist()
    place = matrix[:3, 3].tolist()
    kind = light.get("type")
    if kind in ("directional", "spot") and not any((x, y, z)):
        return None
    if kind == "directional":
        return DirectionalLight((x, y, z), (red, green, blue))
    if kind != "spot":
        return PointLight((place[0], place[1], place[2]), (red, green, blue))
    cone = file.child(light, "spot")
    inner = math.degrees(file.number(cone, "innerConeAngle", 0.0))
    outer = math.degrees(file.number(cone, "outerConeAngle", math.pi / 4.0))
    outer = min(outer, 90.0)  # float32 writes a right angle as a little more
    if not 0.0 <= inner < outer:
        raise file.error(
            f"is damaged: the cone of light {index} is from {inner} to {outer} degrees"
        )
    return SpotLight((place[0], place[1], place[2]), (x, y, z), (red, green, blue), inner, outer)
