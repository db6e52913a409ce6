"""The branching machine: one fragment program traces each ray from start to end.

The branching architecture of Purcell 2002, section 3.2: like the compute machine, but rays are
read from textures, and hits are written to render targets.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.backend import RAYS_AT_ONCE, Chunk, GraphicsBackend
from raystream.graphics.fragment_program import FragmentProgram
from raystream.graphics.pipelines import Program
from raystream.graphics.ray_textures import FRAME, RayTextures
from raystream.graphics.termination import hit_counts
from raystream.structures import Structure


class BranchingBackend(GraphicsBackend):
    """Traces rays by one fragment program.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; its arrays are copied to the device.
    opened : OpenDevice
    rays_at_once : int
        Most rays of a draw.

    Raises
    ------
    GraphicsError
        If there are no shaders for the structure, they do not compile, or it is too large for
        the device.
    """

    adapts_size = True

    def __init__(
        self, structure: Structure, opened: OpenDevice, *, rays_at_once: int = RAYS_AT_ONCE
    ) -> None:
        super().__init__(structure, opened, rays_at_once)
        self._textures = RayTextures(opened, self._shaders)
        self._latest = Kind.FIRST_HIT
        self._program(Kind.FIRST_HIT, False, False)  # raises for a shader that does not compile

    def _run(self, chunk: Chunk) -> NDArray[np.uint32]:
        kind, tallies = chunk.kind, chunk.tallies
        self._latest = kind
        textures, device = self._textures, self.opened.device
        rows = chunk.row_count if kind == Kind.MULTI_HIT else 0
        textures.load(chunk.rays, chunk.rows, chunk.wanted, rows, tallies is not None)
        textures.write_params(self.structure.triangles.max_coordinate)
        encoder = device.create_command_encoder()
        frame = [textures.params, *(one.view for one in textures.inputs)]
        groups = [frame, *textures.resources(kind, tallies is not None)]
        program = self._program(kind, chunk.surfaces, tallies is not None)
        program.draw(encoder, groups, [textures.state, textures.found])
        device.queue.submit([encoder.finish()])
        endings = textures.state.read_records(len(chunk.wanted))[:, 1]
        counts = hit_counts(endings, self._shaders, self.opened)
        if tallies is not None:
            tallies[chunk.rows] += textures.read_tallies()
        return counts

    def _rows(self, count: int) -> NDArray[Any]:
        return self._textures.read_rows(self._latest, count)

    def _program(self, kind: Kind, surfaces: bool, counts: bool) -> FragmentProgram:
        instead = self._textures.instead(kind, counts)
        instead["fragment/targets.wgsl"] = "fragment/targets_found.wgsl"
        source = self._shaders.source("fragment/branching.wgsl", instead=instead)
        constants = {
            "QUERY": float(kind),
            "SURFACES": float(surfaces),
            **self._shaders.constants,
        }
        layouts = [FRAME, *self._textures.layouts(kind, counts)]
        program = Program(source, "trace", layouts, constants)
        formats = [one.format for one in (self._textures.state, self._textures.found)]
        name = f"{self._shaders.name}, {kind.name}"
        return FragmentProgram(self.opened, name, program, formats)
