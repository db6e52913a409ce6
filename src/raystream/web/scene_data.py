"""What a page needs of a scene: its surfaces and lights, and what each mode's shaders read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.graphics.rendering.modes import Mode, mode_of, unsupported
from raystream.graphics.rendering.scene_buffers import (
    light_samples,
    punctual_rows,
    surface_arrays,
)
from raystream.graphics.rendering.uniforms import BandPlace, shading_uniform
from raystream.graphics.shader_source import shader_files
from raystream.graphics.structures import shader_structure_of
from raystream.rendering.contexts import make_context
from raystream.rendering.integrator import RenderContext
from raystream.rendering.lighting import needs_light
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.view_light import lit, usual_context
from raystream.scene.camera import Camera
from raystream.tracer import Tracer
from raystream.web.geometry import structure_arrays, triangle_arrays
from raystream.web.heatmaps import COUNTS, counts_of, ramp_words
from raystream.web.pass_kernels import pass_files, pass_kernels, schedule
from raystream.web.structure_names import structure_names

#: Modes of a page, the first one first seen.
MODES = ("raycast", "shadow", "whitted", "ao", "path")

#: Samples per pixel, after which a page rests.
SAMPLES = 256

#: Arrays of `surface_arrays` that the page makes of the vertices.
_CORNERS = "the corners of triangles"


class PageScene(NamedTuple):
    """A scene as a page has it.

    Attributes
    ----------
    manifest : dict
        For JSON, with the shader files of its modes and structures.
    arrays : dict of str to ndarray
        Of four-byte numbers.
    """

    manifest: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def unsupported_by_pages(context: RenderContext) -> str | None:
    """Say what the shaders of pages do not support of a scene and its view; None if all."""
    reason = unsupported(context)
    return None if reason is None else f"the shaders of pages do not support {reason}"


def check_supported(tracer: Tracer, camera: Camera) -> None:
    """Raise RaystreamError, which says what, for a scene or view that shaders do not support.

    Parameters
    ----------
    tracer : Tracer
        Of the scene, with any structure.
    camera : Camera
    """
    reason = unsupported_by_pages(_context(tracer, camera, MODES[0]))
    if reason is not None:
        raise RaystreamError(f"export: {reason}")


def page_scene(
    tracers: Sequence[Tracer],
    camera: Camera,
    *,
    contexts: Mapping[str, RenderContext] | None = None,
) -> PageScene:
    """Collect what a page needs of a supported scene; see `check_supported`.

    Parameters
    ----------
    tracers : sequence of Tracer
        Of one scene, one for each structure; the first one is first seen.
    camera : Camera
    contexts : mapping of str to RenderContext, optional
        Of each mode, with its options and lights [default: those that `render` has and
        decides by its defaults].
    """
    scene = tracers[0].scene
    arrays: dict[str, NDArray[Any]] = dict(triangle_arrays(scene.triangles, scene.attributes.faces))
    files = {"compute.wgsl", "rendering/compute.wgsl", *_SHARED}
    modes_made: dict[str, Any] = {}
    for name in MODES:
        if contexts is None:
            context = _context(tracers[0], camera, name)
            context = lit(RENDERERS[name], usual_context(RENDERERS[name], context, camera))
        else:
            context = contexts[name]
        mode = mode_of(RENDERERS[name].stages)
        assert mode is not None
        if not modes_made:
            arrays.update(_surfaces(context))
        modes_made[name] = _add_mode(arrays, name, context, mode)
        files.add(mode.shader)
    context = _context(tracers[0], camera, MODES[0])
    modes_made["heatmap"] = _add_mode(arrays, "heatmap", context, COUNTS)
    arrays["ramp"] = ramp_words()
    structures = {}
    names = structure_names([one.structure.options for one in tracers])
    for name, tracer in zip(names, tracers, strict=True):
        shaders = shader_structure_of(tracer.structure)
        how, own = structure_arrays(tracer.structure, shaders)
        structures[name] = {
            "how": how,
            "counts": counts_of(tracer.structure.name),
            "arrays": [_add_array(arrays, f"{name} {key}", one) for key, one in own.items()],
            "shader": shaders.shader,
            "tree": np.frombuffer(shaders.tree, np.uint32).tolist(),
            "budget": shaders.budget,
            "constants": shaders.constants,
            "sizes": shaders.sizes,
            "instead": shaders.instead,
            "passes": pass_kernels(tracer.structure),
        }
        files |= {shaders.shader, *shaders.instead.values()}
        files |= pass_files(structures[name]["passes"]) if structures[name]["passes"] else set()
    frame = scene.triangles
    manifest = {
        "camera": {
            "eye": list(camera.eye),
            "look_at": list(camera.look_at),
            "up": list(camera.up),
            "fov": camera.fov,
        },
        "bounds": scene.bounds.tolist(),
        "frame": {
            "center": frame.center.tolist(),
            "scale": float(frame.scale),
            "max_coordinate": float(frame.max_coordinate),
        },
        "modes": modes_made,
        "structures": structures,
        "schedule": schedule(),
        "samples": SAMPLES,
        "shaders": shader_files(files),
    }
    return PageScene(manifest, arrays)


#: Files that replace others, which no file includes.
_SHARED = (
    COUNTS.shader,
    "page/accumulate.wgsl",
    "page/show.wgsl",
    "page/show_counts.wgsl",
    "page/walk.wgsl",
    "no_hit_rows.wgsl",
    "rendering/no_corners.wgsl",
    "rendering/path_rows.wgsl",
)


def _context(tracer: Tracer, camera: Camera, name: str) -> RenderContext:
    renderer = RENDERERS[name]
    sampler = Sampler.of("sobol", 0, SAMPLES)
    chosen = renderer.check(renderer.complete({}))
    return make_context(tracer, camera, (1, 1), sampler, chosen)


def _surfaces(context: RenderContext) -> Mapping[str, NDArray[Any]]:
    return {
        f"surface {k}": array.reshape(-1)
        for k, (name, array) in enumerate(surface_arrays(context))
        if name != _CORNERS
    }


def _lights(context: RenderContext, mode: Mode) -> NDArray[np.float32]:
    return light_samples(context) if mode.samples_lights else punctual_rows(context).reshape(-1)


def _add_mode(
    arrays: dict[str, NDArray[Any]], name: str, context: RenderContext, mode: Mode
) -> dict[str, Any]:
    """Add what a mode's shaders read; returns what describes it."""
    lights = _add_array(arrays, f"lights {name}", _lights(context, mode), among="lights ")
    uniform = shading_uniform(context, mode, BandPlace(0, 0, 0, 1))
    arrays[f"shading {name}"] = np.frombuffer(uniform, np.uint32)
    return _mode(context, mode, lights)


def _add_array(
    arrays: dict[str, NDArray[Any]], name: str, array: NDArray[Any], among: str = ""
) -> str:
    """Add an array, unless one whose name begins with `among` has its bits; returns the name."""
    bits = _bits(array)
    for known, other in arrays.items():
        is_like = other.dtype == array.dtype and other.size == array.size
        if is_like and known.startswith(among) and np.array_equal(_bits(other), bits):
            return known
    arrays[name] = array
    return name


def _bits(array: NDArray[Any]) -> NDArray[np.uint32]:
    return np.ravel(array).view(np.uint32)


def _mode(context: RenderContext, mode: Mode, lights: str) -> dict[str, Any]:
    headlight = -1
    scene = context.tracer.scene
    if not mode.samples_lights and needs_light(scene, context.chosen_lights):
        # The last of the listed lights; patches of area lights come after it.
        rows = punctual_rows(context)[:, :3]
        eye = (np.array(context.camera.eye) - scene.triangles.center) * scene.triangles.scale
        at_eye = np.flatnonzero((rows == eye.astype(np.float32)).all(axis=1))
        headlight = int(at_eye[-1]) if len(at_eye) else -1
    return {
        "shader": mode.shader,
        "lights": lights,
        "headlight": headlight,
        "branches": mode.branches(context),
        "spawns": mode.spawns(context),
        "constants": {
            "LAST_BOUNCE": mode.last_bounce(context),
            "SAMPLER": context.sampler.kind,
            "SPREADS": 1,
            **mode.constants(context),
        },
    }
