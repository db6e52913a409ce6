"""Dispatcher: traces rays by dispatches of a compute shader."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, ReadBack, uniform, upload, whole
from raystream.graphics.errors import GraphicsError
from raystream.graphics.packing import ROW
from raystream.graphics.pipelines import Program, bind, compute_pipeline
from raystream.graphics.structures.base import ShaderStructure
from raystream.graphics.termination import hit_counts

#: Invocations of a workgroup; see compute.wgsl.
_GROUP_SIZE = 64

#: Bytes of a ray's tally.
_TALLY_BYTES = 32

#: The shared buffers, in the order of their bindings from 1 on.
_NAMES = ("rays", "wanted", "rows", "endings", "tallies")

#: Group 0: the uniform, and these.
_LAYOUT = ("uniform", "gather", "gather", "scatter", "scatter", "scatter")


class ShaderVariant(NamedTuple):
    """The variant of a shader: one is compiled for each.

    Attributes
    ----------
    kind : Kind
    surfaces : bool
        Whether a ray through an edge or vertex crosses a surface once.
    tallies : bool
        Whether steps and tests are counted.
    """

    kind: Kind
    surfaces: bool = False
    tallies: bool = False


class DispatchResults(NamedTuple):
    """The results of a dispatch of N rays.

    Attributes
    ----------
    counts : ndarray of shape (N,), uint32
        Hits of each ray.
    rows : ndarray of dtype `records.ROW`
    tallies : ndarray of shape (N, 8), uint32
        Empty if the shader does not count.
    """

    counts: NDArray[np.uint32]
    rows: NDArray[Any]
    tallies: NDArray[np.uint32]


class Dispatcher:
    """Runs a structure's compute shaders.

    Parameters
    ----------
    shaders : ShaderStructure
    opened : OpenDevice
    max_coordinate : float32
        Largest absolute coordinate of the scene.

    Attributes
    ----------
    arrays : list of Buffer
        The structure's.

    Raises
    ------
    GraphicsError
        If the structure is too large for the device.
    """

    def __init__(
        self, shaders: ShaderStructure, opened: OpenDevice, max_coordinate: np.float32
    ) -> None:
        self._shaders = shaders
        self._opened = opened
        self._max_coordinate = max_coordinate
        self._source = shaders.source("compute.wgsl")
        names = (f"{shaders.name}, array {k}" for k in range(len(shaders.arrays)))
        self.arrays = upload(opened, zip(names, shaders.arrays, strict=True))
        self._buffers = {name: Buffer(opened, name) for name in _NAMES}
        self._layouts = _LAYOUT, ("gather",) * len(self.arrays)
        self._params = uniform(opened, shaders.params(max_coordinate))
        self._read_back = ReadBack(opened)
        self._groups: list[Any] = []

    def pipeline(self, variant: ShaderVariant) -> Any:
        """The pipeline of a variant, compiled once.

        Raises
        ------
        GraphicsError
            If it does not compile.
        """
        constants = {
            "QUERY": float(variant.kind),
            "SURFACES": float(variant.surfaces),
            "COUNTS": float(variant.tallies),
            **self._shaders.constants,
        }
        name = f"{self._shaders.name}, {variant.kind.name}"
        program = Program(self._source, "trace", self._layouts, constants)
        return compute_pipeline(self._opened, name, program)

    def run(
        self,
        variant: ShaderVariant,
        rays: NDArray[np.float32],
        capacity: int,
        wanted: NDArray[np.uint32] | None = None,
        row_count: int = 0,
    ) -> DispatchResults:
        """Trace some rays.

        Parameters
        ----------
        variant : ShaderVariant
        rays : ndarray of shape (N, R, 4), float32
            R rows for each ray, such as those of `packing.packed_rays`.
        capacity : int
            Hits wanted of each ray, where that is the same for all.
        wanted : ndarray of shape (N, 2), uint32, optional
            First row and number of hits of each ray, where these differ.
        row_count : int
            Hits to keep, of all rays.

        Raises
        ------
        GraphicsError
            If the device is lost, or a search did not end normally.
        """
        count = len(rays)
        pipeline = self.pipeline(variant)
        sizes = (
            rays.nbytes,
            0 if wanted is None else wanted.nbytes,
            ROW.itemsize * row_count,
            4 * count,
            _TALLY_BYTES * count * variant.tallies,
        )
        self._reserve(sizes)
        try:
            memory = self._dispatch(pipeline, rays, capacity, wanted, sizes[2:])
        except Exception as error:  # wgpu wraps whatever a driver says
            raise GraphicsError(
                f"device 'graphics': {self._opened.adapter} failed to trace {count:,} rays: {error}"
            ) from error
        rows, endings, tallies = memory
        found = DispatchResults(
            hit_counts(endings.view(np.uint32), self._shaders, self._opened),
            rows.view(ROW),
            tallies.view(np.uint32).reshape(-1, _TALLY_BYTES // 4),
        )
        if wanted is not None and not np.array_equal(found.counts, wanted[:, 1]):
            raise GraphicsError(
                f"device 'graphics': {self._opened.adapter} found fewer hits than it had counted"
            )
        return found

    def _reserve(self, sizes: tuple[int, ...]) -> None:
        """Grow the buffers; new ones must be bound again."""
        grown = [
            self._buffers[name].reserve(size) for name, size in zip(_NAMES, sizes, strict=True)
        ]
        if any(grown):
            self._groups.clear()

    def _dispatch(
        self,
        pipeline: Any,
        rays: NDArray[np.float32],
        capacity: int,
        wanted: NDArray[np.uint32] | None,
        result_sizes: tuple[int, ...],
    ) -> list[NDArray[np.uint8]]:
        """Dispatch, and read rows, termination codes and tallies back, as bytes."""
        count = len(rays)
        groups = -(-count // _GROUP_SIZE)
        most = self._opened.limits["max-compute-workgroups-per-dimension"]
        columns = min(groups, most)
        row_size = columns * _GROUP_SIZE
        params = self._shaders.params(
            self._max_coordinate, ray_count=count, row_size=row_size, capacity=capacity
        )
        device = self._opened.device
        device.queue.write_buffer(self._params, 0, params)
        self._buffers["rays"].write(rays)
        if wanted is not None:
            self._buffers["wanted"].write(wanted)
        encoder = device.create_command_encoder()
        # 0 stays for an invocation that does not run.
        encoder.clear_buffer(self._buffers["endings"].handle, 0, 4 * count)
        run = encoder.begin_compute_pass()
        run.set_pipeline(pipeline)
        for number, group in enumerate(self._bound()):
            run.set_bind_group(number, group)
        run.dispatch_workgroups(columns, -(-groups // columns))
        run.end()
        results = [self._buffers[name] for name in ("rows", "endings", "tallies")]
        return self._read_back.read(encoder, list(zip(results, result_sizes, strict=True)))

    def _bound(self) -> list[Any]:
        if not self._groups:
            shared = [whole(self._params), *(self._buffers[name].binding for name in _NAMES)]
            own = [buffer.binding for buffer in self.arrays]
            self._groups = [
                bind(self._opened, layout, resources, is_compute=True)
                for layout, resources in zip(self._layouts, (shared, own), strict=True)
            ]
        return self._groups
