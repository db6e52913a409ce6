"""The arrays of a sector graph: one relocatable piece of memory.

Sectors are boxes that tile the scene's box. Each of a sector's six faces has a link: to the
neighbouring sector; to a tree of link nodes, planes that separate several neighbours;
or nowhere, at the side of the scene's box. Links count rows of 16 bytes, so a graph does not
depend on its address.

The graph is our reading of Gribble and Naveros, "GPU Ray Tracing with Rayforce", SIGGRAPH 2013
posters, which describes sectors and nodes in a few sentences; no public builder exists.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Faces in the order of a sector's links: low and high side of each axis.
FACES = ("low x", "high x", "low y", "high y", "low z", "high z")

#: Words of 4 bytes per row, and so per link node; rows per sector.
NODE_WORDS = 4
SECTOR_ROWS = 4

#: A link is the row of a sector, or of a link node with this bit; `VOID` leads nowhere.
NODE_BIT = 1 << 31
VOID = 0xFFFFFFFF

#: Most rows of a graph: links have 31 bits for them, less the value in `VOID`.
MAX_ROWS = (1 << 31) - 1


class GraphArrays(NamedTuple):
    """A graph of sectors.

    Attributes
    ----------
    rows : ndarray of shape (R, 4), uint32
        First the sectors, 4 rows each, then the link nodes, 1 row each.

        A sector: low x, y, z (bits of float32, local frame), its first block; high x, y, z, its
        number of triangles; links of its faces, in the order of `FACES`; two unused words.

        A link node: position of its plane (bits of a float32); its axis; the link below the
        plane; the link above. Nodes come after those that they link to.
    sector_count : int
    prim_ids : ndarray of shape (B, 4), int32
        The triangles of the sectors' blocks; -1 in unused places. A sector's triangles fill
        its blocks from the first on.
    bins : ndarray of shape (X, Y, Z), uint32
        The row of the sector that contains the low corner of each bin; bins have equal size and
        tile the scene's box.
    """

    rows: NDArray[np.uint32]
    sector_count: int
    prim_ids: NDArray[np.int32]
    bins: NDArray[np.uint32]
