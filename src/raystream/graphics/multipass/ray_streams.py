"""The rays of a query on the graphics pipeline: their streams, and the bindings of kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.multipass.kernels import STREAMS
from raystream.graphics.multipass.plan import LAYOUT, STREAM_TYPES
from raystream.graphics.pipelines import bind
from raystream.graphics.ray_textures import RayTextures
from raystream.graphics.streams.passes import Bindings, StreamPasses
from raystream.graphics.streams.textures import StreamTexture
from raystream.graphics.structures import ShaderStructure
from raystream.kernels.local_frame import LocalRays


class RayStreams:
    """Textures of rays and of their traversal state.

    Parameters
    ----------
    opened : OpenDevice
    shaders : ShaderStructure
    memory : str
        See `RayTextures`.

    Attributes
    ----------
    rays : RayTextures
    passes : StreamPasses
    """

    def __init__(self, opened: OpenDevice, shaders: ShaderStructure, memory: str) -> None:
        self._opened = opened
        self.rays = RayTextures(opened, shaders, memory)
        self._resize()

    def _resize(self) -> None:
        rays, shape = self.rays, self.rays.shape
        streams = {"state": rays.state, "found": rays.found}
        for name in STREAMS:
            if name not in streams:
                dtype = np.dtype(STREAM_TYPES[name])
                streams[name] = StreamTexture(self._opened, name, shape, dtype)
        types = {name: np.dtype(STREAM_TYPES[name]) for name in STREAMS}
        self.passes = StreamPasses(self._opened, shape, streams, types)

    def load(
        self,
        rays: LocalRays,
        chunk: slice,
        wanted: NDArray[np.uint32],
        row_count: int,
        counts: bool,
    ) -> None:
        """Copy rays to the device."""
        if self.rays.load(rays, chunk, wanted, row_count, counts):
            self._resize()

    def bindings(self, kind: Kind, counts: bool) -> Bindings:
        """A function that binds the streams, or their scratch textures, and other resources."""
        shared = [self.rays.params, *(one.view for one in self.rays.inputs)]
        rest = self.rays.groups(kind, counts)
        first = [
            bind(self._opened, LAYOUT, [*shared, *(textures[name].view for name in STREAMS)])
            for textures in (self.passes.streams, self.passes.scratch)
        ]

        def bind_all(run: Any, is_commit: bool, _: int) -> None:
            for number, group in enumerate((first[is_commit], *rest)):
                run.set_bind_group(number, group)

        return bind_all
