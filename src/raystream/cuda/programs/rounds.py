"""ProgramRounds: a filter or program at the hits of rays, in rounds with more hits per ray.

In each round every open ray gets room for a number of hits, which the multi-hit kernel fills with
the nearest ones, and the program's kernel visits those that it has not seen. After each round the
host reads how many rays are still open. Hits are in a total order (t, then prim_id), so that a
larger round begins with the same hits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import Query
from raystream.cuda.launch import RayLauncher, Steps
from raystream.cuda.programs.device_program import DeviceProgram, Record
from raystream.cuda.programs.skip_prim_ids import place_skips
from raystream.cuda.programs.steps import clear_ignored, open_all, want_room
from raystream.cuda.rays import HITS_AT_ONCE, moved, split_rows
from raystream.cuda.scan import prefix_sum
from raystream.jit.constants import NULL
from raystream.jit.cuda import DeviceArray
from raystream.kernels.hits import HitAddresses
from raystream.kernels.queries import RowAddresses
from raystream.programs.hits import RaysAt, RowsAt
from raystream.programs.loop_source import Goal
from raystream.programs.rows import SkipsAt

#: Hits of each ray in the first round, and their growth from round to round.
FIRST_ROOM = 8
GROWTH = 4


class ProgramRounds(NamedTuple):
    """Rays, and the program that visits their hits.

    Attributes
    ----------
    launcher : RayLauncher
    program : DeviceProgram
    surfaces : bool
    skips : SkipsAt or None
        Triangles that each of these rays skips.
    """

    launcher: RayLauncher
    program: DeviceProgram
    surfaces: bool
    skips: SkipsAt | None

    @classmethod
    def of(
        cls, launcher: RayLauncher, query: Query, goal: Goal, record: Record | None = None
    ) -> ProgramRounds:
        """Prepare the filter or program of a query.

        Raises
        ------
        TypeError
            If it does not run on the device.
        """
        program = DeviceProgram.of(query.on_hit, goal, record)
        reason = program.reason_against(launcher.scene.gpu.capability)
        if reason is not None:
            raise TypeError(
                f"{program.name}: cannot run on the GPU, where the rays are: {reason}; "
                "copy the rays to the host to run it on the CPU"
            )
        skipped = getattr(query.on_hit, "skipped", None)
        shape, triangle_count = launcher.rays.shape, len(launcher.scene.triangles)
        skips = place_skips(launcher.scope, skipped, shape, triangle_count)
        if skips is not None:  # indexed by rays of the batch, as all that programs read
            first = moved(skips.prim_ids, -launcher.first, 4 * int(skips.width))
            skips = skips._replace(prim_ids=first)
        return cls(launcher, program, query.surfaces, skips)

    def trace(self, payload: np.uint64, record_bytes: int) -> Steps[None]:
        """Visit all hits, with the payload of these rays."""
        yield from self._rounds(self._opened(), (self._of_batch(payload, record_bytes),))

    def replace_rejected(self, nearest: HitAddresses) -> Steps[None]:
        """Replace each nearest hit that a filter rejects by the nearest one that it accepts."""
        count = len(self.launcher)
        open_rays, goal = self._opened(), (_moved_hits(nearest, -self.launcher.first),)
        rows = RowsAt(*nearest, NULL, NULL, NULL)
        self._visit(rows, slice(0, count), open_rays, goal)
        self.launcher.scope.launch(clear_ignored, count, (open_rays, nearest))
        yield from self._rounds(open_rays, goal, delivered=1)

    def count_into(self, counts: DeviceArray) -> Steps[None]:
        """Add the hits that a filter accepts to the counts of these rays, int64."""
        yield from self._rounds(self._opened(), (self._of_batch(counts.address, 8),))

    def count_kept(self, most: int) -> Steps[DeviceArray]:
        """Count the hits that a filter accepts, at most `most` of each ray; int64."""
        nowhere = HitAddresses(NULL, NULL, NULL, NULL)
        return (yield from self._keep(most, NULL, nowhere))

    def keep_rows(self, most: int, splits: DeviceArray, out: HitAddresses) -> Steps[None]:
        """Write the hits that `count_kept` counted."""
        yield from self._keep(most, self._of_batch(splits.address, 8), out)

    def _keep(self, most: int, splits: np.uint64, out: HitAddresses) -> Steps[DeviceArray]:
        found = self.launcher.scope.cleared("counts", len(self.launcher), np.int64)
        own = self._of_batch(found.address, 8)
        yield from self._rounds(self._opened(), (own, np.int64(most), splits, out))
        return found

    def _of_batch(self, address: np.uint64, byte_count: int) -> np.uint64:
        """Where the batch's first ray would have its record."""
        return moved(address, -self.launcher.first, byte_count)

    def _opened(self) -> DeviceArray:
        open_rays = self.launcher.scope.ready("open rays", len(self.launcher), np.uint8)
        self.launcher.scope.launch(open_all, len(self.launcher), (open_rays,))
        return open_rays

    def _rounds(
        self, open_rays: DeviceArray, goal: tuple[Any, ...], delivered: int = 0
    ) -> Steps[None]:
        """Visit hits until no ray is open or has more of them."""
        scope, count = self.launcher.scope, len(self.launcher)
        counts = scope.ready("counts", count, np.int64)
        # More room than was delivered: a ray that does not fill it has no more hits.
        found, latest, room = NULL, 0, max(FIRST_ROOM, delivered + 1)
        while count:
            with scope.nested() as inner:
                wanted = inner.empty("room", count, np.int64)
                rooms = np.int64(latest), np.int64(room)
                inner.launch(want_room, count, (open_rays, found, *rooms, wanted))
                splits = prefix_sum(inner, wanted)
                (total,) = yield (splits.part(count, 1),)
                if not total[0]:
                    return
                for part in (yield from _parts(splits, counts, int(total[0]))):
                    self._round(part, open_rays, goal, delivered)
            found, latest, delivered = counts.address, room, room
            room *= GROWTH

    def _round(
        self, part: _Part, open_rays: DeviceArray, goal: tuple[Any, ...], delivered: int
    ) -> None:
        """Find the hits that rays have room for, and visit them."""
        launcher, (rays, splits, counts, first_row, row_count) = self.launcher, part
        with launcher.scope.nested() as inner:
            memory = inner.ready("hits", (4, row_count), np.float32)
            hits = _moved_hits(HitAddresses.of_rows(memory.address, row_count), -first_row)
            to = RowAddresses(self.surfaces, splits.address, hits, counts.address)
            kernel = launcher.scene.kernels.multi_hit
            launcher.launch(kernel, to, rows=rays)
            rows = RowsAt(*hits, splits.address, counts.address, np.uint64(delivered))
            self._visit(rows, rays, open_rays, goal)

    def _visit(
        self, rows: RowsAt, part: slice, open_rays: DeviceArray, goal: tuple[Any, ...]
    ) -> None:
        """Run the program over the rows of some rays."""
        launcher = self.launcher
        rays = RaysAt.of(launcher.rays.source, None, launcher.first, None, part.start)
        triangles = launcher.scene.program_triangles.place()
        given = self.program.arguments(rows, rays, triangles, open_rays.address, self.skips, goal)
        launcher.scope.launch(self.program.kernel, part.stop - part.start, given)


class _Part(NamedTuple):
    """Some of the rays, and their rows."""

    rays: slice
    splits: DeviceArray
    counts: DeviceArray
    first_row: int
    row_count: int


def _parts(splits: DeviceArray, counts: DeviceArray, total: int) -> Steps[list[_Part]]:
    """Rays whose rows fit into memory together, or one that has too many."""
    count = len(counts)
    if total <= HITS_AT_ONCE:
        return [_Part(slice(0, count), splits, counts, 0, total)]
    (firsts,) = yield (splits,)
    parts = []
    for rays in split_rows(slice(0, count), count, firsts, HITS_AT_ONCE):
        first_row, row_count = int(firsts[rays.start]), int(firsts[rays.stop] - firsts[rays.start])
        if row_count:
            ray_count = rays.stop - rays.start
            own = splits.part(rays.start, ray_count + 1), counts.part(rays.start, ray_count)
            parts.append(_Part(rays, *own, first_row, row_count))
    return parts


def _moved_hits(hits: HitAddresses, count: int) -> HitAddresses:
    return HitAddresses(*(moved(address, count, 4) for address in hits))
