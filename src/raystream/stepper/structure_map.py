"""The interface that interprets a machine's records: where a ray is, and what it tests."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.leaf_block import BLOCK_BYTES, BLOCK_SIZE
from raystream.structures import Structure


class LocalSpot(NamedTuple):
    """A cell, node or sector, and the ray's interval in it in local direction lengths."""

    number: int
    t_in: float
    t_out: float


class Records(NamedTuple):
    """A machine's records of one ray between two passes; see `machines.PassSnapshot`.

    Attributes
    ----------
    ray, place : void
        Its records in the streams of these names.
    t_far : float
        Distance beyond which hits are ignored, in local direction lengths.
    memory : ndarray of shape (B,), uint8
        Its stack memory.
    """

    ray: Any
    place: Any
    t_far: float
    memory: NDArray[np.uint8]


class StructureMap(ABC):
    """Interprets a ray's records for one structure."""

    @abstractmethod
    def box(self, number: int) -> NDArray[np.float64]:
        """Low and high corner of a cell, node or sector: shape (2, 3), float64, world space."""

    @abstractmethod
    def kind(self, number: int) -> str:
        """``"cell"``, ``"split"``, ``"node"``, ``"leaf"`` or ``"sector"``."""

    @abstractmethod
    def spot(self, records: Records) -> LocalSpot | None:
        """The position of a ray; None if it has nothing left to search."""

    @abstractmethod
    def tested(self, place: Any, count: int) -> tuple[int, ...]:
        """The prim_ids of the next `count` triangles that a ray tests."""

    def stack(self, records: Records) -> tuple[LocalSpot, ...]:
        """The ray's stack, next entry first."""
        del records
        return ()

    def way(self, origin: int, target: int, direction: NDArray[np.float64]) -> str | None:
        """The face through which a ray moved from one place to another; None if not applicable."""
        del origin, target, direction
        return None


def to_world(structure: Structure, local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform positions from a structure's local frame to world space."""
    triangles = structure.triangles
    return local / triangles.scale + triangles.center


class BlockMap(StructureMap):
    """A map of a structure that lists triangles in blocks of four."""

    _block_rows: NDArray[np.int32]
    _blocks: NDArray[np.float32]

    def tested(self, place: Any, count: int) -> tuple[int, ...]:
        """See `StructureMap.tested`."""
        row = (int(place["block"]) - self._blocks.ctypes.data) // BLOCK_BYTES
        last = row + -(-count // BLOCK_SIZE)
        return tuple(self._block_rows[row:last].ravel()[:count].tolist())
