"""DeviceGrid: a uniform grid built on a device and kept in its memory."""

from __future__ import annotations

import time
from functools import cached_property

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.builders.device_resident import RebuiltOnDevice, finish
from raystream.cuda.builders.lists import DeviceLists, build_lists
from raystream.cuda.structures import Resident
from raystream.jit.constants import NULL
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.structures.grid.build import choose_and_build
from raystream.structures.grid.lattice import Lattice
from raystream.structures.grid.layout import FineArrays, GridAddresses, GridArrays
from raystream.structures.grid.options import Grid
from raystream.structures.grid.structure import GridStructure


class DeviceGrid(RebuiltOnDevice, GridStructure):
    """A grid in device memory, copied to the host when first needed there.

    Parameters
    ----------
    triangles : Triangles
    gpu : Gpu
    lattice : Lattice
    lists : DeviceLists
    corners : DeviceArray of shape (F, 3, 3), float32
    options : Grid
    started : float
        When the build began, by `time.perf_counter`.
    """

    _host_names = ("lists", "_kept", "view", "arrays")

    def __init__(
        self,
        triangles: Triangles,
        gpu: Gpu,
        lattice: Lattice,
        lists: DeviceLists,
        corners: DeviceArray,
        options: Grid,
        started: float,
    ) -> None:
        self.triangles, self.lattice, self.options = triangles, lattice, options
        self.gpu = gpu
        self.fine = FineArrays.none()
        low, high, size, counts = (
            (np.float32(x), np.float32(y), np.float32(z))
            for x, y, z in (lattice.low, lattice.high, lattice.size, lattice.counts)
        )
        arrays = lists.splits, lists.references, corners
        addresses = [one.address for one in arrays]
        tree = GridAddresses(low, high, size, counts, *addresses, *[NULL] * 4)
        self.resident = Resident(tree, arrays)
        byte_count = 4 * (lists.splits.shape[0] + lists.references.shape[0])
        self.report = finish(gpu, byte_count, started)

    @cached_property
    def _on_host(self) -> GridStructure:
        """The same grid with its arrays in host memory."""
        splits, references, _ = self.resident.arrays
        made = GridStructure.__new__(GridStructure)
        lists = GridArrays(splits.host(), references.host())
        made._set(self.triangles, self.lattice, lists, self.fine, self.options, 0.0)
        return made


def build_grid(gpu: Gpu, triangles: Triangles, options: Grid) -> GridStructure:
    """Build a grid on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    options : Grid
        With one level; two-level grids are built on the CPU only.

    Returns
    -------
    GridStructure
        Its arrays equal the CPU's bit for bit.

    Raises
    ------
    ValueError
        If an option is out of range, or the grid would be too large.
    CudaError
        If device memory runs out.
    """
    if options.levels != 1:
        raise ValueError(f"levels: expected 1 where build='device', got {options.levels}")
    if len(triangles.prim_ids) == 0:
        return GridStructure(triangles, options)
    started = time.perf_counter()
    corners = gpu.upload("corners", triangles.corners)

    def make(lattice: Lattice, most: int, _: str) -> DeviceLists:
        return build_lists(gpu, triangles, corners, lattice, most)

    lattice, lists = choose_and_build(triangles, options, make)
    return DeviceGrid(triangles, gpu, lattice, lists, corners, options, started)
