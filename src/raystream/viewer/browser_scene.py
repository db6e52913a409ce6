"""Scenes for the device "this browser": the page traces what is sent here, on its own GPU."""

from __future__ import annotations

from dataclasses import replace

from raystream.core.errors import RaystreamError
from raystream.rendering.contexts import seen_by
from raystream.rendering.integrator import RenderContext
from raystream.scene.camera import Camera
from raystream.viewer.messages import Message
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import PreparedTracer, device_lock
from raystream.viewer.view_lights import ViewLights

#: Maximum bytes of a scene's arrays and its structure's, before compression.
MAX_BYTES = 256 << 20

#: Bytes of a triangle, at least: its vertices, twice, and its material.
_LEAST_BYTES = 28

#: Compression: a page is usually near, and waits.
_LEVEL = 1

#: A size for contexts: the page has its own.
_SIZE = 64, 64


def browser_support(prepared: PreparedTracer) -> Message:
    """Say in which modes a page can trace a scene, or why it cannot.

    Returns
    -------
    dict
        ``"modes"``, none if the scene is not supported, and then ``"reason"``.
    """
    from raystream.web.scene_data import MODES

    reason = _unsupported(prepared)
    return {"modes": [] if reason else list(MODES), "reason": reason}


def packed_scene(
    prepared: PreparedTracer, settings: Settings, camera: Camera, lights: ViewLights
) -> bytes:
    """Pack a scene and its structure for the page, with all modes of pages.

    Parameters
    ----------
    prepared : PreparedTracer
    settings : Settings
        Bounces are those of all modes.
    camera : Camera
        The view, for which lights are chosen in modes that have not been shown yet.
    lights : ViewLights

    Returns
    -------
    bytes
        For ``unpack`` of ``web/page/pack.js``.

    Raises
    ------
    RaystreamError
        If it is not supported, or too large.
    """
    from raystream.web.pack import packed_bytes
    from raystream.web.scene_data import MODES, page_scene

    reason = _unsupported(prepared)
    if reason is not None:
        raise RaystreamError(reason)
    camera = _plain(camera)
    with device_lock(prepared.key.device):
        contexts = {
            mode: _context(prepared, replace(settings, mode=mode), camera, lights) for mode in MODES
        }
        made = page_scene([prepared.tracer], camera, contexts=contexts)
    size = sum(array.nbytes for array in made.arrays.values())
    if size > MAX_BYTES:
        raise RaystreamError(
            f"The scene takes {size:,} bytes, but at most {MAX_BYTES:,} are sent to a browser."
        )
    modes = {
        mode: {**about, "max_bounces": replace(settings, mode=mode).message()["max_bounces"]}
        for mode, about in made.manifest["modes"].items()
        if mode in MODES
    }
    key = prepared.key
    manifest = {
        **made.manifest,
        "modes": modes,
        "traversals": {key.structure: key.traversal},
    }
    return packed_bytes(manifest, made.arrays, level=_LEVEL)


def _context(
    prepared: PreparedTracer, settings: Settings, camera: Camera, lights: ViewLights
) -> RenderContext:
    context = replace(prepared.context, options=settings.mode_options)
    return seen_by(lights.lit(prepared, settings.mode, context, camera), camera, _SIZE)


def _plain(camera: Camera) -> Camera:
    """A camera as the page moves it; it does without others' projections by itself."""
    return replace(camera, projection="perspective", aperture=0.0)


def _unsupported(prepared: PreparedTracer) -> str | None:
    """What shaders of pages do not support of a scene, as a sentence."""
    from raystream.web.scene_data import unsupported_by_pages

    count = prepared.tracer.scene.triangle_count
    if _LEAST_BYTES * count > MAX_BYTES:
        return f"The scene has {count:,} triangles, more than are sent to a browser."
    context = prepared.context
    reason = unsupported_by_pages(replace(context, camera=_plain(context.camera)))
    return None if reason is None else f"{reason[0].upper()}{reason[1:]}."
