"""DeviceKdTree: a kd-tree built on a device and kept in its memory."""

from __future__ import annotations

import time

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.builders.device_resident import RebuiltOnDevice, Resident
from raystream.cuda.builders.kdtree.blocks import prim_ids_of
from raystream.cuda.builders.kdtree.grow import grow_tree
from raystream.cuda.builders.kdtree.numbering import number_nodes
from raystream.cuda.builders.kdtree.write_tree import write_tree
from raystream.jit.constants import NULL
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.structures.kdtree.layout import KdArrays
from raystream.structures.kdtree.nodes import KdAddresses
from raystream.structures.kdtree.options import TRAVERSALS, KdTree
from raystream.structures.kdtree.structure import KdTreeStructure, settings_of


class DeviceKdTree(RebuiltOnDevice, KdTreeStructure):
    """A kd-tree in device memory, copied to the host when first needed there."""

    _host_class = KdTreeStructure
    _host_names = ("tree", "blocks", "packed", "extended", "view", "arrays")

    def _host_arguments(self) -> tuple[KdArrays]:
        nodes, blocks, *_ = self.resident.arrays
        return (KdArrays(nodes.host(), prim_ids_of(blocks)),)


def _resident(triangles: Triangles, arrays: tuple[DeviceArray, ...], traversal: str) -> Resident:
    """A tree and its addresses."""
    nodes, blocks, *extended = arrays
    (low_x, low_y, low_z), (high_x, high_y, high_z) = triangles.bounds
    tree = KdAddresses(
        nodes.address,
        None,
        extended[0].address if extended else NULL,
        blocks.address,
        np.uint64(0),
        np.uint64(TRAVERSALS.index(traversal)),
        (low_x, low_y, low_z),
        (high_x, high_y, high_z),
    )
    return Resident(tree, arrays)


def build_kdtree(gpu: Gpu, triangles: Triangles, options: KdTree) -> KdTreeStructure:
    """Build a kd-tree on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    options : KdTree
        With the compact layout; Foley's is built on the CPU only.

    Returns
    -------
    KdTreeStructure
        Its arrays equal the CPU's bit for bit.

    Raises
    ------
    ValueError
        If an option is out of range, or the tree would be too large.
    TypeError
        If an option is not a number, or not an integer where one is needed.
    CudaError
        If device memory runs out.
    """
    if options.layout != "compact":
        raise ValueError(f"layout: expected 'compact' where build='device', got {options.layout!r}")
    if len(triangles.prim_ids) == 0:
        return KdTreeStructure(triangles, options)
    started = time.perf_counter()
    corners = gpu.upload("corners", triangles.corners)
    settings = settings_of(options, len(triangles.prim_ids))
    tree = grow_tree(gpu, triangles, corners, settings)
    numbers = number_nodes(gpu, tree, len(triangles.prim_ids))
    arrays = write_tree(gpu, tree, numbers, corners, options.traversal == "backtrack")
    resident = _resident(triangles, arrays, options.traversal)
    return DeviceKdTree(gpu, triangles, options, resident, started)
