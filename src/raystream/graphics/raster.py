"""Visibility by rasterisation: the nearest triangle of each pixel, from the depth buffer.

Purcell 2002 (introduction, and the shadow caster of section 3.2): a rendering pass with a depth
buffer finds the visible surfaces, and rays are traced from there: see `shadow_caster`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.graphics.adapters import OpenDevice, open_device
from raystream.graphics.buffers import Buffer, uniform, upload, whole
from raystream.graphics.camera import check_pinhole, packed_view
from raystream.graphics.error_scope import guarded
from raystream.graphics.fragment_program import FragmentProgram
from raystream.graphics.pipelines import Program, bind, fragment_pipeline
from raystream.graphics.shader_source import shader_source
from raystream.graphics.structures.base import numbers
from raystream.graphics.textures import IDS, WORDS, Texture, new_texture, sampled
from raystream.rendering.arguments import check_camera, check_size
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene

_DEPTH = "depth32float"

#: Bindings of both programs: prim_ids and vertices of the triangles, and an image.
_PROJECTED = [("uniform",), ("gather", "gather")]
_RESOLVED = [("uniform", sampled(IDS)), ("gather",)]

#: Triangles of a draw: vertex indices have 32 bits, and drivers take long draws for hung.
_TRIANGLES_AT_ONCE = 1 << 20


class Visibility(NamedTuple):
    """The surface seen at each pixel's centre, by (row, column).

    Attributes
    ----------
    prim_id : ndarray of shape (H, W), int32
        Triangle, counted over the whole scene; -1 for the background.
    t : ndarray of shape (H, W), float32
        Distance from the eye, scene units; inf for the background.
    u, v : ndarray of shape (H, W), float32
        Weights of vertices 1 and 2; 0 for the background.
    """

    prim_id: NDArray[np.int32]
    t: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]


def visibility(
    scene: Scene,
    size: tuple[int, int] = (1024, 768),
    *,
    camera: Camera | None = None,
    adapter: str | None = None,
) -> Visibility:
    """Rasterise a scene.

    Parameters
    ----------
    scene : Scene
    size : (int, int)
        Width and height in pixels.
    camera : Camera, optional
        Perspective; a lens is taken as a pinhole [default: the scene's].
    adapter : str, optional
        See `adapters.open_device`.

    Returns
    -------
    Visibility

    Raises
    ------
    ValueError
        If the size is out of range, or the camera is not a perspective one.
    GraphicsError
        If there is no adapter, or the scene or the image is too large for it.

    Notes
    -----
    Equal to the first hits of `camera.rays`, except where a pixel's centre is on an edge or closer
    to one than the rasteriser resolves: it snaps vertices to a lattice, usually of 1/256 pixel.
    Distance and weights are those of the pixel's ray and the triangle, or of the triangle's
    nearest point where the ray just misses it. The near plane is at 2**-24 of the scene's size.
    """
    check_camera(camera)
    size = check_size(size)
    view = camera or scene.camera_for(size[0] / size[1])
    check_pinhole(view)
    opened = open_device(adapter)
    with guarded(opened):
        words = _Raster(scene.triangles, opened).draw(view, size)
    prim_id = words[..., 3].view(np.int32)
    t, u, v = (words[..., k].view(np.float32) for k in range(3))
    return Visibility(
        prim_id.copy(), np.where(prim_id < 0, np.float32(np.inf), t), u.copy(), v.copy()
    )


class _Raster:
    """The two passes: the triangle of each pixel, and the hit on it."""

    def __init__(self, triangles: Triangles, opened: OpenDevice) -> None:
        self._triangles, self._opened = triangles, opened
        arrays = [
            ("the prim_ids of triangles", triangles.prim_ids.astype(np.uint32)),
            ("the vertices of triangles", triangles.corners),
        ]
        self._buffers: list[Buffer] = upload(opened, arrays)
        resolve = Program(
            shader_source("fullscreen.wgsl", "raster/resolve.wgsl"), "resolve", _RESOLVED
        )
        self._resolve = FragmentProgram(opened, "resolve", resolve, [WORDS])
        project = Program(shader_source("raster/raster.wgsl"), "note", _PROJECTED, vertex="project")
        self._pipeline = fragment_pipeline(opened, "raster", project, [(IDS, True)], _Nearest())

    def draw(self, view: Camera, size: tuple[int, int]) -> NDArray[np.uint32]:
        """Rasterise; shape (H, W, 4): the bits of t, u and v, and prim_id."""
        opened = self._opened
        packed = packed_view(view, size, self._triangles)
        seen = Texture(opened, "prim_ids of pixels", size, IDS)
        found = Texture(opened, "hits", size, WORDS)
        encoder = opened.device.create_command_encoder()
        params = uniform(opened, numbers(self._triangles.max_coordinate, 0, 0, 0) + packed)
        self._rasterise(encoder, params, seen)
        groups = [[whole(params), seen.view], [self._buffers[1].binding]]
        self._resolve.draw(encoder, groups, [found])
        opened.device.queue.submit([encoder.finish()])
        return found.read()

    def _rasterise(self, encoder: Any, params: Any, seen: Texture) -> None:
        import wgpu

        opened = self._opened
        usage = wgpu.TextureUsage.RENDER_ATTACHMENT
        depth = new_texture(opened, "depth", seen.size, _DEPTH, usage)
        colors = {"view": seen.view, "clear_value": (-1, 0, 0, 0)}
        drawn = encoder.begin_render_pass(
            color_attachments=[colors | {"load_op": "clear", "store_op": "store"}],
            depth_stencil_attachment={
                "view": depth.create_view(),
                "depth_clear_value": 0.0,
                "depth_load_op": "clear",
                "depth_store_op": "discard",
            },
        )
        drawn.set_pipeline(self._pipeline)
        groups = [whole(params)], [one.binding for one in self._buffers]
        for number, (layout, own) in enumerate(zip(_PROJECTED, groups, strict=True)):
            drawn.set_bind_group(number, bind(opened, layout, own))
        count = len(self._triangles.prim_ids)
        for first in range(0, count, _TRIANGLES_AT_ONCE):
            drawn.draw(3 * min(_TRIANGLES_AT_ONCE, count - first), 1, 3 * first)
        drawn.end()


@dataclass(frozen=True)
class _Nearest:
    """The depth test, on reversed depth: the nearest fragment has the largest."""

    def description(self) -> dict[str, Any]:
        """As wgpu takes it."""
        return {"format": _DEPTH, "depth_write_enabled": True, "depth_compare": "greater"}
