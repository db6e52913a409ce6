"""Rays as textures, and the other resources of fragment programs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, uniform, whole
from raystream.graphics.gather_arrays import BUFFERS, TEXTURES, in_textures, upload_gathers
from raystream.graphics.packing import ROW, packed_rays
from raystream.graphics.pipelines import Layout, bind
from raystream.graphics.streams.textures import StreamShape, StreamTexture
from raystream.graphics.structures import ShaderStructure
from raystream.graphics.structures.base import TREE_AT
from raystream.kernels.local_frame import LocalRays

#: Group 0 of a fragment program: see fragment/frame.wgsl.
FRAME = ("uniform", "float", "float", "uint")

#: Group 2, of programs that write buffers: rows, tallies and runs.
_BUFFERS = ("scatter", "scatter", "scatter")


class RayTextures:
    """Rays, the hits wanted of them and their results, as streams of one shape.

    Parameters
    ----------
    opened : OpenDevice
    shaders : ShaderStructure
    memory : {"buffers", "textures"}
        Where the structure's arrays are, see `gather_arrays`.

    Attributes
    ----------
    opened : OpenDevice
    memory : str
    shape : StreamShape
    count : int
        Number of rays.
    state, found : StreamTexture
        Render targets of programs: see fragment/targets.wgsl.
    inputs : list of StreamTexture
        Origins, directions, and hits wanted.
    params : dict
        The uniform buffer, as a resource.
    """

    def __init__(self, opened: OpenDevice, shaders: ShaderStructure, memory: str = BUFFERS) -> None:
        self.opened = opened
        self.memory = memory
        self._shaders = shaders
        names = (f"{shaders.name}, array {k}" for k in range(len(shaders.arrays)))
        arrays = zip(names, shaders.arrays, strict=True)
        self._arrays = upload_gathers(opened, arrays, memory, shaders.source())
        self._buffers = {name: Buffer(opened, name) for name in ("rows", "tallies", "runs")}
        self._uniform = uniform(opened, shaders.params(np.float32(0.0)))
        self.params = whole(self._uniform)
        self.count = 0
        self._resize(StreamShape.for_count(1, opened))

    def _resize(self, shape: StreamShape) -> None:
        self.shape = shape
        self.inputs = [
            StreamTexture(self.opened, "origins", shape, np.float32),
            StreamTexture(self.opened, "directions", shape, np.float32),
            StreamTexture(self.opened, "wanted", shape, np.uint32),
        ]
        self.state = StreamTexture(self.opened, "states", shape, np.uint32)
        self.found = StreamTexture(self.opened, "found", shape, np.float32)

    def load(
        self,
        rays: LocalRays,
        chunk: slice,
        wanted: NDArray[np.uint32],
        row_count: int,
        counts: bool,
    ) -> bool:
        """Copy rays to the device; returns whether the textures are new ones."""
        self.count = len(wanted)
        shape = StreamShape.for_count(self.count, self.opened)
        is_new = shape != self.shape
        if is_new:
            self._resize(shape)
        packed = packed_rays(rays, chunk)
        for stream, records in zip(self.inputs, (packed[:, 0], packed[:, 1], wanted), strict=True):
            stream.write_records(records)
        self._buffers["rows"].reserve(ROW.itemsize * row_count)
        for name in ("tallies", "runs"):
            self._buffers[name].reserve(32 * self.count if counts else 0)
            if counts:
                self._buffers[name].write(np.zeros((self.count, 8), np.uint32))
        return is_new

    def rewrite(self, source: str) -> str:
        """A shader that reads gather arrays where they are."""
        return in_textures(source) if self.memory == TEXTURES else source

    def write_params(self, max_coordinate: np.float32) -> None:
        """Write the uniforms that all rays share."""
        self.write_shared_params(max_coordinate, self.count, self.shape.width)

    def write_shared_params(self, max_coordinate: np.float32, count: int, width: int) -> None:
        """Write the uniforms of `count` rays in other textures, `width` in a row."""
        params = self._shaders.params(max_coordinate, ray_count=count, row_size=width)
        self.opened.device.queue.write_buffer(self._uniform, 0, params)

    def write_tree(self, tree: bytes) -> None:
        """Replace the constants of the structure."""
        self.opened.device.queue.write_buffer(self._uniform, TREE_AT, tree)

    @staticmethod
    def instead(kind: Kind, counts: bool) -> dict[str, str]:
        """Shader files to replace: programs write no buffers that a query does not need."""
        files = {}
        if kind != Kind.MULTI_HIT:
            files["fragment/hit_rows.wgsl"] = "no_hit_rows.wgsl"
        if not counts:
            files["fragment/counters.wgsl"] = "fragment/no_counters.wgsl"
        return files

    def layouts(self, kind: Kind, counts: bool) -> list[Layout]:
        """Layouts of the bind groups after the first one."""
        gathers = tuple(one.kind for one in self._arrays)
        return [gathers, _BUFFERS] if kind == Kind.MULTI_HIT or counts else [gathers]

    def resources(self, kind: Kind, counts: bool) -> list[list[Any]]:
        """Resources of these groups."""
        own = [one.resource for one in self._arrays]
        written = [buffer.binding for buffer in self._buffers.values()]
        return [own, written][: len(self.layouts(kind, counts))]

    def groups(self, kind: Kind, counts: bool) -> list[Any]:
        """These groups, bound."""
        return [
            bind(self.opened, layout, resources)
            for layout, resources in zip(
                self.layouts(kind, counts), self.resources(kind, counts), strict=True
            )
        ]

    def read_rows(self, kind: Kind, count: int) -> NDArray[Any]:
        """Hits as `packing.ROW`: one for each ray, or all that were kept."""
        if kind == Kind.MULTI_HIT:
            return self._buffers["rows"].read(ROW, (count,))
        rows = np.empty(count, ROW)
        hits = self.found.read_records(count)
        rows["t"], rows["u"], rows["v"] = hits[:, 0], hits[:, 1], hits[:, 2]
        rows["prim_id"] = self.state.read_records(count)[:, 2].view(np.int32)
        return rows

    def read_tallies(self) -> NDArray[np.uint32]:
        """Counters of each ray."""
        return self._buffers["tallies"].read(np.uint32, (self.count, 8))

    def read_runs(self) -> NDArray[np.uint32]:
        """Runs of each kernel on each ray."""
        return self._buffers["runs"].read(np.uint32, (self.count, 8))
