"""Memory references of recorded walks through a grid, as input for cache simulators."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.machines.records import RayState
from raystream.structures.grid.structure import GridStructure
from raystream_lab.walks.kernels.emit_references import (
    DONE,
    NOTHING,
    SHADE,
    STEP,
    STEP_ROOM,
    TEST,
    FetchTables,
    OutAddresses,
    PassPlan,
    RayProgress,
    begin_rays,
    fetch_branching,
    fetch_multipass,
)
from raystream_lab.walks.ray_orders import ray_order
from raystream_lab.walks.replaying import Replay
from raystream_lab.walks.texture_layout import Kind, StateWords, Textures
from raystream_lab.walks.walks import Walks

__all__ = [
    "CHUNK",
    "Kind",
    "ReferenceChunk",
    "StateWords",
    "branching_references",
    "multipass_references",
]

#: References per chunk of 10 MB: with 40 MB, the system clears new pages for each chunk, which took
#: a tenth of a simulator's time.
CHUNK = 1 << 20

_ROLES = {RayState.TRAVERSING: STEP, RayState.INTERSECTING: TEST, RayState.SHADING: SHADE}
_NOT_BEGUN = np.uint64(2**64 - 1)


class ReferenceChunk(NamedTuple):
    """Consecutive references of a trace.

    Attributes
    ----------
    addresses : ndarray of shape (R,), uint64
        Address of the first byte of each texel.
    kinds : ndarray of shape (R,), uint8
        The `Kind` of each.
    words : ndarray of shape (R,), uint8
        Words of 4 bytes read from there.
    """

    addresses: NDArray[np.uint64]
    kinds: NDArray[np.uint8]
    words: NDArray[np.uint8]

    @classmethod
    def empty(cls, count: int) -> ReferenceChunk:
        """Allocate a chunk."""
        return cls(np.empty(count, np.uint64), np.empty(count, np.uint8), np.empty(count, np.uint8))

    def part(self, count: int) -> ReferenceChunk:
        """The first `count` references."""
        return ReferenceChunk(self.addresses[:count], self.kinds[:count], self.words[:count])


def branching_references(
    walks: Walks, *, order: str | Any = "rows", chunk: int = CHUNK
) -> Iterator[ReferenceChunk]:
    """The reads of a machine with branches: all of a ray, then all of the next.

    Parameters
    ----------
    walks : Walks
        Through a one-level grid, recorded with visits.
    order : {"rows", "tiles", "morton"} or array_like of int
        Tracing order of the rays; see `ray_order`.
    chunk : int
        Maximum references per chunk.

    Returns
    -------
    iterator of ReferenceChunk

    Raises
    ------
    ValueError
        If the walks or the order are unsuitable.

    Notes
    -----
    A step reads a cell. A test reads an entry of the cell's list, and three vertices: 10 words, as
    in Table 1 of Purcell 2002; the null pointer that ends a list is not read. Shading a first hit
    reads 21 words, an any hit none. `Textures` gives the addresses.
    """
    grid = grid_of(walks)
    rays = ray_order(order, walks.shape)
    tables = _tables(walks, grid, Textures.of(grid, len(walks)))
    cursor = np.array([0, _NOT_BEGUN, 0, 0], np.uint64)

    def fill(out: OutAddresses, room: int) -> int:
        return fetch_branching(rays, tables.addresses, cursor, out, room)

    return _chunks(fill, max(chunk, STEP_ROOM))


def multipass_references(
    walks: Walks,
    schedule: Replay,
    *,
    order: str | Any = "rows",
    chunk: int = CHUNK,
    state_words: StateWords | None = None,
) -> Iterator[ReferenceChunk]:
    """The reads of a machine without branches: in each pass, of every ray that it runs on.

    Parameters
    ----------
    walks, order, chunk
        See `branching_references`.
    schedule : Replay
        A schedule of the same walks.
    state_words : StateWords, optional
        Words of state that each kernel reads per ray [default: Purcell's].

    Returns
    -------
    iterator of ReferenceChunk
        For each ray of a pass, first its state, then the reads of its steps.

    Raises
    ------
    ValueError
        If the walks, the schedule or the order do not match.

    Notes
    -----
    Each pass that runs on a ray reads its state from the first textures of `Textures.state`, four
    words per texel. The stencil buffer and the writes of passes are not among the references.
    """
    grid = grid_of(walks)
    if schedule.names != walks.names or schedule.ray_count != len(walks):
        raise ValueError("schedule: belongs to other walks")
    given = StateWords.of_purcell() if state_words is None else state_words
    words = np.array(_in_order(walks, given), np.uint8)
    rays = ray_order(order, walks.shape)
    check_memory(21 * len(walks), f"places of {len(walks):,} rays would", "record fewer rays")
    tables = _tables(walks, grid, Textures.of(grid, len(walks), given))
    at_once = np.minimum(schedule.at_once, np.maximum(walks.most_runs, 1)).astype(np.uint32)
    places = RayProgress(*(np.empty(len(walks), one) for one in ("u1", "u8", "u4", "u8")))
    begin_rays(tables.addresses, places)
    cursor = np.zeros(3, np.uint64)
    plan = PassPlan(schedule.kernels, schedule.run_counts, at_once, words)

    def fill(out: OutAddresses, room: int) -> int:
        count = fetch_multipass(rays, tables.addresses, plan, places, cursor, out, room)
        if count < 0 or (count == 0 and (places.kernels != DONE).any()):
            raise ValueError("schedule: belongs to other walks")
        return count

    return _chunks(fill, max(chunk, STEP_ROOM * (int(at_once.max()) + 1)))


def _chunks(fill: Callable[[OutAddresses, int], int], room: int) -> Iterator[ReferenceChunk]:
    """Yield chunks until there are no more references."""
    while True:
        chunk = ReferenceChunk.empty(room)
        count = fill(OutAddresses(*(_address(array) for array in chunk)), room)
        if count == 0:
            break
        yield chunk.part(count)


def grid_of(walks: Walks) -> GridStructure:
    """The grid of walks with visits; ValueError for others."""
    if not isinstance(walks.structure, GridStructure):
        raise ValueError(f"walks: expected walks through a grid, got {walks.structure.name}")
    if len(walks.structure.fine.cells):
        raise ValueError("walks: expected a grid of one level; build it with levels=1")
    if walks.visits is None:
        raise ValueError("walks: expected visits; record with visits=True")
    return walks.structure


def roles_of(walks: Walks) -> NDArray[np.uint8]:
    """The role of each kernel; see `kernels.emit_references`."""
    return np.array([_ROLES.get(one.state, NOTHING) for one in walks.kernels], np.uint8)


def _in_order(walks: Walks, words: StateWords) -> list[int]:
    """Words of state by kernel index."""
    by_state = {
        RayState.STARTING: words.set_up,
        RayState.TRAVERSING: words.traverse,
        RayState.INTERSECTING: words.intersect,
        RayState.SHADING: words.shade,
    }
    chosen = [by_state[one.state] for one in walks.kernels]
    if not all(0 <= count <= 4 * (STEP_ROOM - 1) for count in chosen):
        raise ValueError(f"state_words: expected 0 to {4 * (STEP_ROOM - 1)} words, got {words}")
    return chosen


class _Tables(NamedTuple):
    """Addresses, and the arrays that must stay alive."""

    addresses: FetchTables
    arrays: tuple[NDArray[Any] | None, ...]


def _tables(walks: Walks, grid: GridStructure, layout: Textures) -> _Tables:
    arrays = (
        *(walks.run_splits, walks.run_kernels, walks.run_lengths),
        *(walks.visit_splits, walks.visits, walks.prim_ids),
        *(grid.lists.splits, grid.lists.references, layout.entries, roles_of(walks)),
    )
    places = [layout.grid, layout.lists]
    for begins in (layout.corners, layout.shading, layout.state):
        places += _first_and_pitch(begins)
    addresses = FetchTables(*(_address(array) for array in arrays), *map(np.uint64, places))
    return _Tables(addresses, arrays)


def _first_and_pitch(begins: tuple[int, ...]) -> list[int]:
    """The address of the first of several equal textures, and the distance to the next."""
    if not begins:
        return [0, 0]
    return [begins[0], begins[1] - begins[0] if len(begins) > 1 else 0]


def _address(array: NDArray[Any] | None) -> np.uint64:
    return np.uint64(0 if array is None else array.ctypes.data)
