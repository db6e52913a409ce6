"""Scenes and structures for the poster's measurements."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from raystream.core.errors import RaystreamError
from raystream.scene.lights import PointLight
from raystream.scene.material import Material
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.published import published
from raystream_lab.results import Result
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: The poster's scenes are lost with its figure. These are interiors, as usual in papers of its
#: time: offices, a church, a kitchen with details of many sizes.
SCENES = ("conference", "sibenik", "kitchen")

#: Smaller built-in substitutes for missing scenes.
STAND_INS = ("boxes", "spheres", "forest:30000")

#: The poster's structure, in our reading.
REFERENCE = "graph"

#: All except brute force; the first one is the reference.
STRUCTURES = (REFERENCE, "bvh", "kdtree", "grid")

#: Distance from the camera of a light added to unlit scenes, relative to the median distance of
#: visible surfaces; at most halfway to the first surface.
_LIGHT_SHIFT = 0.25

#: Its intensity for a distance of 1.
_BRIGHTNESS = 4.0


def device_options(runner: Runner, structure: str) -> dict[str, Any]:
    """Options of a tracer for the runner's device: a CUDA GPU builds the graph itself.

    The simulator of one does not: it runs threads one by one.
    """
    is_built_there = (
        runner.device == "cuda" and structure == REFERENCE and not runner.facts.is_software
    )
    return {"device": runner.device, **({"build": "device"} if is_built_there else {})}


def prepared(scene: Scene) -> Scene:
    """Prepare a scene for timing: opaque, and with a light.

    With transparent surfaces, a filter would be timed and not a structure. Rooms without a light
    are black, since the sky is not visible; they get one above and to the right of the camera.
    """
    is_lit = scene.lights or any(max(one.emission) > 0.0 for one in scene.materials)
    return Scene(
        scene.meshes,
        materials=[_opaque(one) for one in scene.materials],
        lights=scene.lights if is_lit else [_light(scene)],
        camera=scene.camera,
        background=scene.background,
        name=scene.name,
    )


def _opaque(material: Material) -> Material:
    textures = {role: one for role, one in material.textures.items() if role != "opacity"}
    return replace(material, opacity=1.0, alpha_cutoff=None, textures=textures)


def _light(scene: Scene) -> PointLight:
    camera = scene.camera_for(1.0)
    tracer = Tracer(scene)
    hits = tracer.first_hit(*camera.rays(32, 32))
    middle = float(np.median(hits.t[hits.is_hit])) if hits.is_hit.any() else 1.0
    right, up, _ = camera.basis()
    eye, away = np.asarray(camera.eye), (right + up) / np.sqrt(2.0)
    free = float(tracer.first_hit(eye, away).t)
    x, y, z = (eye + min(_LIGHT_SHIFT * middle, 0.5 * free) * away).tolist()
    return PointLight((x, y, z), (_BRIGHTNESS * middle**2,) * 3)


def scenes(runner: Runner, result: Result) -> Iterator[View]:
    """Yield three scenes with cameras; notes name the missing ones.

    With ``quick``, the built-in ones.
    """
    wanted: int = published("rayforce", "figure 3").values["scenes"]
    for name, other in zip(SCENES[:wanted], STAND_INS, strict=True):
        if runner.quick:
            yield runner.view(other)
            continue
        try:
            yield runner.view(name)
        except RaystreamError as error:
            result.notes.append(f"{other} replaces {name}: {error}")
            yield runner.view(other)
