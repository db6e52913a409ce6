"""The thickness query: traces blocks of rays and pairs their crossings."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamWarning
from raystream.core.hits import MultiHits
from raystream.core.rays import RayBatch
from raystream.core.scene_kinds import check_support
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for, part_of
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.kernels.solids import Solids, solids_of
from raystream.machines.winding import inside_by_winding
from raystream.physics.hit_crossings import classify_hits, solids_with
from raystream.physics.library_results import LibraryThickness, in_library_of
from raystream.physics.nesting import displaced, overlap_text, ranks_of
from raystream.physics.pairing import (
    NO_ROW,
    Crossings,
    Limits,
    MeshScratch,
    Pairs,
    classify_crossings,
    pair_crossings,
)
from raystream.physics.placed_crossings import PlacedSolids, classify_placed_crossings
from raystream.physics.thickness import Segments, Thickness, Unpaired, direction_lengths
from raystream.programs.cutouts import cutouts_of
from raystream.tracer import Tracer

#: Rays of the first block, and at most of any.
_RAYS_PER_BLOCK = 1 << 18

#: Target number of crossings of a block: about 60 bytes each while it is processed.
_CROSSINGS_PER_BLOCK = 1 << 22

#: Rays per call of a kernel: about a millisecond.
_CHUNK = 1 << 13


class Rules(NamedTuple):
    """How crossings become segments: the arguments of `thickness`.

    Parameters
    ----------
    clips : bool
        Whether segments that begin before an interval, or end behind it, are clipped.
    displaces : bool
        Whether inner meshes displace those around them.
    cutouts : bool
        Whether rays pass where meshes that are not closed are cut out.
    """

    clips: bool = False
    displaces: bool = False
    cutouts: bool = False


class _Tracing(TypedDict, total=False):
    """Options of how rays are traced."""

    cutouts: bool
    worlds: Any
    progress: Progress | None


def thickness(
    tracer: Tracer,
    origins: Any,
    directions: Any,
    *,
    t_min: Any = 0.0,
    t_max: Any = np.inf,
    ends: Literal["report", "clip"] = "report",
    nested: Literal["both", "inner"] = "both",
    **tracing: Unpack[_Tracing],
) -> Thickness:
    """Find where rays enter and leave closed meshes.

    Parameters
    ----------
    tracer : Tracer
    origins, directions, t_min, t_max
        As in `Tracer.first_hit`.
    ends : {"report", "clip"}
        How to treat a segment that contains t_min or t_max: report its other end as unpaired, or
        clip it to the interval, if the mesh is closed. To clip, rays are traced to their last
        crossing, so that a ray that starts inside is recognised even if its interval ends before
        any surface.
    nested : {"both", "inner"}
        Where meshes overlap, as a pipe in concrete does that has no hole for it: give each of
        them its whole segment, with a `RaystreamWarning` that names some of the meshes; or let
        the inner one displace the others, so that segments do not overlap.
    **tracing
        ``cutouts`` (bool): whether rays pass where the surface of a mesh that is not closed is cut
        out: where the opacity of its material is below its ``alpha_cutoff``, or below a half
        without one [default: True]. A closed mesh is a solid, whatever its surface shows: its
        cut-outs always count as surface. A ray through a hole in its skin would be left with an
        exit or an entry. ``worlds`` (array_like that broadcasts to S, int): as in
        `Tracer.first_hit`. ``progress`` (callable): called with (rays done, rays).

    Returns
    -------
    Thickness
        `LibraryThickness` for rays in arrays of PyTorch, JAX, CuPy or xarray.

    Raises
    ------
    ValueError, TypeError
        As `Tracer.first_hit`, or if `ends` or `nested` is unknown, or if there are cut-outs, and
        the tracer counts.
    MemoryError
        If there is not enough memory for the crossings of a block.

    Notes
    -----
    Crossings are those of ``multi_hit(crossings="surfaces")``. A ray *enters* where it meets
    the front of a triangle (its vertices counter-clockwise) and *exits* at a back. Each
    mesh's crossings are matched like brackets: an exit closes the latest entry that is still
    open. A segment is an outermost pair, so nested or overlapping parts of one mesh count as
    their union, and a part that faces inward is a cavity. Unpaired crossings are
    reported. At equal t entries come first: parts that touch make one segment.

    With ``nested="inner"``, a point in several meshes belongs to the one of the smallest volume,
    which for a mesh within another is the inner one; of equal volumes, to the later mesh or
    instance. Closed meshes displace open ones. A segment that another one divides becomes several,
    of the same mesh and material, whose `entry_prim_id` or `exit_prim_id` is that triangle of the
    other mesh where they begin or end.

    A mesh that is closed and has a negative volume faces inward: its sides are swapped, and
    `Thickness.mesh_is_flipped` says so.

    A ray from outside leaves a closed mesh as often as it enters it, even through edges and
    vertices. Where it grazes a silhouette within rounding errors, the exit may come before the
    entry. Without a t_max this case is recognised and gives a segment of length 0; with one, both
    crossings are reported as unpaired. So may those of a ray that passes, within rounding errors,
    a triangle without area in a mesh that is closed by such triangles only.

    Examples
    --------
    >>> import raystream as rs
    >>> scene = rs.load("cornell")
    >>> found = rs.thickness(rs.Tracer(scene), [200.0, 100.0, -800.0], [0.0, 0.0, 1.0])
    >>> [scene.meshes[mesh_id].name for mesh_id in found.mesh_id]
    ['short block']
    >>> round(found.total_length().item(), 1)
    173.7
    """
    cutouts, worlds, progress = _tracing(**tracing)
    if ends not in ("report", "clip"):
        raise ValueError(f"ends: expected 'report' or 'clip', got {ends!r}")
    if nested not in ("both", "inner"):
        raise ValueError(f"nested: expected 'both' or 'inner', got {nested!r}")
    check_support("thickness", tracer.structure.triangles)
    batch = tracer.structure.ray_batch(origins, directions, t_min, t_max)
    batch.worlds = tracer._world_ids(worlds, batch.shape)
    rules = Rules(ends == "clip", nested == "inner", cutouts)
    found, overlaps = find_segments(tracer, batch, rules, progress)
    if overlaps and nested == "both":
        text = overlap_text(overlaps, found.mesh_names)
        warnings.warn(text, RaystreamWarning, stacklevel=2)
    return in_library_of(origins, directions, found, LibraryThickness)


def _tracing(
    *, cutouts: bool = True, worlds: Any = None, progress: Progress | None = None
) -> tuple[bool, Any, Progress | None]:
    """The options of `_Tracing`; TypeError for others."""
    return cutouts, worlds, progress


def find_segments(
    tracer: Tracer, batch: RayBatch, rules: Rules, progress: Progress | None = None
) -> tuple[Thickness, set[tuple[int, int]]]:
    """The segments of `thickness`, and the pairs of meshes that overlap on some ray."""
    worker = _Worker(tracer, batch, rules)
    splits = np.zeros(len(batch) + 1, np.int64)
    status = np.zeros(len(batch), np.uint8)
    parts = []
    for rows, hits in worker.blocks(progress):
        status[rows] = hits.status
        counts, segments, unpaired = worker.pair(rows, hits)
        splits[rows.start + 1 : rows.stop + 1] = counts
        parts.append((segments, unpaired))
    found = Thickness(
        np.cumsum(splits),
        Segments(*(np.concatenate(column) for column in zip(*(p[0] for p in parts), strict=True))),
        Unpaired(*(np.concatenate(column) for column in zip(*(p[1] for p in parts), strict=True))),
        status.reshape(batch.shape),
        worker.solids,
        (
            [tracer.scene.mesh_name(k) for k in range(len(worker.solids.is_closed))],
            [material.name for material in tracer.scene.materials],
        ),
    )
    return found, worker.overlaps


class _Worker:
    """A tracer and a batch, processed in blocks of rays.

    Attributes
    ----------
    solids : Solids
    overlaps : set of (int, int)
        Pairs of meshes that overlap on some ray.
    """

    def __init__(self, tracer: Tracer, batch: RayBatch, rules: Rules) -> None:
        self._tracer, self._batch, self._rules = tracer, batch, rules
        self.overlaps: set[tuple[int, int]] = set()
        structure: Any = tracer.structure
        self._triangles: Any = structure.triangles
        #: The triangles of meshes as solids: where a mesh is looked at alone.
        self._meshes: Any = self._triangles
        is_placed = self._triangles.instances is not None
        placed = PlacedSolids.of(structure) if is_placed else None
        self._placed = placed
        self._frame = SceneFrame.of(self._triangles)
        self.solids: Solids
        if placed is not None:
            self.solids = placed.solids
        elif self._triangles.has_primitives:
            self._meshes = self._triangles.triangles
            self.solids = solids_with(self._triangles)
        else:
            self._meshes = self._triangles.solid_parts()[0].triangles
            self.solids = solids_of(self._meshes)
        opacity = cutouts_of(tracer, rules.cutouts, self.solids.is_closed)
        self._on_hit = opacity and opacity.on_hit

    def blocks(self, progress: Progress | None) -> Iterator[tuple[slice, MultiHits]]:
        """Crossings block by block; at least one block, even if without rays."""
        total = len(self._batch)
        first, size = 0, _RAYS_PER_BLOCK
        while first < total or first == 0:
            rows = slice(first, min(first + size, total))
            count = rows.stop - rows.start
            hits = self._tracer.multi_hit(
                self._batch.origins[rows],
                self._batch.directions[rows],
                t_min=self._batch.t_min[rows],
                t_max=np.inf if self._rules.clips else self._batch.t_max[rows],
                crossings="surfaces",
                on_hit=self._on_hit,
                worlds=None if self._batch.worlds is None else self._batch.worlds[rows],
                progress=part_of(progress, rows.start, rows.stop - rows.start, total),
            )
            yield rows, hits
            first = max(rows.stop, 1)
            mean = len(hits.t) / max(count, 1)
            size = max(1024, min(_RAYS_PER_BLOCK, int(_CROSSINGS_PER_BLOCK / max(mean, 1.0))))
        if progress:
            progress(total, total)

    def pair(self, rows: slice, hits: MultiHits) -> tuple[NDArray[np.int64], Segments, Unpaired]:
        """Number of segments per ray, segments and unpaired crossings of a block."""
        count = rows.stop - rows.start
        crossings = Crossings.of(hits.ray_splits, hits.t, hits.prim_id)
        pairs = Pairs.empty(count, len(hits.t))
        t_min, t_max = self._batch.t_min[rows], self._batch.t_max[rows]
        traced_to = np.broadcast_to(t_max.dtype.type(np.inf), count) if self._rules.clips else t_max
        origins, directions = self._batch.origins[rows], self._batch.directions[rows]
        source, kept = RaySource.of(origins, directions, (t_min, traced_to))
        classify, is_closed = self._classifier(rows, source, hits, crossings)
        t_min, t_max = np.ascontiguousarray(t_min), np.ascontiguousarray(t_max)
        limits = Limits(t_min, t_max, self._rules.clips, np.isinf(traced_to))

        def body(begin: int, end: int) -> None:
            classify(begin, end)
            scratch = MeshScratch.zeros(len(is_closed))
            pair_crossings(begin, end, crossings, limits, is_closed, scratch, pairs)

        parallel_for(body, count, _CHUNK)
        del kept
        if self._rules.clips and self.solids.has_slivers.any():
            self._check_beginnings(rows, crossings, pairs)
        counts, segments = pairs.counts, self._segments(rows, crossings, pairs, t_min, t_max)
        if pairs.overlaps.any():
            self._note_overlaps(crossings, pairs)
            if self._rules.displaces:
                lengths = direction_lengths(self._batch, rows)
                solid_ids = crossings.mesh_id[pairs.exits[_used(crossings.splits, counts)[0]]]
                ranks = self._ranks[solid_ids]
                counts, segments = displaced(segments, counts, ranks, pairs.overlaps, lengths)
        return counts, segments, self._unpaired(rows, crossings, pairs)

    @cached_property
    def _ranks(self) -> NDArray[np.int64]:
        return ranks_of((self._placed or self.solids).volumes)

    def _check_beginnings(self, rows: slice, crossings: Crossings, pairs: Pairs) -> None:
        """Report as unpaired an exit that only seems to follow a beginning inside.

        A ray from outside may slip through a mesh beside a triangle without area, which is rare.
        """
        used, ray = _used(crossings.splits, pairs.counts)
        solid_id = crossings.mesh_id[pairs.exits[used]]
        mesh_id, _ = self._mesh_and_instance(solid_id)
        doubtful = (pairs.entries[used] == NO_ROW) & self.solids.has_slivers[mesh_id]
        for solid in np.unique(solid_id[doubtful]):
            some = np.flatnonzero(doubtful & (solid_id == solid))
            i = rows.start + ray[some]
            starts = self._batch.t_min[i, None] * self._batch.directions[i].astype(np.float64)
            starts += self._batch.origins[i]
            if self._placed is None:
                is_inside = inside_by_winding(_part(self._meshes, solid), starts)
            else:
                triangles, mesh, starts = self._placed.in_object(solid, starts)
                is_inside = inside_by_winding(_part(triangles, mesh), starts)
            for k in some[~is_inside][::-1]:  # from the last: later rows move
                _unpair(ray[k], used[k], crossings, pairs)

    def _note_overlaps(self, crossings: Crossings, pairs: Pairs) -> None:
        """Add to `overlaps`."""
        used, _ = _used(crossings.splits, np.where(pairs.overlaps == 2, pairs.counts, 0))
        used = used[pairs.beneath[used] != NO_ROW]
        one, other = (crossings.mesh_id[pairs.exits[k]] for k in (used, pairs.beneath[used]))
        # Pairs as numbers, which are sorted faster than rows.
        count = int(max(one.max(initial=0), other.max(initial=0))) + 1
        codes = np.unique(np.minimum(one, other) * np.int64(count) + np.maximum(one, other))
        low, high = (
            self._mesh_and_instance(solid_id.astype(np.int32))[0].tolist()
            for solid_id in np.divmod(codes, count)
        )
        self.overlaps.update((min(pair), max(pair)) for pair in zip(low, high, strict=True))

    def _classifier(
        self, rows: slice, source: RaySource, hits: MultiHits, crossings: Crossings
    ) -> tuple[Callable[[int, int], None], NDArray[np.bool_]]:
        """A function that classifies the crossings of some rays; and whether solids are closed.

        Solids are meshes; with instances, the meshes of each.
        """
        is_flipped = self.solids.is_flipped
        placed = self._placed
        if self._triangles.kinds not in ((), ("instances",)):
            classify_hits(self._batch, rows, hits, is_flipped, crossings)
            if placed is None:
                return lambda _begin, _end: None, self.solids.is_closed
            crossings.mesh_id[:] = placed.solids_at(hits.prim_id, hits.instance_id)
            return lambda _begin, _end: None, placed.is_closed
        if placed is None:
            triangles = self._triangles
            shared = source, self._frame, triangles.corners, triangles.mesh_splits, is_flipped
            return (
                lambda begin, end: classify_crossings(begin, end, *shared, crossings),
                self.solids.is_closed,
            )
        crossings.mesh_id[:] = placed.solids_at(hits.prim_id, hits.instance_id)
        columns = hits.instance_id, hits.mesh_id
        return (
            lambda begin, end: classify_placed_crossings(
                begin, end, source, placed.records, columns, placed.corners, is_flipped, crossings
            ),
            placed.is_closed,
        )

    def _mesh_and_instance(
        self, solid_id: NDArray[np.int32]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        if self._placed is None:
            return solid_id, np.zeros(len(solid_id), np.int32)
        return self._placed.split(solid_id)

    def _segments(
        self,
        rows: slice,
        crossings: Crossings,
        pairs: Pairs,
        t_min: NDArray[np.floating[Any]],
        t_max: NDArray[np.floating[Any]],
    ) -> Segments:
        used, ray = _used(crossings.splits, pairs.counts)
        entry, exit_ = pairs.entries[used], pairs.exits[used]
        t_exit = crossings.t[exit_]
        t_entry = np.minimum(crossings.t[entry], t_exit)  # swapped grazes
        entry_prim_id, exit_prim_id = crossings.prim_id[entry], crossings.prim_id[exit_]
        is_inside = entry == NO_ROW
        known = np.where(is_inside, exit_prim_id, entry_prim_id)
        if self._rules.clips:
            t_entry = np.where(is_inside, t_min[ray], t_entry)
            entry_prim_id = np.where(is_inside, np.int32(-1), entry_prim_id)
            exit_prim_id = np.where(t_exit > t_max[ray], np.int32(-1), exit_prim_id)
            t_exit = np.minimum(t_exit, t_max[ray])
        length = t_exit.astype(np.float64) - t_entry
        mesh_id, instance_id = self._mesh_and_instance(crossings.mesh_id[exit_])
        return Segments(
            t_entry,
            t_exit,
            length * direction_lengths(self._batch, rows)[ray],
            mesh_id,
            self._triangles.materials_at(known),
            entry_prim_id,
            exit_prim_id,
            instance_id,
        )

    def _unpaired(self, rows: slice, crossings: Crossings, pairs: Pairs) -> Unpaired:
        used, ray = _used(crossings.splits, pairs.unpaired_counts)
        unpaired = pairs.unpaired[used]
        mesh_id, instance_id = self._mesh_and_instance(crossings.mesh_id[unpaired])
        return Unpaired(
            ray + rows.start,
            crossings.t[unpaired],
            crossings.prim_id[unpaired],
            mesh_id,
            crossings.kind[unpaired] & np.uint8(1),
            instance_id,
        )


def _part(triangles: Triangles, mesh: int) -> Triangles:
    """One mesh of several."""
    first, last = triangles.mesh_splits[mesh : mesh + 2]
    splits = np.array([0, last - first])
    corners = triangles.corners[first:last]
    return Triangles.from_local(corners, splits, triangles.center, triangles.scale)


def _unpair(ray: int, place: int, crossings: Crossings, pairs: Pairs) -> None:
    """Make the exit of a segment unpaired."""
    first, last = crossings.splits[ray], crossings.splits[ray] + pairs.counts[ray]
    unpaired = pairs.unpaired[first : first + pairs.unpaired_counts[ray] + 1]
    unpaired[-1] = pairs.exits[place]
    unpaired.sort()
    for column in (pairs.entries, pairs.exits):
        column[place : last - 1] = column[place + 1 : last].copy()
    pairs.beneath[first:last] = NO_ROW
    pairs.counts[ray] -= 1
    pairs.unpaired_counts[ray] += 1


def _used(
    splits: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the first counts[i] rows of each ray i, and their rays."""
    ray = np.repeat(np.arange(len(counts)), counts)
    begin = np.cumsum(counts) - counts
    return splits[ray] + np.arange(len(ray)) - begin[ray], ray
