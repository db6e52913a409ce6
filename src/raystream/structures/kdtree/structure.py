"""KdTree: the kd-tree as a structure."""

from __future__ import annotations

import operator
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.leaf_block import filled_blocks
from raystream.kernels.queries import ray_queries
from raystream.structures.base import BuildReport, Structure
from raystream.structures.kdtree.build import Method, build_arrays
from raystream.structures.kdtree.layout import MAX_DEPTH, KdArrays, check_arrays, usual_depth, walk
from raystream.structures.kdtree.packed import LEAF_BIT, PackedArrays, extend, pack
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.state import STACK_BYTES, KdAddresses
from raystream.structures.kdtree.traversal import traverse

__all__ = ["LAYOUTS", "TRAVERSALS", "KdTree", "chosen_options", "method_of"]

#: How a search goes on after a leaf, in the order of `state.STACK` and so on.
TRAVERSALS = ("stack", "restart", "backtrack", "short-stack")

#: Bytes of a node: 8, or Foley's 12.
LAYOUTS = ("compact", "foley")

#: A leaf's triangles and an option's place in a file are numbers of so many at most.
_MAX_LEAF_SIZE = 1024


class KdTree(Structure):
    """A kd-tree (Foley 2005): every node is a box that a plane splits into two.

    Parameters
    ----------
    triangles : Triangles
    traversal : {"stack", "restart", "backtrack", "short-stack"}
        How a search goes on after a leaf: with what it left on a stack; from the root again;
        by going up to where the rest of the ray begins; or with a stack of four nodes, and
        again from far up where that has forgotten one (Horn 2007). They visit the same leaves
        in the same order.
    layout : {"compact", "foley"}
        Nodes of 8 bytes, or Foley's of 12, with both children's pointers. ``"backtrack"``
        takes another 32 bytes for each split, in both.
    traversal_cost, intersection_cost : float
        Prices of a step at a split and of a triangle test, by which the tree is built; only
        their ratio matters. The defaults are measured, and happen to be Foley's.
    empty_bonus : float
        Share, 0 to 1, of its price by which a split is cheaper that cuts off empty space.
    max_depth : int, optional
        Most splits on a path, up to 64. Without it 8 + 1.3 log2 of the number of triangles,
        as in pbrt, but at most 64.
    max_leaf_size : int
        Cells with so many triangles or fewer are not split, 1 to 1024. Leaves may have more:
        where splits do not pay, or `max_depth` is reached.
    progress : callable, optional
        Called with (triangles placed, triangles) while building.

    Attributes
    ----------
    tree : KdArrays
    blocks : ndarray of shape (B, 40), float32
        The leaves' triangles; see `kernels.leaf_block`.
    packed : PackedArrays or None
        The tree in Foley's layout; None for nodes of 8 bytes, or without nodes.
    extended : ndarray of shape (S, 8), float32, or None
        What `packed.extend` gives; None unless it backtracks, or without nodes.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If a number is no number, or no integer where one is needed.

    Notes
    -----
    Triangles are listed in every leaf that they reach into, and met in one: see
    docs/decisions/0011-kdtree.rst.
    """

    name = "kdtree"
    queries = ray_queries(traverse, STACK_BYTES)

    def __init__(
        self,
        triangles: Triangles,
        *,
        traversal: str = "stack",
        layout: str = "compact",
        traversal_cost: float = 8.0,
        intersection_cost: float = 1.0,
        empty_bonus: float = 0.2,
        max_depth: int | None = None,
        max_leaf_size: int = 1,
        progress: Progress | None = None,
    ) -> None:
        started = time.perf_counter()
        costs = traversal_cost, intersection_cost, empty_bonus
        options = chosen_options(traversal, layout, *costs, max_depth, max_leaf_size)
        tree = build_arrays(triangles, method_of(options, len(triangles.prim_ids)), progress)
        self._set(triangles, tree, options, started)

    def _set(
        self, triangles: Triangles, tree: KdArrays, options: Mapping[str, Any], started: float
    ) -> None:
        self.triangles = triangles
        self.tree = tree
        self.options = options
        self.blocks = filled_blocks(tree.prim_ids, triangles.corners)
        self.packed: PackedArrays | None = None
        self.extended: NDArray[np.float32] | None = None
        self._memory: dict[str, NDArray[Any]] = {"blocks": self.blocks}
        root = 0
        if len(tree.nodes):
            if options["layout"] == "foley":
                self.packed = pack(tree.nodes)
                self._memory |= {"nodes": self.packed.splits, "leaves": self.packed.leaves}
                root = 1 << LEAF_BIT if len(tree.nodes) == 1 else 0
            else:
                self._memory["nodes"] = tree.nodes
            if options["traversal"] == "backtrack":
                self.extended = extend(tree.nodes, self.packed is not None)
                self._memory["extended"] = self.extended
        (low_x, low_y, low_z), (high_x, high_y, high_z) = triangles.bounds
        self._addresses = KdAddresses(
            self._address_of("nodes"),
            None if self.packed is None else self._address_of("leaves"),
            self._address_of("extended"),
            self._address_of("blocks"),
            np.uint64(root),
            np.uint64(TRAVERSALS.index(options["traversal"])),
            (low_x, low_y, low_z),
            (high_x, high_y, high_z),
        )
        held = {id(array): array.nbytes for array in (*tree, *self._memory.values())}
        self.report = BuildReport(time.perf_counter() - started, sum(held.values()))

    def _address_of(self, name: str) -> np.uint64:
        array = self._memory.get(name)
        return np.uint64(0 if array is None else array.ctypes.data)

    @property
    def memory(self) -> dict[str, NDArray[Any]]:
        """Nodes, leaf blocks, and what the layout and the traversal need besides."""
        return self._memory

    @property
    def arrays(self) -> KdAddresses:
        """Where the tree is; the structure keeps it."""
        return self._addresses

    def with_traversal(self, traversal: str) -> KdTree:
        """The same tree, searched in another way; it is not built again.

        Parameters
        ----------
        traversal : {"stack", "restart", "backtrack", "short-stack"}

        Raises
        ------
        ValueError
            If it is none of them.
        """
        started = time.perf_counter()
        options = {**self.options, "traversal": traversal}
        _check(options)
        other = KdTree.__new__(KdTree)
        other._set(self.triangles, self.tree, options, started)
        return other

    def quality(self) -> dict[str, float]:
        """Counts, depth, bytes, and what a random line through the bounds meets.

        Returns
        -------
        dict of str to float
            ``nodes``, ``leaves``, ``empty leaves``; ``references``: triangles in all leaves,
            those in several counted as often; ``depth``: splits on the longest path; ``bytes
            per node``: of splits and leaves, without triangles, with all that the traversal
            needs; ``splits per ray``, ``leaves per ray``, ``tests per ray``: what a random
            line through the bounds meets, hits or no hits (nan where the scene has no area);
            ``cost``: their price.
        """
        node_count = len(self.tree.nodes)
        if node_count == 0:
            return dict.fromkeys(("nodes", "leaves", "empty leaves", "references", "depth"), 0.0)
        found = walk(self.tree.nodes, self.triangles.bounds)
        node_bytes = sum(array.nbytes for name, array in self._memory.items() if name != "blocks")
        cost = self.options["traversal_cost"] * found.splits_per_ray
        cost += self.options["intersection_cost"] * found.tests_per_ray
        return {
            "nodes": float(node_count),
            "leaves": float(found.leaf_count),
            "empty leaves": float(found.empty_count),
            "references": float(found.reference_count),
            "depth": float(found.depth),
            "bytes per node": node_bytes / node_count,
            "splits per ray": found.splits_per_ray,
            "leaves per ray": found.leaves_per_ray,
            "tests per ray": found.tests_per_ray,
            "cost": cost,
        }

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The tree, and how it was built and is traced."""
        options = self.options
        numbers = [
            TRAVERSALS.index(options["traversal"]),
            LAYOUTS.index(options["layout"]),
            options["traversal_cost"],
            options["intersection_cost"],
            options["empty_bonus"],
            -1 if options["max_depth"] is None else options["max_depth"],
            options["max_leaf_size"],
        ]
        return {**self.tree._asdict(), "options": np.array(numbers, np.float64)}

    @classmethod
    def from_arrays(cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]]) -> KdTree:
        """Make a kd-tree of saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        options = _saved_options(arrays)
        tree = check_arrays(arrays, triangles.prim_ids, len(triangles))
        structure = cls.__new__(cls)
        structure._set(triangles, tree, options, started)
        return structure


def chosen_options(
    traversal: str,
    layout: str,
    traversal_cost: float,
    intersection_cost: float,
    empty_bonus: float,
    max_depth: int | None,
    max_leaf_size: int,
) -> dict[str, Any]:
    """The options of a kd-tree, checked; see `KdTree`."""
    options = {
        "traversal": traversal,
        "layout": layout,
        "traversal_cost": float(traversal_cost),
        "intersection_cost": float(intersection_cost),
        "empty_bonus": float(empty_bonus),
        "max_depth": None if max_depth is None else operator.index(max_depth),
        "max_leaf_size": operator.index(max_leaf_size),
    }
    _check(options)
    return options


def method_of(options: Mapping[str, Any], triangle_count: int) -> Method:
    """How to grow a tree with such options."""
    max_depth = options["max_depth"]
    if max_depth is None:
        max_depth = usual_depth(triangle_count)
    costs = Costs(options["traversal_cost"], options["intersection_cost"], options["empty_bonus"])
    return Method(costs, max_depth, options["max_leaf_size"])


def _check(options: Mapping[str, Any]) -> None:
    """Raise ValueError for the first option that is out of range."""
    for name, known in (("traversal", TRAVERSALS), ("layout", LAYOUTS)):
        if options[name] not in known:
            expected = ", ".join(map(repr, known))
            raise ValueError(f"{name}: expected one of {expected}, got {options[name]!r}")
    for name in ("traversal_cost", "intersection_cost"):
        if not 1e-6 <= options[name] <= 1e6:
            raise ValueError(f"{name}: expected 1e-6 to 1e6, got {options[name]}")
    if not 0.0 <= options["empty_bonus"] <= 1.0:
        raise ValueError(f"empty_bonus: expected 0 to 1, got {options['empty_bonus']}")
    depth, size = options["max_depth"], options["max_leaf_size"]
    if depth is not None and not 0 <= depth <= MAX_DEPTH:
        raise ValueError(f"max_depth: expected 0 to {MAX_DEPTH}, got {depth}")
    if not 1 <= size <= _MAX_LEAF_SIZE:
        raise ValueError(f"max_leaf_size: expected 1 to {_MAX_LEAF_SIZE}, got {size}")


def _saved_options(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Build options from a file, for when the tree is built anew."""
    numbers = arrays.get("options")
    if numbers is None or numbers.shape != (7,) or numbers.dtype != np.float64:
        raise ValueError("array 'options' is missing or of another kind")
    traversal, layout, depth, size = numbers[[0, 1, 5, 6]].tolist()
    whole = all(number.is_integer() for number in (traversal, layout, depth, size))
    if not (whole and 0 <= traversal < len(TRAVERSALS) and 0 <= layout < len(LAYOUTS)):
        raise ValueError("its build options are out of range")
    options = {
        "traversal": TRAVERSALS[int(traversal)],
        "layout": LAYOUTS[int(layout)],
        "traversal_cost": float(numbers[2]),
        "intersection_cost": float(numbers[3]),
        "empty_bonus": float(numbers[4]),
        "max_depth": None if depth == -1 else int(depth),
        "max_leaf_size": int(size),
    }
    _check(options)
    return options
