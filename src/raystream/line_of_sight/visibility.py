"""Which points see which: a matrix of lines of sight."""

from __future__ import annotations

import hashlib
import operator
from os import PathLike
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream._version import __version__
from raystream.core.libraries import library_of
from raystream.core.memory import available_memory
from raystream.core.scene_kinds import check_support
from raystream.jit.threads import Progress
from raystream.line_of_sight.end_points import (
    EndPoints,
    check_tracer,
    end_points,
    is_clear,
)
from raystream.line_of_sight.resumable_array import resumable_array
from raystream.line_of_sight.resumable_store import StoredArray, open_stored, resumable_store
from raystream.line_of_sight.sparse_rows import (
    SparseVisibility,
    band_tiles,
    stored_rows,
    write_rows,
)
from raystream.line_of_sight.tiles import LEAST_TILE, MOST_TILE, Tile, Tiles
from raystream.programs.cutouts import cutouts_of
from raystream.ray_files.identity import scene_digest
from raystream.tracer import Tracer

__all__ = ["SparseVisibility", "visibility"]

Form = Literal["dense", "bits", "sparse"]

_FORMS = ("dense", "bits", "sparse")

#: Memory of a ray while its tile is traced, besides the query's own: vectors in float64, the
#: heights over the ends' planes and their sums; and each skipped triangle.
_BYTES_PER_RAY = 200
_BYTES_PER_SKIPPED = 40

#: The array of a Zarr group.
_MATRIX = "visible"

#: Memory per pair of points that see each other, while a sparse result is sorted.
_BYTES_PER_ENTRY = 28


def visibility(
    tracer: Tracer,
    a: Any,
    b: Any = None,
    *,
    form: Form = "dense",
    front_only: bool = False,
    skip_a: Any = None,
    skip_b: Any = None,
    out: str | PathLike[str] | None = None,
    max_memory: int | None = None,
    cutouts: bool = True,
    progress: Progress | None = None,
) -> Any:
    """Find which points see each other.

    Parameters
    ----------
    tracer : Tracer
    a : array_like of shape (N, 3), real, or Hits of N points
        World space. An array has free points, such as eyes and sensors; hits are points on
        surfaces, as queries and `surface_points` return them.
    b : array_like of shape (M, 3), real, or Hits of M points, optional
        [default: the points of `a`; half of the segments are traced then, and the result is
        symmetric]
    form : {"dense", "bits", "sparse"}
        Form of the result; see below.
    front_only : bool
        Whether points on surfaces see only what is in front of their triangle, on the side from
        which its vertices run counter-clockwise [default: both sides].
    skip_a, skip_b : array_like of shape (N,) or (N, k), and (M,) or (M, k), int, optional
        Triangles that hide nothing from a point, such as those around a vertex; -1 for none.
    out : str or path, optional
        A ``.npy`` file for the result, "dense" or "bits"; or a ``.zarr`` folder for a Zarr group
        of any form, compressed. The call can be interrupted at any time; repeating it resumes. A
        file next to `out`, with ``.progress.json`` appended to its name, records the query and its
        progress; a finished result is returned at once.
    max_memory : int, optional
        Maximum number of bytes to use, excluding the tracer and the given points [default: the
        memory that is free].
    cutouts : bool
        Whether points see each other through cut-outs: where the opacity of a surface's material is
        below its ``alpha_cutoff``, or below a half without one. False makes all of it surface.
        Points on surfaces are taken as they are given, cut out or not.
    progress : callable, optional
        Called with (rays done, rays).

    Returns
    -------
    ndarray of shape (N, M), bool
        ``form="dense"``: whether point i of `a` sees point j of `b`.
    ndarray of shape (N, ceil(M / 8)), uint8
        ``form="bits"``: the same, packed; ``numpy.unpackbits(bits, axis=1, count=M)`` unpacks it.
    SparseVisibility
        ``form="sparse"``: the pairs that see each other.

    Raises
    ------
    ValueError
        If a shape, name or option is wrong, or the hits are of another scene; or if there are
        cut-outs, and the tracer counts.
    TypeError
        If numbers are not real, or `skip_a` or `skip_b` are not integers.
    MemoryError
        If the result and a block of rays need more than `max_memory` or the memory that is free;
        raised before anything is traced. Without `out`, the memory of "sparse" depends on the
        pairs found, and is checked as it grows; with `out`, that of a band of rows is known.
    FileFormatError
        If `out` belongs to another query.
    StoreWriteError
        If a Zarr group cannot be written.
    RaystreamError
        If the package zarr is needed and not installed; if the scene's instances are in worlds.

    Notes
    -----
    With `out`, the arrays are read-only memory maps of the file, or arrays of the group,
    ``zarr.Array``: "visible", or "indptr" and "indices". Otherwise, if `a`, or else `b`, is a
    tensor of PyTorch or an array of JAX, CuPy or xarray, "dense" and "bits" are arrays of that
    library.

    Two points see each other if no triangle meets the segment between them. A segment between
    free points includes both ends: a point that lies on a triangle within rounding errors may be
    hidden by it. At a point on a surface the segment is open: it leaves the triangle's plane to
    the side of the other point by a bound of the rounding errors, as in `Hits.spawn`, not by a
    fixed epsilon, so that neither the triangle nor its neighbours in the same plane hide it.
    Two points in one plane see each other along its front, but not with `front_only`. A surface
    nearer to a point than that bound, which is below 2**-17 of the scene's size, may or may not
    hide it. Points that are equal see each other, unless `front_only` excludes it. A point that is
    NaN, infinite, a miss or on a degenerate triangle sees nothing and is not seen.

    Segments run from `a` to `b`. With the arguments exchanged, the result is the transpose, except
    for segments that pass an edge within rounding errors.

    Rays are traced in blocks of at most 262,144; memory is needed for the result and one block.
    With `out`, rows of "sparse" are written in order: without `b`, all segments are then traced,
    from the lower to the higher number, not half of them.

    In a scene with instances, `skip_a` and `skip_b` refer to triangles in all instances.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> eyes = [[100.0, 100.0, 100.0], [460.0, 100.0, 300.0], [186.0, 80.0, 169.0]]
    >>> rs.visibility(tracer, eyes)  # the third is inside the short block
    array([[ True, False, False],
           [False,  True, False],
           [False, False,  True]])
    """
    check_tracer(tracer)
    if form not in _FORMS:
        raise ValueError(f"form: expected 'dense', 'bits' or 'sparse', got {form!r}")
    if b is None and skip_b is not None:
        raise ValueError("skip_b: expected None without b; skip_a serves both")
    path = None if out is None else _checked_path(out, form)
    triangles = tracer.structure.triangles
    check_support("visibility", triangles)
    if path is not None:
        check_support("out", triangles)
    starts = end_points("a", a, skip_a, triangles)
    stops = starts if b is None else end_points("b", b, skip_b, triangles)
    opacity = cutouts_of(tracer, cutouts)
    job = _Job(tracer, starts, stops, bool(front_only), form, b is None, opacity)
    tiles, limit = job.plan(path is not None, max_memory)
    if path is not None and path.suffix == ".zarr":
        return job.stored(path, tiles, progress)
    if form == "sparse":
        return job.sparse(tiles, limit, progress)
    shape, dtype = job.result_type
    if path is None:
        result = np.zeros(shape, dtype)
        job.fill(tiles, result, 0, None, progress)
        library = library_of(a, b)
        return result if library is None else library.of_rows(result)
    with resumable_array(path, shape, dtype, job.identity(tiles)) as file:
        job.fill(tiles, file.array, file.done, file.record, progress)
    return np.load(path, mmap_mode="r")


def _checked_path(out: str | PathLike[str], form: str) -> Path:
    path = Path(out)
    if path.suffix not in (".npy", ".zarr"):
        raise ValueError(f"out: expected a name that ends in .npy or .zarr, got {str(path)!r}")
    if form == "sparse" and path.suffix == ".npy":
        raise ValueError("out: expected a name that ends in .zarr for form='sparse'")
    return path


class _Job(NamedTuple):
    """A checked call of `visibility`."""

    tracer: Tracer
    starts: EndPoints
    stops: EndPoints
    front_only: bool
    form: str
    is_half: bool
    opacity: Any = None

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.starts.positions), len(self.stops.positions)

    @property
    def result_type(self) -> tuple[tuple[int, int], type[Any]]:
        """Shape and dtype of a result in one array."""
        rows, columns = self.shape
        return (
            ((rows, columns), np.bool_)
            if self.form == "dense"
            else (
                (rows, -(-columns // 8)),
                np.uint8,
            )
        )

    def plan(self, is_on_disk: bool, max_memory: int | None) -> tuple[Tiles, int | None]:
        """Choose the tiles, and check that they and the result fit into memory.

        Returns
        -------
        tiles : Tiles
        limit : int or None
            Bytes left for a sparse result; None if unknown.
        """
        limit = available_memory()
        if max_memory is not None:
            limit = operator.index(max_memory)
            if limit < 0:
                raise ValueError(f"max_memory: expected at least 0 bytes, got {limit}")
        result_shape, _ = self.result_type
        held = 0 if is_on_disk or self.form == "sparse" else result_shape[0] * result_shape[1]
        skipped = sum(
            ends.skipped.shape[-1] for ends in (self.starts, self.stops) if ends.skipped is not None
        )
        most = max(min(MOST_TILE, self.shape[0] * self.shape[1]), 1)
        is_banded = is_on_disk and self.form == "sparse"
        while True:
            per_ray = _BYTES_PER_RAY + _BYTES_PER_SKIPPED * skipped
            if is_banded:
                per_ray += _BYTES_PER_RAY * self.is_half  # ends by their numbers
                held = _BYTES_PER_ENTRY * max(most, self.shape[1])
            working = most * per_ray + self.tracer.memory_needed(most, "any_hit").total
            if limit is None or held + working <= limit:
                left = None if limit is None else limit - working
                if is_banded:
                    return band_tiles(self.shape, most), left
                return Tiles.of(self.shape, self.is_half, most), left
            if most <= LEAST_TILE:
                break
            most = max(most // 2, LEAST_TILE)
        rows, columns = self.shape
        given = f"{_size(limit)} are free"
        if max_memory is not None:
            given = f"max_memory allows {_size(limit)}"
        remedy = ""
        if held and not is_banded:
            bits = rows * -(-columns // 8)
            remedy = f"; use form='bits' ({_size(bits)}), 'sparse', or a file with out="
        raise MemoryError(
            f"visibility: {rows:,} x {columns:,} points take {_size(held)} and "
            f"{_size(working)} for a block of rays, and {given}{remedy}"
        )

    def trace(self, tile: Tile) -> NDArray[np.bool_]:
        """Whether the points of a tile see each other, of its shape."""
        starts, stops = self.starts.at(tile.rows), self.stops.at(tile.columns)
        pairs = starts.at((slice(None), None)), stops.at((None, slice(None)))
        return self._is_clear(*pairs)

    def trace_ordered(self, tile: Tile) -> NDArray[np.bool_]:
        """The same; of one set of points, segments run from the lower number to the higher."""
        rows, columns = tile.rows, tile.columns
        if not self.is_half or columns.start >= rows.stop:
            return self.trace(tile)
        if columns.stop <= rows.start:
            return self.trace(Tile(columns, rows, 0)).T
        i = np.arange(rows.start, rows.stop)[:, None]
        j = np.arange(columns.start, columns.stop)
        ends = self.starts.at(np.minimum(i, j)), self.starts.at(np.maximum(i, j))
        return self._is_clear(*ends)

    def _is_clear(self, starts: EndPoints, stops: EndPoints) -> NDArray[np.bool_]:
        on_hit = self.opacity and self.opacity.on_hit
        return is_clear(self.tracer, starts, stops, self.front_only, on_hit)

    def stored(self, path: Path, tiles: Tiles, progress: Progress | None) -> Any:
        """Trace the tiles into a Zarr group, or what is left of them."""
        identity = self.identity(tiles)
        if self.form == "sparse":
            with resumable_store(path, stored_rows(self.shape[0]), identity) as store:
                write_rows(self.trace_ordered, tiles, store, progress)
            splits, indices = (open_stored(path, name) for name in ("indptr", "indices"))
            return SparseVisibility(splits, indices, self.shape)
        shape, dtype = self.result_type
        rows, columns = (max(step, 1) for step in tiles.step)
        chunk = rows, columns if self.form == "dense" else -(-columns // 8)
        kind = StoredArray(shape, chunk, np.dtype(dtype).name)
        with resumable_store(path, {_MATRIX: kind}, identity) as store:
            self.fill(tiles, store.matrix(_MATRIX), store.done.rays, store.record, progress)
        return open_stored(path, _MATRIX)

    def fill(
        self, tiles: Tiles, out: Any, done: int, record: Any, progress: Progress | None
    ) -> None:
        """Trace the tiles from ray `done` on into an array."""
        total = tiles.ray_count
        try:
            for tile in tiles:
                if tile.begin < done:
                    continue
                seen = self.trace(tile)
                self._put(out, tile, seen)
                if self.is_half:
                    mirrored = Tile(tile.columns, tile.rows, 0)
                    if tile.rows == tile.columns:
                        seen = np.triu(seen) | np.triu(seen, 1).T
                        self._put(out, tile, seen)
                    else:
                        self._put(out, mirrored, seen.T)
                done = tile.begin + tile.ray_count
                if record:
                    record(done)
                if progress:
                    progress(done, total)
        finally:
            if record:
                record(done, at_once=True)

    def _put(self, out: Any, tile: Tile, seen: NDArray[np.bool_]) -> None:
        if self.form == "dense":
            out[tile.rows, tile.columns] = seen
        else:
            first = tile.columns.start // 8
            packed = np.packbits(seen, axis=1)
            out[tile.rows, first : first + packed.shape[1]] = packed

    def sparse(
        self, tiles: Tiles, limit: int | None, progress: Progress | None
    ) -> SparseVisibility:
        """Trace the tiles, and keep the pairs that see each other."""
        rows, columns = self.shape
        total, found = tiles.ray_count, 0
        parts: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
        for tile in tiles:
            seen = self.trace(tile)
            if self.is_half and tile.rows == tile.columns:
                seen = np.triu(seen)
            i, j = np.nonzero(seen)
            i, j = i + tile.rows.start, j + tile.columns.start
            parts.append(i * columns + j)
            found += len(i)
            if self.is_half:
                above = i != j
                parts.append(j[above] * columns + i[above])
                found += int(np.count_nonzero(above))
            done = tile.begin + tile.ray_count
            if limit is not None and found * _BYTES_PER_ENTRY > limit:
                raise MemoryError(
                    f"visibility: {found:,} pairs after {done / total:.1%} of the rays take "
                    f"{_size(found * _BYTES_PER_ENTRY)}, and {_size(limit)} are left for them; "
                    "use form='bits' with out="
                )
            if progress:
                progress(done, total)
        keys = np.concatenate(parts)
        del parts
        keys.sort()
        dtype = np.int32 if max(len(keys), columns) < 2**31 else np.int64
        starts = np.searchsorted(keys, np.arange(rows + 1) * columns)
        indices = (keys % max(columns, 1)).astype(dtype)
        return SparseVisibility(starts.astype(dtype), indices, (rows, columns))

    def identity(self, tiles: Tiles) -> dict[str, Any]:
        """Describe the query in JSON types."""
        digest = hashlib.sha256()
        for ends in (self.starts, self.stops):
            for array in ends.arrays:
                digest.update(b"none" if array is None else np.ascontiguousarray(array).data)
        return {
            "version": __version__,
            "query": "visibility",
            "form": self.form,
            "front_only": self.front_only,
            "is_half": self.is_half,
            "shape": list(self.shape),
            "block": list(tiles.step),
            "points_digest": digest.hexdigest(),
            "scene_digest": scene_digest(self.tracer.structure.triangles),
            "device": self.tracer.device,
            **({"cutouts": self.opacity.digest()} if self.opacity else {}),
        }


def _size(byte_count: int | None) -> str:
    return f"{(byte_count or 0) / 1e9:,.3f} GB"
