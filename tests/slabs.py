"""Slabs: a structure from outside the package, in one file, for docs/add_a_structure.

The triangles are sorted along the longest axis of the scene and cut into slabs of equally many;
each slab has the box around its triangles.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

import raystream as rs
from raystream.core.options import Range
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.search import is_full
from raystream.kernels.slab import box_interval
from raystream.kernels.tally import LEAVES, STEPS, add_to
from raystream.kernels.triangle_list import intersect_list
from raystream.structures.base import BuildReport, Structure
from raystream.structures.saved import take


class SlabAddresses(NamedTuple):
    """The view of the traversal: addresses of arrays, which the structure keeps alive."""

    prim_ids: np.uint64  # (A,), int32: the triangles that can be hit, in the order of the slabs
    corners: np.uint64  # (F, 3, 3), float32: all triangles of the scene
    splits: np.uint64  # (S + 1,), uint64: slab i owns prim_ids splits[i] to splits[i + 1]
    boxes: np.uint64  # (S, 6), float32: low x, y, z, high x, y, z of each slab
    slab_count: np.uint64


_ONE = np.uint64(1)
_INF = np.float32(np.inf)


@device
def number_at(address, row, column):
    """A number of the box of a slab."""
    return load(np.float32, address + (np.uint64(6) * row + np.uint64(column)) * np.uint64(4))


@device
def traverse(view, ray, search, stack):
    """Test the triangles of all slabs whose boxes the ray enters before the best hit."""
    for i in range(view.slab_count):
        slab, boxes = np.uint64(i), view.boxes
        add_to(search.counters, STEPS, _ONE)
        t_in, t_out = box_interval(
            ray,
            number_at(boxes, slab, 0),
            number_at(boxes, slab, 1),
            number_at(boxes, slab, 2),
            number_at(boxes, slab, 3),
            number_at(boxes, slab, 4),
            number_at(boxes, slab, 5),
        )
        # Never left out at the same t: a triangle with a lower prim_id may be in it.
        if max(t_in, search.t_min) <= min(t_out, search.t_far):
            add_to(search.counters, LEAVES, _ONE)
            begin = load(np.uint64, view.splits + slab * np.uint64(8))
            end = load(np.uint64, view.splits + (slab + _ONE) * np.uint64(8))
            lists = view.prim_ids, view.corners, begin, end
            search = intersect_list(*lists, ray, search, search.t_min, _INF)
            if is_full(search):
                break
    return search


class SlabStructure(Structure):
    """Slabs, built."""

    traverse = staticmethod(traverse)

    def __init__(self, triangles, options, *, progress=None):
        started = time.perf_counter()
        prim_ids = triangles.prim_ids  # of the triangles that can be hit
        corners = triangles.corners[prim_ids]
        middles = corners.mean(axis=1)
        axis = np.ptp(middles, axis=0).argmax() if len(prim_ids) else 0
        slab_count = min(options.slab_count, len(prim_ids))
        splits = np.linspace(0, len(prim_ids), slab_count + 1).astype(np.uint64)
        self._set(triangles, options, prim_ids[middles[:, axis].argsort()], splits, started)
        if progress:
            progress(len(prim_ids), len(prim_ids))

    def _set(self, triangles, options, prim_ids, splits, started):
        self.triangles, self.options = triangles, options
        boxes = [
            np.concatenate([slab.min(axis=(0, 1)), slab.max(axis=(0, 1))])
            for slab in np.split(triangles.corners[prim_ids], splits[1:-1].astype(np.int64))
            if len(slab)
        ]
        self.arrays = {
            "prim_ids": np.ascontiguousarray(prim_ids),
            "corners": np.ascontiguousarray(triangles.corners),
            "splits": splits,
            "boxes": np.array(boxes, np.float32),
        }
        addresses = (np.uint64(array.ctypes.data) for array in self.arrays.values())
        self.view = SlabAddresses(*addresses, np.uint64(len(boxes)))
        byte_count = sum(array.nbytes for array in self.arrays.values())
        self.report = BuildReport(time.perf_counter() - started, byte_count)

    def saved_arrays(self):
        """The order of the triangles, and where slabs begin."""
        return {name: self.arrays[name] for name in ("prim_ids", "splits")}

    @classmethod
    def from_arrays(cls, triangles, arrays, options):
        """Slabs from a file, which may be damaged or hostile."""
        started = time.perf_counter()
        prim_ids = take(arrays, "prim_ids", np.int32, (None,))
        splits = take(arrays, "splits", np.uint64, (None,))
        if not np.array_equal(np.sort(prim_ids), triangles.prim_ids):
            raise ValueError("the slabs do not list each triangle once")
        is_increasing = len(splits) < 2 or (splits[1:] > splits[:-1]).all()
        if len(splits) < 1 or splits[0] != 0 or splits[-1] != len(prim_ids) or not is_increasing:
            raise ValueError("the splits do not delimit the slabs")
        slabs = cls.__new__(cls)
        slabs._set(triangles, options, prim_ids, splits, started)
        return slabs

    def quality(self):
        """Figures to display."""
        return {"slabs": float(self.view.slab_count)}


@dataclass(frozen=True, kw_only=True)
class Slabs(rs.StructureOptions):
    """Triangles in slabs along the longest axis.

    Parameters
    ----------
    slab_count : int
        At most this many, 1 to 1024.
    """

    name = "slabs"
    structure = SlabStructure
    slab_count: Annotated[int, Range(1, 1024)] = 16
