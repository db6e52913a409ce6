"""Search: a program at the hits of rays on the device, in rounds with more and more room.

Each ray that a program has not ended gets room for some hits, which the query for many hits fills
with its nearest, and the program's kernel looks at those that it has not seen. The host learns
after each round how many rays go on. Hits are in a total order (t, then prim_id), so that a ray
which is asked again gives the same ones first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from raystream.cuda.device_rays import DeviceRays
from raystream.cuda.parts import parts_of
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.steps import CLEAR_IGNORED, OPEN, WANT
from raystream.cuda.query_inputs import QueryInputs
from raystream.cuda.scan import add_up
from raystream.cuda.tables import with_tables
from raystream.cuda.threads import SeenTables
from raystream.jit.cuda import DeviceArray, StreamScope
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray_source import ResultAddresses
from raystream.programs.hits import RaysAt, RowsAt, SceneAt
from raystream.programs.rows import SkipsAt

if TYPE_CHECKING:
    from raystream.cuda.device_queries import DeviceScene

__all__ = ["Search", "moved"]

#: Hits for which a ray has room at first, and by how much that grows.
FIRST_ROOM = 8
GROWTH = 4

#: Hits of a part of the rays; a ray with more is looked at by itself.
ROWS_AT_ONCE = 1 << 22

_NOWHERE = np.uint64(0)


class _Part(NamedTuple):
    """Some of the rays, and their rows."""

    rays: slice
    first_row: int
    end_row: int

    @property
    def ray_count(self) -> int:
        count: int = self.rays.stop - self.rays.start
        return count


class Search(NamedTuple):
    """Rays and the program that looks at their hits.

    Attributes
    ----------
    inputs : QueryInputs
        The rays, and what their kernels are given.
    triangles : SceneAt
    first : int
        Index of the first ray in the batch.
    program : DeviceProgram
    surfaces : bool
    skips : SkipsAt or None
        Of these rays.
    """

    inputs: QueryInputs
    triangles: SceneAt
    first: int
    program: DeviceProgram
    surfaces: bool = False
    skips: SkipsAt | None = None

    @property
    def work(self) -> StreamScope:
        """What keeps the memory of the whole search."""
        return self.inputs.work

    @property
    def scene(self) -> DeviceScene:
        """What is searched."""
        return self.inputs.scene

    @property
    def rays(self) -> DeviceRays:
        """Whose hits are looked at."""
        return self.inputs.rays

    def trace(self, payload: np.uint64, record_bytes: int) -> None:
        """Give all hits to the program, with the records of these rays."""
        self._rounds(self._opened(), (moved(payload, -self.first, record_bytes),))

    def nearest(self, out: HitAddresses, status: np.uint64) -> None:
        """Write the nearest hits that exist, and what is wrong with rays."""
        scene = self.scene
        to = ResultAddresses(*out, _NOWHERE, status)
        shared = self.inputs.shared(0, len(self.rays))
        self.work.launch(scene.kernels.first_hit, len(self.rays), (*shared, to))
        open_rays, goal = self._opened(), (_moved_hits(out, -self.first),)
        rows = RowsAt(*out, _NOWHERE, _NOWHERE, _NOWHERE)
        self._look(rows, slice(0, len(self.rays)), open_rays, goal)
        self.work.launch(CLEAR_IGNORED, len(self.rays), (open_rays.address, out))
        self._rounds(open_rays, goal, delivered=1)

    def count_into(self, counts: DeviceArray) -> None:
        """Add the hits that exist to the counts of these rays, int64."""
        self._rounds(self._opened(), (moved(counts.address, -self.first, 8),))

    def keep_splits(self, most: int) -> tuple[DeviceArray, int]:
        """Where the rows of these rays begin, up to `most` hits of each that exist.

        Returns
        -------
        splits : DeviceArray of shape (N + 1,), int64
        row_count : int
        """
        splits = self.work.empty("splits", len(self.rays) + 1, np.int64)
        found = self._keep(most, _NOWHERE, HitAddresses(_NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE))
        add_up(self.work, found, splits)
        return splits, int(self.work.read(splits.part(len(self.rays), 1))[0])

    def keep_rows(self, most: int, splits: DeviceArray, out: HitAddresses) -> None:
        """Write the hits for which `keep_splits` has said that there is room."""
        self._keep(most, moved(splits.address, -self.first, 8), out)

    def _keep(self, most: int, splits: np.uint64, out: HitAddresses) -> DeviceArray:
        found = self.work.cleared("counts", len(self.rays), np.int64)
        own = moved(found.address, -self.first, 8)
        self._rounds(self._opened(), (own, np.int64(most), splits, out))
        return found

    def _opened(self) -> DeviceArray:
        open_rays = self.work.empty("rays that go on", len(self.rays), np.uint8)
        self.work.launch(OPEN, len(self.rays), (open_rays.address,))
        return open_rays

    def _rounds(self, open_rays: DeviceArray, goal: tuple[Any, ...], delivered: int = 0) -> None:
        """Give hits to the program until no ray is open, or has more."""
        work, count = self.work, len(self.rays)
        wanted = work.empty("room", count, np.int64)
        splits = work.empty("splits", count + 1, np.int64)
        counts = work.empty("counts", count, np.int64)
        # There has to be room for more than was seen: who finds no more ends.
        found, latest, room = _NOWHERE, 0, max(FIRST_ROOM, delivered + 1)
        while count:
            asked = open_rays.address, found, np.int64(latest), np.int64(room), wanted.address
            work.launch(WANT, count, asked)
            with StreamScope(work.gpu, work.stream) as own:
                add_up(own, wanted, splits)
            total = int(work.read(splits.part(count, 1))[0])
            if total == 0:
                return
            for part in self._parts(splits, total):
                self._round(part, splits, counts, open_rays, goal, delivered)
            found, latest, delivered = counts.address, room, room
            room *= GROWTH

    def _parts(self, splits: DeviceArray, total: int) -> list[_Part]:
        """Rays whose rows fit into memory together, or one that has too many."""
        whole = slice(0, len(self.rays))
        if total <= ROWS_AT_ONCE:
            return [_Part(whole, 0, total)]
        firsts = self.work.read(splits)
        cuts = parts_of(whole, len(self.rays), firsts, ROWS_AT_ONCE)
        made = [_Part(one, int(firsts[one.start]), int(firsts[one.stop])) for one in cuts]
        return [one for one in made if one.first_row != one.end_row]

    def _round(
        self,
        part: _Part,
        splits: DeviceArray,
        counts: DeviceArray,
        open_rays: DeviceArray,
        goal: tuple[Any, ...],
        delivered: int,
    ) -> None:
        """Fill the room that rays have, and look at it."""
        scene, start = self.scene, part.rays.start
        own = splits.part(start, part.ray_count + 1), counts.part(start, part.ray_count)
        row_count = part.end_row - part.first_row
        with StreamScope(self.work.gpu, self.work.stream) as work:
            memory = work.empty("hits", (4, row_count), np.float32)
            hits = _moved_hits(HitAddresses.of_rows(memory.address, row_count), -part.first_row)

            def run(tables: SeenTables, first: int, count: int) -> None:
                rays = self.inputs.shared(start + first, count)
                places = [moved(one.address, first, 8) for one in own]
                more = tables, bool(self.surfaces), places[0], hits, places[1]
                work.launch(scene.kernels.multi_hit, count, (*rays, *more))

            with_tables(work, scene.has_duplicates, own[1], run)
            begin, found = (one.address for one in own)
            rows = RowsAt(*hits, begin, found, np.uint64(delivered))
            self._look(rows, part.rays, open_rays, goal)

    def _look(
        self, rows: RowsAt, part: slice, open_rays: DeviceArray, goal: tuple[Any, ...]
    ) -> None:
        """Run the program over the rows of some rays."""
        program = self.program
        rays = RaysAt.of(self.rays.source, None, self.first, None, part.start)
        skips = self.skips
        if skips is not None:
            begin = moved(skips.prim_ids, -self.first, 4 * int(skips.width))
            skips = skips._replace(prim_ids=begin)
        given = program.arguments(rows, rays, self.triangles, open_rays.address, skips, goal)
        self.work.launch(program.kernel, part.stop - part.start, given)


def moved(address: np.uint64, count: int, byte_count: int) -> np.uint64:
    """An address so many records further on, or back."""
    return np.uint64((int(address) + count * byte_count) % 2**64)


def _moved_hits(hits: HitAddresses, count: int) -> HitAddresses:
    return HitAddresses(*(moved(address, count, 4) for address in hits))
