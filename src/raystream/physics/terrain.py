"""Terrain: elevation rasters as scenes, their viewsheds and hillshades."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.checks import check_finite
from raystream.core.height_field import HeightField
from raystream.core.memory import check_memory
from raystream.core.rays import as_number, as_real_array
from raystream.jit.threads import Progress
from raystream.physics.elevation import Elevation, Georeference, elevation_of
from raystream.physics.hillshade import brightness, direction_to_sun
from raystream.physics.terrain_mesh import hole_edges, triangulated, walls
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

__all__ = ["BYTES_PER_CELL", "Terrain", "terrain"]

#: Most memory that a cell takes while the structure is built, with the arrays of the mesh.
BYTES_PER_CELL = 600

#: The same of a height field.
FIELD_BYTES_PER_CELL = 40

_NO_TRIANGLES = "dem: no square of four neighbouring cells has data for a triangle"

#: Cells per band: bounds the memory of all but the results.
_CELLS_PER_BAND = 1 << 18

#: Least height of an eye, as part of the terrain's size, that float32 tells from the ground.
_LEAST_HEIGHT = 2.0**-20


class Terrain:
    """An elevation raster as a scene; made by `terrain`.

    Attributes
    ----------
    tracer : Tracer
        For other queries of the terrain; ``tracer.scene`` is the scene, of one mesh or one height
        field.
    heights : ndarray of shape (H, W), float64
        At the centres of the cells; NaN where there is no data.
    x, y : ndarray of shape (W,) and (H,), float64
        Coordinates of columns and of rows.
    """

    def __init__(
        self, elevation: Elevation, tracer: Tracer, options: Mapping[str, Any] | None = None
    ) -> None:
        self._elevation, self._options = elevation, dict(options or {})
        self.tracer = tracer
        self.heights, self.x, self.y = elevation[:3]
        low, high = tracer.scene.bounds
        self._size = float((high - low).max())

    @property
    def scene(self) -> Scene:
        """The scene: z is up."""
        return self.tracer.scene

    def elevation(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights of the ground between the cells' centres.

        Parameters
        ----------
        x, y : array_like of shapes that broadcast, real

        Returns
        -------
        ndarray of that shape, float64
            On the triangles; NaN outside the raster, and where there is no data.
        """
        columns, rows = as_real_array("x", x), as_real_array("y", y)
        try:
            points = np.broadcast_arrays(columns.astype(np.float64), rows.astype(np.float64))
        except ValueError:
            raise ValueError(
                f"x, y: shapes {columns.shape} and {rows.shape} do not broadcast against each other"
            ) from None
        return self._elevation.at(*points)

    def viewshed(
        self,
        observer: Any,
        height: float,
        *,
        target_height: float = 0.0,
        max_distance: float = math.inf,
        earth_radius: float | None = None,
        refraction: float = 0.0,
        progress: Progress | None = None,
    ) -> Any:
        """Find the cells that an observer sees.

        Parameters
        ----------
        observer : array_like of shape (2,), real
            x and y of the observer, on ground with data.
        height : float
            Height of the eye above the ground there, greater than 0.
        target_height : float
            Height of the target above the ground, in each cell.
        max_distance : float
            Maximum distance from the eye to the target; farther cells are not visible.
        earth_radius : float, optional
            Radius of a curved Earth, in the units of the raster: 6,371,000 m on average [default:
            the Earth is flat].
        refraction : float
            Coefficient of refraction: the curvature of lines of sight as a fraction of the
            Earth's. Usual values are 0.13 for light (Gauss) and 0.25 for radio waves.
        progress : callable, optional
            Called with (rows done, rows).

        Returns
        -------
        ndarray of shape (H, W), bool, or DataArray
            Whether the line from the eye to the centre of each cell is clear: no triangle is in
            the way except those around that cell, and it does not pass below the ground behind
            cells without data. If there are such cells, a masked array, in which they are masked,
            and False beneath. A DataArray, named "viewshed", if the terrain was made from one; then
            float32 if there are cells without data: 1, 0, and NaN for these.

        Raises
        ------
        ValueError
            If there is no ground at the observer, `height` is not above 0 (or too small for
            float32, see Notes), `target_height` or `max_distance` is negative or NaN, or
            `earth_radius` is less than the distance of a cell; or `refraction` is given without it.
        MemoryError
            If, with `earth_radius`, a second terrain does not fit into memory.

        Notes
        -----
        The ground is made of flat triangles, and there are none next to cells without data: lines
        pass there at any height, and are blocked where they meet known ground from below. Lines
        that clear the ground by less than 2**-20 of the terrain's size (1 cm in 10 km) may be
        reported either way. Rays are traced in bands of rows, which bounds the memory.

        With `earth_radius`, cells at a distance d from the observer on the map are lowered by
        (1 - refraction) d**2 / (2 earth_radius), and lines are straight [1]_. That is a sphere's
        drop except for d**4 / (24 earth_radius**3): 2 cm in 100 km. The lowered terrain is built
        for each call.

        References
        ----------
        .. [1] Torge and Müller, "Geodesy", 4th edition, de Gruyter 2012, section 5.1: the effects
           of curvature and refraction on heights.
        """
        true_eye = self._eye(observer, height)
        ground = self._lowered(true_eye, earth_radius, refraction)
        eye = ground._eye(observer, height)
        target_height = _at_least("target_height", target_height, 0.0)
        max_distance = _at_least("max_distance", max_distance, 0.0)
        visible = np.zeros(self.heights.shape, np.bool_)
        for rows in self._bands(progress):
            cells = np.flatnonzero(np.isfinite(self.heights[rows]))
            targets, vertices = ground._centers(rows, cells)
            targets[:, 2] += target_height
            sight = targets - eye
            if max_distance < math.inf:
                places, _ = self._centers(rows, cells)
                places[:, 2] += target_height
                is_near = np.linalg.norm(places - true_eye, axis=1) <= max_distance
                cells, sight, vertices = cells[is_near], sight[is_near], vertices[is_near]
            visible[rows].reshape(-1)[cells] = ground._is_clear(eye, sight, vertices)
        return self._elevation.labelled(visible, "viewshed")

    def hillshade(
        self,
        azimuth: float = 315.0,
        altitude: float = 45.0,
        *,
        shadows: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """Shade the ground in sunlight.

        Parameters
        ----------
        azimuth : float
            Azimuth of the sun, in degrees clockwise from north, the direction of increasing y.
        altitude : float
            Altitude of the sun, in degrees above the horizon, greater than 0 and at most 90.
        shadows : bool
            Trace rays to find the ground that lies in the shadow of other ground.
        progress : callable, optional
            Called with (rows done, rows).

        Returns
        -------
        ndarray of shape (H, W), float32, or DataArray
            Cosine of the angle between the sun and the ground's normal, 0 to 1; 0 where the ground
            faces away or, with `shadows`, in the shadow of known ground; NaN where there is no
            data, or no neighbour in the row or in the column. A DataArray, named "hillshade", if
            the terrain was made from one.

        Raises
        ------
        ValueError
            If `azimuth` is not finite, or `altitude` is out of range.

        Notes
        -----
        Slopes are those of the parabola through a cell and its neighbours in the row, and in the
        column; at the border and next to cells without data, those of a line.
        """
        azimuth, altitude = as_number("azimuth", azimuth), as_number("altitude", altitude)
        check_finite("azimuth", azimuth)
        if not 0.0 < altitude <= 90.0:
            raise ValueError(f"altitude: expected more than 0 and at most 90, got {altitude}")
        sun = direction_to_sun(azimuth, altitude)
        shade = np.empty(self.heights.shape, np.float32)
        for rows in self._bands(progress):
            shade[rows] = brightness(self._elevation, rows, sun)
            if not shadows:
                continue
            cells = np.flatnonzero(shade[rows] > 0.0)
            targets, vertices = self._centers(rows, cells)
            reach = 4.0 * self._size * sun  # leaves the scene's box
            is_lit = self._is_clear(targets + reach, -reach, vertices)
            shade[rows].reshape(-1)[cells[~is_lit]] = 0.0
        return self._elevation.labelled(shade, "hillshade")

    def _lowered(self, eye: NDArray[np.float64], earth_radius: Any, refraction: Any) -> Terrain:
        """The terrain as it is to be seen on a curved Earth in straight lines from an eye."""
        bending = as_number("refraction", refraction)
        check_finite("refraction", bending)
        if earth_radius is None:
            if bending:
                raise ValueError("refraction: expected 0 without earth_radius")
            return self
        radius = as_number("earth_radius", earth_radius)
        elevation = self._elevation
        squares = (self.x - eye[0]) ** 2 + ((self.y - eye[1]) ** 2)[:, None]
        farthest = math.sqrt(squares.max())
        if not radius > farthest:
            raise ValueError(
                "earth_radius: expected more than the distance of the farthest cell, "
                f"{farthest:.4g}, got {radius:g}; it is in the units of the raster"
            )
        lowered = elevation.heights - (1.0 - bending) / (2.0 * radius) * squares
        lowered_elevation = elevation._replace(heights=lowered)
        return _built(lowered_elevation, self.scene.has_primitives, self._options, None)

    def _eye(self, observer: Any, height: float) -> NDArray[np.float64]:
        place = _place(observer)
        ground = float(self._elevation.at(*place[:, None])[0])
        if math.isnan(ground):
            raise ValueError(
                f"observer: no ground at ({place[0]:g}, {place[1]:g}); x ranges from "
                f"{self.x.min():g} to {self.x.max():g}, y from {self.y.min():g} to "
                f"{self.y.max():g}, except cells without data"
            )
        least = _LEAST_HEIGHT * self._size
        height = as_number("height", height)
        if not least < height < math.inf:
            raise ValueError(
                f"height: expected a finite number above {least:.3g} (2**-20 of the terrain's "
                f"size), got {height}"
            )
        return np.array([*place, ground + height])

    def _centers(
        self, rows: slice, cells: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Points on the ground at cells of a band, and their numbers among the vertices."""
        row, column = np.divmod(cells, len(self.x))
        row += rows.start
        points = np.stack([self.x[column], self.y[row], self.heights[row, column]], axis=1)
        return points, row * len(self.x) + column

    def _is_clear(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        vertices: NDArray[np.intp],
    ) -> NDArray[np.bool_]:
        """Whether rays reach their ends, at or above these vertices, before other triangles.

        The triangles around a vertex are never in the way: they lie below a line that begins above
        the ground and ends above the vertex, and only rounding makes it hit them before it ends.
        """
        is_clear = _reach_ends(self.tracer, origins, directions, vertices, self._samples_of)
        if self._walls is None:
            return is_clear
        tracer, edges = self._walls
        rows = np.flatnonzero(is_clear)
        origins, directions = np.broadcast_arrays(origins, directions)
        is_clear[rows] = _reach_ends(
            tracer, origins[rows], directions[rows], vertices[rows], lambda ids: edges[ids // 2]
        )
        return is_clear

    @cached_property
    def _walls(self) -> tuple[Tracer, NDArray[np.int64]] | None:
        """Walls below the ground around holes, and the cells at the ends of each; None without.

        A line can only come below known ground through triangles or through these. Like the
        triangles around a vertex, the walls beneath it are never in the way of a line that ends
        there: it meets their planes at its end.
        """
        edges = hole_edges(self.heights)
        if not len(edges):
            return None
        check_memory(
            BYTES_PER_CELL * len(edges),
            f"the ground around cells without data, with {len(edges):,} edges, would",
            "fill in single cells",
        )
        scene = Scene([Mesh(*walls(self._elevation, edges))], up=(0.0, 0.0, 1.0))
        return Tracer(scene, **self._options), edges

    def _samples_of(self, prim_ids: NDArray[np.int32]) -> NDArray[Any]:
        """The cells at the corners of triangles, by number, shape (N, 3)."""
        if not self.scene.has_primitives:
            return self.scene.meshes[0].faces[prim_ids]
        held: Any = self.scene.triangles
        row, column = held.fields[0].samples_of(prim_ids)
        return row * len(self.x) + column

    def _bands(self, progress: Progress | None) -> Iterator[slice]:
        row_count, column_count = self.heights.shape
        size = max(1, _CELLS_PER_BAND // column_count)
        for first in range(0, row_count, size):
            rows = slice(first, min(first + size, row_count))
            yield rows
            if progress:
                progress(rows.stop, row_count)

    def __repr__(self) -> str:
        row_count, column_count = self.heights.shape
        triangle_count = len(self.scene.triangles)
        return f"Terrain({row_count:,} x {column_count:,} cells, {triangle_count:,} triangles)"


def terrain(
    dem: Any,
    *,
    spacing: Any = None,
    transform: Any = None,
    nodata: float | None = None,
    surface: str = "mesh",
    progress: Progress | None = None,
    **options: Any,
) -> Terrain:
    """Make a scene from an elevation raster.

    Parameters
    ----------
    dem : array_like of shape (H, W), real, or xarray.DataArray
        Heights at the centres of cells, at least 2 x 2. NaN, or masked, where there is no data.
        The last dimension of a DataArray is x; its coordinates, if any, and
        ``attrs["_FillValue"]`` are used.
    spacing : float or array_like of shape (2,), optional
        Distance between columns, and between rows; negative if rows run from north to south. The
        first cell's centre is at (0, 0) [default: 1].
    transform : sequence of 6 or 9 numbers, optional
        Instead of `spacing`, as rasterio's ``Affine`` (a, b, c, d, e, f): the corner of column i
        and row j is at x = a i + c, y = e j + f. Rotated rasters (b or d not 0) are not supported.
    nodata : float, optional
        A height that stands for no data.
    surface : {"mesh", "height field"}
        How the triangles are kept: as a mesh, or as `Scene.height_field`, which is ready at once
        and takes a fifteenth of the memory. Rays in all directions are about twice as fast with a
        mesh, and all structures, devices and queries support it. Results are the same.
    progress : callable, optional
        Called with (triangles done, triangles) during a long build.
    **options
        Options of the `Tracer`, such as ``structure`` and ``device``.

    Returns
    -------
    Terrain

    Raises
    ------
    ValueError
        If `dem` has the wrong shape, infinite heights, or dimensions in degrees, unlike the
        heights; if coordinates neither increase nor decrease throughout; or if `surface` is
        unknown.
    TypeError
        If `dem` does not hold real numbers.
    MemoryError
        If the terrain needs more memory than is free: at most 600 bytes for each cell, or 40 as a
        height field.

    Notes
    -----
    Each square of four neighbouring centres is two triangles, split from the corner of the lower
    row and column number to the opposite one; triangles share vertices, so that no ray slips
    between them. Triangles with a corner without data are left out: such cells are holes. Results
    are those of this surface: nothing is known about the ground between the centres.

    Examples
    --------
    >>> import numpy as np
    >>> import raystream as rs
    >>> heights = np.zeros((5, 9))
    >>> heights[:, 4] = 3.0  # a wall
    >>> ground = rs.terrain(heights, spacing=10.0)
    >>> ground.viewshed((0.0, 20.0), height=2.0)[2].astype(int).tolist()
    [1, 1, 1, 1, 1, 0, 0, 0, 0]
    """
    if surface not in ("mesh", "height field"):
        raise ValueError(f"surface: expected 'mesh' or 'height field', got {surface!r:.80}")
    elevation = elevation_of(dem, Georeference(spacing, transform), nodata)
    return _built(elevation, surface == "height field", options, progress)


def _built(
    elevation: Elevation, is_field: bool, options: Mapping[str, Any], progress: Progress | None
) -> Terrain:
    """The terrain of an elevation raster; `options` are those of the `Tracer`."""
    cell_count = elevation.heights.size
    check_memory(
        (FIELD_BYTES_PER_CELL if is_field else BYTES_PER_CELL) * cell_count,
        f"dem: a terrain of {cell_count:,} cells would",
        "use fewer cells, as in dem[::2, ::2]"
        + ("" if is_field else ", or surface='height field'"),
    )
    if is_field:
        field = HeightField(*elevation[:3])
        if field.is_empty:
            raise ValueError(_NO_TRIANGLES)
        scene = Scene.of_field(field, name="terrain")
        return Terrain(elevation, Tracer(scene, progress=progress, **options), options)
    vertices, faces = triangulated(elevation)
    if not len(faces):
        raise ValueError(_NO_TRIANGLES)
    scene = Scene([Mesh(vertices, faces, name="terrain")], up=(0.0, 0.0, 1.0), name="terrain")
    return Terrain(elevation, Tracer(scene, progress=progress, **options), options)


def _reach_ends(
    tracer: Tracer,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    vertices: NDArray[np.intp],
    cells_of: Callable[[NDArray[np.int32]], NDArray[Any]],
) -> NDArray[np.bool_]:
    """Whether rays first hit a triangle with their end among its cells, or none."""
    hits = tracer.first_hit(origins, directions, t_max=1.0)
    is_clear = ~hits.is_hit
    rows = np.flatnonzero(hits.is_hit)
    is_clear[rows] = (cells_of(hits.prim_id[rows]) == vertices[rows, None]).any(axis=1)
    return is_clear


def _place(observer: Any) -> NDArray[np.float64]:
    place = as_real_array("observer", observer).astype(np.float64)
    if place.shape != (2,):
        raise ValueError(f"observer: expected x and y, got shape {place.shape}")
    return place


def _at_least(name: str, value: float, low: float) -> float:
    number = as_number(name, value)
    if not number >= low:
        raise ValueError(f"{name}: expected a number >= {low:g}, got {number}")
    return number
