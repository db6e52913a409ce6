"""ComputeBands: samples of rows of an image, rendered by compute shaders, ray after ray."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, ReadBack, uniform, whole
from raystream.graphics.dispatch_size import DispatchSize
from raystream.graphics.errors import GraphicsError
from raystream.graphics.gather_arrays import BUFFERS, TEXTURES, in_textures
from raystream.graphics.pipelines import Program, bind, compute_pipeline
from raystream.graphics.rendering.bands import ShaderBands
from raystream.graphics.rendering.mode_on_device import ModeOnDevice
from raystream.graphics.structures import ShaderStructure
from raystream.graphics.termination import check_endings
from raystream.jit.threads import Progress
from raystream.rendering.integrator import RenderContext

#: Invocations of a workgroup, bytes of a pixel in ``records``, and of those before its light; see
#: rendering/compute.wgsl.
_GROUP_SIZE, _PIXEL_BYTES, _LIGHT_OFFSET = 64, 96, 80

#: Group 0, and the group of the structure's arrays.
_LAYOUT, _TREE_GROUP = ("uniform", "scatter", "scatter"), 2

#: Most rays of each pixel before the host reads the counts.
_MOST_DISPATCHES = 8


class ComputeBands(ShaderBands):
    """One dispatch traces and shades one ray of each pixel.

    Parameters
    ----------
    context : RenderContext
    opened : OpenDevice
    shaders : ShaderStructure
    arrays : sequence of Buffer
        The structure's, on the device.
    max_pixels : int
        Most pixels of a dispatch.
    """

    def __init__(
        self,
        context: RenderContext,
        opened: OpenDevice,
        shaders: ShaderStructure,
        arrays: list[Buffer],
        max_pixels: int,
    ) -> None:
        super().__init__(context, opened, max_pixels)
        self._shaders, self._arrays = shaders, arrays
        self._records = Buffer(opened, "pixels and their rays")
        self._counts = Buffer(opened, "numbers of pixels")
        self._counts.reserve(16)
        self._size = DispatchSize(max_pixels)
        self._read_back = ReadBack(opened)

    def _prepare(self, mode: ModeOnDevice) -> None:
        instead = dict(mode.instead)
        if "corners" in self._shaders.source():
            instead["rendering/corners.wgsl"] = "rendering/no_corners.wgsl"
        names = "rendering/compute.wgsl", mode.mode.shader
        source = self._shaders.source(*names, instead=instead, tree_group=_TREE_GROUP)
        memory = self._memory(mode)
        mode.upload(memory, source)
        if memory == TEXTURES:
            source = in_textures(source, group=1)
        constants = {**mode.constants, **self._shaders.constants}
        self._layouts = _LAYOUT, mode.layout, ("gather",) * len(self._arrays)
        name = f"{mode.mode.shader}, {self._shaders.name}"
        self._begin, self._advance = (
            compute_pipeline(self._opened, name, Program(source, entry, self._layouts, constants))
            for entry in ("begin", "trace_and_shade")
        )
        self._params = uniform(self._opened, self._shaders.params(self._max_coordinate))
        self._mode = mode

    @property
    def _max_coordinate(self) -> np.float32:
        return self._context.tracer.scene.triangles.max_coordinate

    def _memory(self, mode: ModeOnDevice) -> str:
        """Where the scene's arrays are: shaders may have few buffers, beside as many textures."""
        most = self._opened.limits["max-storage-buffers-per-shader-stage"]
        own = _LAYOUT.count("scatter") + len(self._arrays) + (mode.rows is not None)
        return BUFFERS if own + mode.array_count <= most else TEXTURES

    def _render(self, pixels: range, sample: int, progress: Progress | None) -> NDArray[np.float32]:
        light, done = np.empty((len(pixels), 3), np.float32), 0
        while done < len(pixels):
            some = pixels[done : done + self._size.size]
            light[done : done + len(some)] = self._render_some(some, sample)
            done += len(some)
            if progress:
                progress(done, len(pixels))
        return light

    def _render_some(self, pixels: range, sample: int) -> NDArray[np.float32]:
        """Render pixels by dispatches of their own."""
        count = len(pixels)
        self._records.reserve(_PIXEL_BYTES * count)
        groups = -(-count // _GROUP_SIZE)
        columns = min(groups, self._opened.limits["max-compute-workgroups-per-dimension"])
        row_size = columns * _GROUP_SIZE
        params = self._shaders.params(self._max_coordinate, ray_count=count, row_size=row_size)
        self._opened.device.queue.write_buffer(self._params, 0, params)
        self._mode.begin(pixels, sample)
        size = columns, -(-groups // columns)
        self._submit([self._begin], size)
        dispatch_count = 1
        while True:
            began = time.perf_counter()
            active, stuck, *failed = self._submit([self._advance] * dispatch_count, size)
            self._size.took(count, (time.perf_counter() - began) / dispatch_count)
            check_endings([0, *failed], count, self._shaders, self._opened)
            if stuck:
                self._grow()
            elif not active:
                break
            dispatch_count = min(2 * dispatch_count, _MOST_DISPATCHES)
        light = self._records.read(np.float32, (count, 4), _LIGHT_OFFSET * count)
        return np.ascontiguousarray(light[:, :3])

    def _submit(self, pipelines: list[Any], size: tuple[int, int]) -> list[int]:
        """Dispatch pipelines; returns the last one's counts, and all failures."""
        groups = self._bound()
        encoder = self._opened.device.create_command_encoder()
        encoder.clear_buffer(self._counts.handle, 0, 16)
        for pipeline in pipelines:
            encoder.clear_buffer(self._counts.handle, 0, 8)
            run = encoder.begin_compute_pass()
            run.set_pipeline(pipeline)
            for number, group in enumerate(groups):
                run.set_bind_group(number, group)
            run.dispatch_workgroups(*size)
            run.end()
        try:
            (counts,) = self._read_back.read(encoder, [(self._counts, 16)])
        except Exception as error:  # wgpu wraps whatever a driver says
            raise GraphicsError(
                f"device 'graphics': {self._opened.adapter} failed to render: {error}"
            ) from error
        return [int(one) for one in counts.view(np.uint32)]

    def _grow(self) -> None:
        encoder = self._opened.device.create_command_encoder()
        self._mode.grow(encoder)
        self._opened.device.queue.submit([encoder.finish()])

    def _bound(self) -> list[Any]:
        own = [whole(self._params), self._records.binding, self._counts.binding]
        tree = [buffer.binding for buffer in self._arrays]
        return [
            bind(self._opened, layout, resources, is_compute=True)
            for layout, resources in zip(
                self._layouts, (own, self._mode.resources(), tree), strict=True
            )
        ]
