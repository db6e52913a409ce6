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

import struct
from collections.abc import Iterable, Iterator
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


def load_graph(file: TextIO) -> tuple[GraphArrays, NDArray[np.float32]]:
    """Read a graph.

    Parameters
    ----------
    file : text file

    Returns
    -------
    GraphArrays
        Checked for its form only: see `check.check_graph`.
    corners : ndarray of shape (F, 3, 3), float32

    Raises
    ------
    ValueError
        If the format is not that of `dump_graph`.
    """
    lines = enumerate(file, 1)
    (counts,) = _read(lines, "Count", None, 1)
    if len(counts) != 3:
        raise ValueError("line 1: expected three counts")
    triangle_count, sector_count, node_count = map(int, counts)
    corners = [_read_triangle(lines, i) for i in range(triangle_count)]
    sectors, blocks = [], list[list[int]]()
    for i in range(sector_count):
        row, listed = _read_sector(lines, i, sector_count)
        sectors.append([*row[:3], len(blocks), *row[3:6], len(listed), *row[6:], 0, 0])
        listed += [-1] * (-len(listed) % 4)
        blocks += [listed[k : k + 4] for k in range(0, len(listed), 4)]
    nodes = [_read_node(lines, i, sector_count) for i in range(node_count)]
    shape, numbers = _read(lines, "Bins", None, 2)
    rows = np.array(sectors, np.uint32).reshape(-1, 4), np.array(nodes, np.uint32).reshape(-1, 4)
    bins = np.array(numbers, np.int64) * SECTOR_ROWS
    try:
        graph = GraphArrays(
            np.concatenate(rows),
            sector_count,
            np.array(blocks, np.int32).reshape(-1, 4),
            bins.astype(np.uint32).reshape([int(n) for n in shape]),
        )
    except (OverflowError, ValueError) as error:
        raise ValueError(f"numbers out of range: {error}") from None
    return graph, np.array(corners, np.float32).reshape(-1, 3, 3)


def _read(
    lines: Iterator[tuple[int, str]], name: str, number: int | None, part_count: int
) -> list[list[str]]:
    """The parts of the next line, each a list of words, without name and number."""
    place, line = next(lines, (0, ""))
    begin = name if number is None else f"{name} {number} ;"
    parts = line.removeprefix(begin).split(";")
    if not line.startswith(begin) or len(parts) != part_count:
        raise ValueError(f"line {place}: expected {begin!r} and {part_count} parts")
    return [part.split() for part in parts]


def _bits(numbers: list[str]) -> list[int]:
    """The bits of float32 numbers."""
    count = len(numbers)
    return list(struct.unpack(f"{count}I", struct.pack(f"{count}f", *map(float, numbers))))


def _link_words(flags: str, numbers: list[str], sector_count: int) -> list[int]:
    words = []
    for place, number in enumerate(map(int, numbers)):
        if not int(flags) >> place & 1:
            words.append(NODE_BIT | (SECTOR_ROWS * sector_count + number))
        else:
            words.append(VOID if number == -1 else SECTOR_ROWS * number)
    return words


def _read_triangle(lines: Iterator[tuple[int, str]], number: int) -> list[list[float]]:
    parts = _read(lines, "Triangle", number, 3)
    if any(len(part) != 3 for part in parts):
        raise ValueError(f"triangle {number}: expected nine coordinates")
    return [[float(word) for word in part] for part in parts]


def _read_sector(
    lines: Iterator[tuple[int, str]], number: int, sector_count: int
) -> tuple[list[int], list[int]]:
    """A sector's low and high corner and links, and its triangles."""
    edges, flags, links, size, listed = _read(lines, "Sector", number, 5)
    if (len(edges), len(flags), len(links), len(size)) != (6, 1, 6, 1) or int(size[0]) != len(
        listed
    ):
        raise ValueError(f"sector {number}: expected other counts of numbers")
    box = _bits([edges[k] for k in (0, 2, 4, 1, 3, 5)])
    return box + _link_words(flags[0], links, sector_count), [int(word) for word in listed]


def _read_node(lines: Iterator[tuple[int, str]], number: int, sector_count: int) -> list[int]:
    plane, flags, links = _read(lines, "Node", number, 3)
    if (len(plane), len(flags), len(links)) != (2, 1, 2):
        raise ValueError(f"node {number}: expected other counts of numbers")
    return [*_bits(plane[1:]), int(plane[0]), *_link_words(flags[0], links, sector_count)]
