"""DeviceGrid: a uniform grid built on a device and kept in its memory."""

from __future__ import annotations

import time

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.builders.device_resident import RebuiltOnDevice, Resident
from raystream.cuda.builders.lists import DeviceLists, build_lists
from raystream.jit.constants import NULL
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.structures.grid.build import choose_and_build
from raystream.structures.grid.lattice import Lattice
from raystream.structures.grid.layout import FineArrays, GridAddresses, GridArrays
from raystream.structures.grid.options import Grid
from raystream.structures.grid.structure import GridStructure


class DeviceGrid(RebuiltOnDevice, GridStructure):
    """A grid of one level in device memory, copied to the host when first needed there."""

    _host_class = GridStructure
    _host_names = ("lists", "_kept", "view", "arrays")
    lattice: Lattice
    fine = FineArrays.none()

    @property
    def _byte_count(self) -> int:
        """Of the lists; triangles are not counted."""
        splits, references, _ = self.resident.arrays
        return splits.nbytes + references.nbytes

    def _host_arguments(self) -> tuple[Lattice, GridArrays, FineArrays]:
        splits, references, _ = self.resident.arrays
        return self.lattice, GridArrays(splits.host(), references.host()), self.fine


def _addresses(lattice: Lattice, arrays: tuple[DeviceArray, ...]) -> GridAddresses:
    low, high, size, counts = (
        (np.float32(x), np.float32(y), np.float32(z))
        for x, y, z in (lattice.low, lattice.high, lattice.size, lattice.counts)
    )
    addresses = [one.address for one in arrays]
    return GridAddresses(low, high, size, counts, *addresses, *[NULL] * 4)


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
    arrays = *lists, corners
    resident = Resident(_addresses(lattice, arrays), arrays)
    made = DeviceGrid(gpu, triangles, options, resident, started)
    made.lattice = lattice
    return made
