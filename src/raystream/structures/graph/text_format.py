"""Graphs as text, to inspect and compare: one line per triangle, sector and link node.

::

    Count T S N
    Triangle i ; x y z ; x y z ; x y z
    Sector i ; low x, high x, ... high z ; flags ; six links ; triangle count ; triangles
    Node i ; axis plane ; flags ; link below, link above
    Bins X Y Z ; sectors

The k-th link is the number of a sector, or -1, if bit k of the flags is set, else of a link node.
Numbers are read back with the same bits.

The first four kinds of lines have the format of Rayforce's logs; the last one is our own.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from raystream.structures.graph.layout import (
    NODE_BIT,
    NODE_WORDS,
    SECTOR_ROWS,
    VOID,
    GraphArrays,
)

#: Enough digits to read back the same float32.
_FLOAT = "%.9g"

#: Words of a sector's row: low and high side of each axis in turn.
_EDGES = [0, 4, 1, 5, 2, 6]


def dump_graph(file: TextIO, graph: GraphArrays, corners: NDArray[np.float32]) -> None:
    """Write a graph.

    Parameters
    ----------
    file : text file
    graph : GraphArrays
    corners : ndarray of shape (F, 3, 3), float32
        Of all triangles of the scene.
    """
    count = graph.sector_count
    sectors = graph.rows[: SECTOR_ROWS * count].reshape(count, SECTOR_ROWS * NODE_WORDS)
    nodes = graph.rows[SECTOR_ROWS * count :]
    file.write(f"Count {len(corners)} {count} {len(nodes)}\n")
    for i, triangle in enumerate(corners.tolist()):
        file.write(f"Triangle {i} ; " + " ; ".join(map(_floats, triangle)) + "\n")
    edges = sectors[:, _EDGES].view(np.float32).tolist()
    for i, words in enumerate(sectors.tolist()):
        flags, links = _links(words[8:14], count)
        first, size = words[3], words[7]
        listed = graph.prim_ids[first : first + -(-size // 4)].ravel()[:size].tolist()
        numbers = " ".join(map(str, [size, ";", *listed]))
        file.write(f"Sector {i} ; {_floats(edges[i])} ; {flags} ; {links} ; {numbers}\n")
    planes = np.ascontiguousarray(nodes[:, 0]).view(np.float32).tolist()
    for i, words in enumerate(nodes.tolist()):
        flags, links = _links(words[2:], count)
        file.write(f"Node {i} ; {words[1]} {_FLOAT % planes[i]} ; {flags} ; {links}\n")
    shape = " ".join(map(str, graph.bins.shape))
    numbers = " ".join(map(str, (graph.bins.ravel() // SECTOR_ROWS).tolist()))
    file.write(f"Bins {shape} ; {numbers}\n")


def _floats(numbers: Iterable[float]) -> str:
    return " ".join(_FLOAT % number for number in numbers)


def _links(links: list[int], sector_count: int) -> tuple[int, str]:
    """Flags and numbers of links."""
    flags, numbers = 0, []
    for place, link in enumerate(links):
        if link == VOID or not link & NODE_BIT:
            flags |= 1 << place
            numbers.append(-1 if link == VOID else link // SECTOR_ROWS)
        else:
            numbers.append((link ^ NODE_BIT) - SECTOR_ROWS * sector_count)
    return flags, " ".join(map(str, numbers))
