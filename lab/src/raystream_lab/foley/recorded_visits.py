"""Every node that rays visit in a kd-tree, from walks recorded with the machine's own kernels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.walks import record

#: Kernels whose steps visit a node.
_VISITING = ("down", "leaf", "up")


class TreeVisits(NamedTuple):
    """Visits of all rays, in the order in which each ray makes them.

    Attributes
    ----------
    nodes : ndarray of shape (V,), uint32
        The node at which each step began.
    kernels : ndarray of shape (V,), uint8
        Index into `names`.
    rays : ndarray of shape (V,), uint32
    run_starts : ndarray of shape (M,), int64
        The first visit of each run of steps of one kernel.
    names : tuple of str
    parents : ndarray of shape (N,), uint32
        Of each node; the root's is itself.
    """

    nodes: NDArray[np.uint32]
    kernels: NDArray[np.uint8]
    rays: NDArray[np.uint32]
    run_starts: NDArray[np.int64]
    names: tuple[str, ...]
    parents: NDArray[np.uint32]

    def of(self, kernel: str) -> NDArray[np.bool_]:
        """Which visits are steps of a kernel."""
        return np.asarray(self.kernels == self.names.index(kernel))

    def reached(self) -> NDArray[np.uint32]:
        """The nodes that the steps of `up` reach."""
        return np.asarray(self.parents[self.nodes[self.of("up")]])


def parents_of(tree: KdTreeStructure) -> NDArray[np.uint32]:
    """The parent of each node of a tree; the root's is itself."""
    words = tree.tree.nodes[:, 1]
    parents = np.zeros(len(words), np.uint32)
    (splits,) = np.nonzero(words & 3 != LEAF_AXIS)
    left = words[splits] >> 2
    parents[left], parents[left + 1] = splits, splits
    return parents


def record_visits(
    tree: KdTreeStructure,
    origins: Any,
    directions: Any,
    *,
    t_max: Any = np.inf,
    any_hit: bool = False,
    progress: Progress | None = None,
) -> TreeVisits:
    """Record the nodes that rays visit; see `record`.

    Parameters
    ----------
    tree : KdTreeStructure
        With the layout ``"compact"``, whose nodes have one row each.
    origins, directions, t_max, any_hit, progress
        See `record`.

    Raises
    ------
    ValueError
        If the tree has another layout.
    """
    if tree.packed is not None:
        raise ValueError("tree: expected the layout 'compact'; Foley's numbers leaves apart")
    walks = record(
        tree,
        origins,
        directions,
        t_max=t_max,
        any_hit=any_hit,
        visits=True,
        progress=progress,
    )
    assert walks.visits is not None
    assert walks.visit_splits is not None
    visiting = np.isin(walks.run_kernels, [walks.names.index(name) for name in _VISITING])
    lengths = walks.run_lengths[visiting].astype(np.int64)
    return TreeVisits(
        walks.visits,
        np.repeat(walks.run_kernels[visiting], lengths),
        np.repeat(np.arange(len(walks), dtype=np.uint32), np.diff(walks.visit_splits)),
        np.cumsum(lengths) - lengths,
        walks.names,
        parents_of(tree),
    )


class Climbs(NamedTuple):
    """Climbs of at least some length.

    Attributes
    ----------
    rays : ndarray of shape (C,), uint32
        Ascending, each at most once.
    nodes : ndarray of shape (C, K), uint32
        The nodes reached by the first K steps.
    """

    rays: NDArray[np.uint32]
    nodes: NDArray[np.uint32]


def last_climbs(visits: TreeVisits, length: int) -> Climbs:
    """The last climb of at least `length` steps of each ray that has one.

    Not the first: all camera rays start in the leaf that contains the camera.
    """
    starts = visits.run_starts
    ends = np.append(starts[1:], len(visits.nodes))
    is_up = visits.kernels[starts] == visits.names.index("up")
    first = starts[is_up & (ends - starts >= length)]
    rays = visits.rays[first]
    is_last = np.append(rays[1:] != rays[:-1], True) if len(rays) else np.zeros(0, bool)
    first = first[is_last]
    steps = first[:, None] + np.arange(length)
    return Climbs(rays[is_last], visits.parents[visits.nodes[steps]])
