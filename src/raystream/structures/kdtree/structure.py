"""KdTreeStructure: the built kd-tree."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.leaf_block import filled_blocks
from raystream.structures.base import BuildReport, Structure
from raystream.structures.kdtree.build import build_arrays
from raystream.structures.kdtree.foley_layout import LEAF_BIT, FoleyArrays, extend, pack
from raystream.structures.kdtree.layout import KdArrays, check_arrays, depth_limit, measure
from raystream.structures.kdtree.nodes import KdAddresses
from raystream.structures.kdtree.options import OVERLAPS, TRAVERSALS, KdTree
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.state import STACK_BYTES
from raystream.structures.kdtree.subtree import BuildSettings
from raystream.structures.kdtree.traversal import traverse
from raystream.structures.saved import solid_mask


class KdTreeStructure(Structure):
    """A kd-tree, built; see `KdTree`.

    Parameters
    ----------
    triangles : Triangles
    options : KdTree
    progress : callable, optional
        Called with (triangles placed, triangles) while building.

    Attributes
    ----------
    tree : KdArrays
    blocks : ndarray of shape (B, 40), float32
        The leaves' triangles; see `kernels.leaf_block`.
    packed : FoleyArrays or None
        The tree in Foley's layout; None for nodes of 8 bytes, or without nodes.
    extended : ndarray of shape (S, 8), float32, or None
        Extended splits, see `foley_layout.extend`; None unless it backtracks, or without nodes.

    Notes
    -----
    Triangles are listed in every leaf that they overlap, but hit in only one: see
    docs/decisions/0011-kdtree.rst.
    """

    traverse = staticmethod(traverse)
    stack_bytes = STACK_BYTES
    options: KdTree

    def __init__(
        self, triangles: Triangles, options: KdTree, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        tree = build_arrays(triangles, settings_of(options, len(triangles.prim_ids)), progress)
        self._set(triangles, tree, options, started)

    def _set(self, triangles: Triangles, tree: KdArrays, options: KdTree, started: float) -> None:
        self.triangles = triangles
        self.tree = tree
        self.options = options
        self.blocks = filled_blocks(tree.prim_ids, triangles.corners)
        self.packed: FoleyArrays | None = None
        self.extended: NDArray[np.float32] | None = None
        self.arrays = {"blocks": self.blocks}
        root = 0
        if len(tree.nodes):
            if options.layout == "foley":
                self.packed = pack(tree.nodes)
                self.arrays |= {"nodes": self.packed.splits, "leaves": self.packed.leaves}
                root = 1 << LEAF_BIT if len(tree.nodes) == 1 else 0
            else:
                self.arrays["nodes"] = tree.nodes
            if options.traversal == "backtrack":
                self.extended = extend(tree.nodes, self.packed is not None)
                self.arrays["extended"] = self.extended
        (low_x, low_y, low_z), (high_x, high_y, high_z) = triangles.bounds
        self.view = KdAddresses(
            self._address_of("nodes"),
            None if self.packed is None else self._address_of("leaves"),
            self._address_of("extended"),
            self._address_of("blocks"),
            np.uint64(root),
            np.uint64(TRAVERSALS.index(options.traversal)),
            (low_x, low_y, low_z),
            (high_x, high_y, high_z),
        )
        held = {id(array): array.nbytes for array in (*tree, *self.arrays.values())}
        self.report = BuildReport(time.perf_counter() - started, sum(held.values()))

    def _address_of(self, name: str) -> np.uint64:
        array = self.arrays.get(name)
        return np.uint64(0 if array is None else array.ctypes.data)

    def with_traversal(self, traversal: str) -> KdTreeStructure:
        """The same tree with another traversal, without a rebuild.

        Parameters
        ----------
        traversal : {"stack", "restart", "backtrack", "short-stack"}

        Raises
        ------
        ValueError
            If it is unknown.
        """
        started = time.perf_counter()
        options = dataclasses.replace(self.options, traversal=traversal)  # type: ignore[arg-type]
        other = KdTreeStructure.__new__(KdTreeStructure)
        other._set(self.triangles, self.tree, options, started)
        return other

    def quality(self) -> dict[str, float]:
        """Counts, depth, bytes, and expected work of a random line through the bounds.

        Returns
        -------
        dict of str to float
            ``nodes``, ``leaves``, ``empty leaves``; ``references``: triangles in all leaves,
            one in several leaves counted several times; ``depth``: splits on the longest path;
            ``bytes per node``: of splits and leaves and all else that the traversal
            needs, without triangles; ``splits per ray``, ``leaves per ray``, ``tests per ray``:
            expected for a random line through the bounds, hits or not (nan where the scene has
            no area); ``cost``: of these.
        """
        node_count = len(self.tree.nodes)
        if node_count == 0:
            return dict.fromkeys(("nodes", "leaves", "empty leaves", "references", "depth"), 0.0)
        found = measure(self.tree.nodes, self.triangles.bounds)
        node_bytes = sum(array.nbytes for name, array in self.arrays.items() if name != "blocks")
        cost = self.options.traversal_cost * found["splits per ray"]
        cost += self.options.intersection_cost * found["tests per ray"]
        return {**found, "bytes per node": node_bytes / node_count, "cost": cost}

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The tree."""
        return self.tree._asdict()

    @classmethod
    def from_arrays(
        cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]], options: KdTree
    ) -> KdTreeStructure:
        """Make a kd-tree from saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        tree = check_arrays(arrays, solid_mask(triangles))
        structure = cls.__new__(cls)
        structure._set(triangles, tree, options, started)
        return structure


def settings_of(options: KdTree, triangle_count: int) -> BuildSettings:
    """The build settings of some options."""
    max_depth = depth_limit(options.max_depth, triangle_count)
    costs = Costs(options.traversal_cost, options.intersection_cost, options.empty_bonus)
    overlap = OVERLAPS.index(options.overlap)
    return BuildSettings(costs, max_depth, options.max_leaf_size, overlap)
