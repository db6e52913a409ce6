"""The layout of a grid, its triangles and the state of rays in texture memory."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.structures.grid.structure import GridStructure
from raystream_lab.published import published

#: Textures begin at multiples of this: the least common multiple of Purcell's cache line, 48 bytes,
#: and of all powers of two up to 4096.
ALIGNMENT = 3 * 4096

_WORD_BYTES = 4
_RGB_BYTES = 12
_RGBA_BYTES = 16
_VERTEX_TEXTURES = 3
_SHADING_TEXTURES = 7


class Kind(IntEnum):
    """The kind of data that a reference reads.

    Attributes
    ----------
    GRID
        A cell.
    LISTS
        An entry of a cell's list.
    TRIANGLES
        A vertex.
    SHADING
        A normal, a colour or other shading data of a triangle.
    STATE
        The state of a ray between two passes.
    """

    GRID = 0
    LISTS = 1
    TRIANGLES = 2
    SHADING = 3
    STATE = 4


class StateWords(NamedTuple):
    """Words of 4 bytes of state that each kernel reads per ray."""

    set_up: int
    traverse: int
    intersect: int
    shade: int

    @classmethod
    def of_purcell(cls) -> StateWords:
        """The words of Purcell 2002, Table 1: columns R of the multipass architecture.

        `set_up` is the first of the paper's two passes.
        """
        table = published("purcell", "table 1").values["multipass"]
        return cls(*(table[kernel]["read"] for kernel in ("set up", "step", "intersect", "color")))


@dataclass(frozen=True)
class Textures:
    """Purcell's textures in sequence (2002, section 3.1.3 and Figure 4).

    A texel of the grid is one word: the start of the cell's list. A texel of the lists is a
    triangle's number, and a non-empty list ends with a null pointer. Vertices are RGB texels in
    three textures, by triangle. Shading reads 21 words (Table 1), which the paper does not name:
    here seven RGB texels by triangle, for three normals, three colours, and one more. State is RGBA
    texels by ray, in as many textures as needed.

    Attributes
    ----------
    grid, lists : int
        Addresses of the textures, in bytes.
    corners, shading, state : tuple of int
        The same, several each.
    byte_count : int
        Of all textures, including padding.
    entries : ndarray of shape (C,), uint32
        Start of each cell's list in the texture of lists.
    """

    grid: int
    lists: int
    corners: tuple[int, ...]
    shading: tuple[int, ...]
    state: tuple[int, ...]
    byte_count: int
    entries: NDArray[np.uint32]

    @classmethod
    def of(
        cls, grid: GridStructure, ray_count: int, state_words: StateWords | None = None
    ) -> Textures:
        """Lay out a one-level grid and the state of rays.

        Parameters
        ----------
        grid : GridStructure
        ray_count : int
        state_words : StateWords, optional
            None without passes.

        Raises
        ------
        ValueError
            If the grid is too large for 32-bit entries.
        """
        splits = grid.lists.splits
        is_full = splits[1:] > splits[:-1]
        entries = np.cumsum(is_full, dtype=np.int64) - is_full + splits[:-1]
        entry_count = len(grid.lists.references) + int(np.count_nonzero(is_full))
        if entry_count >= 2**32:
            raise ValueError(f"structure: {entry_count:,} entries of lists; at most 2**32 - 1")
        texels = -(-max(state_words) * _WORD_BYTES // _RGBA_BYTES) if state_words else 0
        triangle_bytes = _RGB_BYTES * len(grid.triangles)
        sizes = [
            _WORD_BYTES * grid.lattice.cell_count,
            _WORD_BYTES * entry_count,
            *[triangle_bytes] * (_VERTEX_TEXTURES + _SHADING_TEXTURES),
            *[_RGBA_BYTES * ray_count] * texels,
        ]
        ends = np.cumsum([-(-size // ALIGNMENT) * ALIGNMENT for size in sizes]).tolist()
        begins = [0, *ends[:-1]]
        first_shading = 2 + _VERTEX_TEXTURES
        first_state = first_shading + _SHADING_TEXTURES
        return cls(
            grid=begins[0],
            lists=begins[1],
            corners=tuple(begins[2:first_shading]),
            shading=tuple(begins[first_shading:first_state]),
            state=tuple(begins[first_state:]),
            byte_count=ends[-1],
            entries=entries.astype(np.uint32),
        )
