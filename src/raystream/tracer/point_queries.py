"""PointQueries: the queries of a `Tracer` for points rather than rays."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_least
from raystream.core.closest_points import ClosestPoints
from raystream.core.memory import check_memory
from raystream.core.rays import as_real_array, as_vectors, broadcast
from raystream.core.scene_kinds import check_support
from raystream.jit.threads import Progress, part_of
from raystream.kernels.point_queries import NearestArrays, PointBatch, answer_bytes
from raystream.machines.scene_winding import scene_winding
from raystream.structures.registry import names_with
from raystream.tracer.inside import InsideTest
from raystream.tracer.memory_needed import CHECKED_RAYS
from raystream.tracer.ray_cast import RayCaster


class PointQueries(RayCaster):
    """The queries of a `Tracer` for points; the others take rays."""

    def closest_point(
        self,
        points: Any,
        *,
        max_distance: Any = np.inf,
        worlds: Any = None,
        progress: Progress | None = None,
    ) -> ClosestPoints:
        """Find the nearest point on the scene's surfaces for each point.

        Parameters
        ----------
        points : array_like of shape S + (3,), real
            World space.
        max_distance : float or array_like that broadcasts to S
            Greatest distance, inclusive, in world units; at least 0.
        worlds : array_like that broadcasts to S, int, optional
            In a scene whose instances are in worlds: the world of each point, as in `first_hit`.
            The points of each world are answered together, by a tree that is built for the call;
            for more calls, keep the tracers that `in_world` makes.
        progress : callable, optional
            Called with (points done, points).

        Returns
        -------
        ClosestPoints
            ``distance`` of shape S and ``positions`` of shape S + (3,), float64; ``u``, ``v`` and
            ``prim_id`` of shape S. A point without a triangle within `max_distance`, or with a
            coordinate that is NaN or infinite, has ``distance = inf`` and ``prim_id = -1``.

        Raises
        ------
        ValueError
            If a shape does not fit, `max_distance` is negative or NaN, or the tracer's structure,
            device or machine does not support the query: ``structure="bvh"`` and ``"brute"`` on
            the branching machines of ``device="cpu"`` and ``"cuda"`` do.
        TypeError
            If an array does not hold real numbers.
        MemoryError
            If the results do not fit into memory.

        Notes
        -----
        The distance is computed in float64, between the point and the triangles' float32
        coordinates in the scene's local frame: its error is below 2**-48 of the sum of the
        distance and the triangle's size [1]_. Both structures give the same bits. At equal
        distances, before the square root, the lowest prim_id wins; triangles that share an edge or
        a vertex have equal distances to points nearest to it, bit for bit. Degenerate triangles,
        and those with a NaN or infinite vertex, are ignored, as they are by rays: the nearest
        point is never on them.

        A sphere's distance is that of its surface, also from within; of all points of a sphere,
        the one nearest to its centre is the one above it, along z. The distance from an instance
        is that in world space, under any transform: of triangles whose vertices are moved there
        in float64. With ``precision="float64"`` vertices are not rounded, and triangles without
        area count as the segments they are. The error of all these is below 2**-48 of the sum of
        the distance, the triangle's or the sphere's size and, of spheres and instances, the
        largest coordinate [2]_. Equal distances from instances are ordered by instance_id first.

        References
        ----------
        .. [1] ``docs/decisions/0049-closest-point.rst``.
        .. [2] ``docs/decisions/0079-points-among-kinds.rst``.

        Examples
        --------
        >>> import raystream as rs
        >>> scene = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> near = rs.Tracer(scene).closest_point([[0.25, 0.25, 2], [3, 0, 0]])
        >>> near.distance.tolist(), near.positions.tolist()
        ([2.0, 2.0], [[0.25, 0.25, 0.0], [1.0, 0.0, 0.0]])
        """
        return self._nearest(points, None, max_distance, worlds, progress)

    def closest_points(
        self,
        points: Any,
        k: int,
        *,
        max_distance: Any = np.inf,
        worlds: Any = None,
        progress: Progress | None = None,
    ) -> ClosestPoints:
        """Find the `k` nearest triangles to each point, and their nearest points.

        Parameters
        ----------
        points, max_distance, worlds, progress
            See `closest_point`.
        k : int
            Triangles per point, at least 1.

        Returns
        -------
        ClosestPoints
            Arrays of shape S + (k,), by increasing distance, then prim_id. Rows without a triangle
            within `max_distance` come last, with ``distance = inf`` and ``prim_id = -1``.

        Raises
        ------
        ValueError, TypeError, MemoryError
            As `closest_point`, or if `k` is not an integer above 0.

        Notes
        -----
        The time of a point grows with `k`, and for large `k` with its square.

        Examples
        --------
        >>> import raystream as rs
        >>> tracer = rs.Tracer(rs.load("cornell"))
        >>> tracer.closest_points([278.0, 273.0, 280.0], 3).prim_id.tolist()
        [30, 23, 28]
        """
        return self._nearest(points, check_least("k", k, 1), max_distance, worlds, progress)

    def signed_distance(
        self,
        points: Any,
        *,
        max_distance: Any = np.inf,
        method: Literal["rays", "winding"] = "rays",
        worlds: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float64]:
        """Find the distance of each point from the surface, negative inside.

        Parameters
        ----------
        points, max_distance
            See `closest_point`.
        method : {"rays", "winding"}
            How to tell the inside; see `contains`.
        worlds : array_like that broadcasts to S, int, optional
            See `closest_point`.
        progress : callable, optional
            Called with (steps done, steps).

        Returns
        -------
        ndarray of shape S, float64
            World units: `ClosestPoints.distance`, negative where `contains` is true. Infinite
            beyond `max_distance`, NaN for points with a coordinate that is NaN or infinite. Where
            solids overlap, the nearest surface may be that of one within another.

        Raises
        ------
        ValueError, TypeError, MemoryError
            See `closest_point` and `contains`.

        Examples
        --------
        >>> import raystream as rs
        >>> corners = [[x, y, z] for x in (0, 2) for y in (0, 2) for z in (0, 2)]
        >>> sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
        ...     [1, 5, 7, 3]]
        >>> faces = [half for a, b, c, d in sides for half in ([a, b, c], [a, c, d])]
        >>> box = rs.Tracer(rs.Scene.from_arrays(corners, faces))
        >>> box.signed_distance([[1, 1, 1.5], [1, 1, 5]]).tolist()
        [-0.5, 3.0]
        """
        given = as_vectors("points", points)
        limits = _limits_of(max_distance, given.shape[:-1])
        asked = {"max_distance": limits, "method": method}
        of_worlds = self._in_worlds("signed_distance", given, worlds, progress, asked)
        if of_worlds is not None:
            return of_worlds
        test = InsideTest(self, method)  # first: it may refuse
        # Of the progress, the distance counts as one part, the inside as four.
        steps = max(given.size // 3, 1)
        of_inside = part_of(progress, steps, 4 * steps, 5 * steps)
        own = part_of(progress, 0, steps, 5 * steps)
        nearest = self._nearest(points, None, max_distance, None, own)
        inside = test.inside(given, of_inside)
        distance = nearest.distance.reshape(-1)
        distance[inside] *= -1.0
        distance[nearest.status.reshape(-1) != 0] = np.nan
        return distance.reshape(nearest.status.shape)

    def contains(
        self,
        points: Any,
        *,
        method: Literal["rays", "winding"] = "rays",
        worlds: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Find which points lie inside the surface.

        Parameters
        ----------
        points : array_like of shape S + (3,), real
            World space.
        method : {"rays", "winding"}
            Count the crossings of three rays in different directions with a closed surface; where
            they disagree, the winding number decides, and where solids may overlap, the sides of
            the crossings. Or use winding numbers for all points, which also suits open surfaces:
            inside is where they are above 1/2 or below -1/2.
        worlds : array_like that broadcasts to S, int, optional
            See `closest_point`.
        progress : callable, optional
            Called with (steps done, steps).

        Returns
        -------
        ndarray of shape S, bool
            False for points with a coordinate that is NaN or infinite.

        Raises
        ------
        ValueError
            If a shape does not fit; if `method` is unknown; or if it is ``"rays"``, and the scene's
            surface is not closed, with the open meshes and the first of their open edges: then the
            parity of crossings means nothing. A height field is an open surface.
        TypeError
            If the points are not real numbers.

        Notes
        -----
        Supported on every structure, device and machine. The surface is that of all meshes
        together, and it is closed if its triangles traverse each edge as often in one direction as
        in the other; vertices with equal coordinates are one. Triangles without area count if they
        are needed to close it, as those of a file whose edges are split on one side only.

        Spheres are closed: inside is what is within the radius. Each object of instances has to be
        closed by itself.

        A point within several closed meshes, or overlapping parts of one, is inside. A mesh
        that faces inward within one that faces outward is a cavity. Both methods find points whose
        winding number is not 0.

        Rays begin at the points rounded to float32 in the scene's local frame: a point on the
        surface, or nearer to it than the rounding error, may count as inside or outside.

        Examples
        --------
        >>> import raystream as rs
        >>> spheres = rs.Tracer(rs.load("spheres"))
        >>> spheres.contains([[0.0, 0.0, 0.0]], method="winding").shape
        (1,)
        """
        given = as_vectors("points", points)
        of_worlds = self._in_worlds("contains", given, worlds, progress, {"method": method})
        if of_worlds is not None:
            return of_worlds.astype(np.bool_)
        test = InsideTest(self, method)
        return test.inside(given, progress).reshape(given.shape[:-1])

    def winding_number(
        self,
        points: Any,
        *,
        accuracy: float = 0.0,
        worlds: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float64]:
        """Compute how often the surface surrounds each point.

        Parameters
        ----------
        points : array_like of shape S + (3,), real
            World space.
        accuracy : float
            Greatest error, at least 0. If it is above 0, distant groups of triangles are summed as
            one where that is accurate enough.
        worlds : array_like that broadcasts to S, int, optional
            See `closest_point`.
        progress : callable, optional
            Called with (points done, points).

        Returns
        -------
        ndarray of shape S, float64
            The generalised winding number [1]_: the sum of the triangles' signed solid angles
            divided by 4 pi. For a closed surface with outward normals it is 1 inside and 0
            outside, within rounding; for an open one, something in between. NaN for points with a
            coordinate that is NaN or infinite.

        Raises
        ------
        ValueError, TypeError
            If the points are not real numbers of shape S + (3,), or `accuracy` is not a number of
            at least 0.

        Notes
        -----
        By default, the result is exact except for rounding, and each point takes time proportional
        to the number of triangles, about 4 ns per triangle on one core. An `accuracy` enables a
        tree of the triangles, built once, and the expansions of Barill et al. [2]_, each with an
        error bound: the bounds of all groups together are below `accuracy`; otherwise the exact
        sum is computed. `contains` does this automatically, with the same results as with exact
        sums.

        Each sphere around a point adds 1, and 1/2 where the point is on it. Instances add the
        numbers of their objects, also where they mirror: their fronts stay in front. These are
        sums in object space: of an open surface, a transform that shears or that scales axes
        differently would change the solid angles, so `Scene.flattened` may give other numbers.

        References
        ----------
        .. [1] Jacobson, Kavan and Sorkine-Hornung, "Robust Inside-Outside Segmentation using
           Generalized Winding Numbers", ACM Transactions on Graphics 32(4), 2013.
        .. [2] Barill, Dickson, Schmidt, Levin and Jacobson, "Fast Winding Numbers for Soups and
           Clouds", ACM Transactions on Graphics 37(4), 2018.

        Examples
        --------
        >>> import raystream as rs
        >>> triangle = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> rs.Tracer(triangle).winding_number([0.0, 0.0, -1e-9]).round(3).item()
        0.125
        """
        check_support("winding numbers", self.structure.triangles)
        given, most = as_vectors("points", points), float(accuracy)
        if not most >= 0.0:
            raise ValueError(f"accuracy: expected a number >= 0, got {accuracy}")
        of_worlds = self._in_worlds("winding_number", given, worlds, progress, {"accuracy": most})
        if of_worlds is not None:
            return of_worlds
        numbers = scene_winding(self.structure, given.reshape(-1, 3), progress, most)
        return numbers.reshape(given.shape[:-1])

    def _in_worlds(
        self,
        query: str,
        points: NDArray[Any],
        worlds: Any,
        progress: Progress | None,
        options: dict[str, Any],
    ) -> NDArray[np.float64] | None:
        """Ask a query of the tracers of all points' worlds; None in a scene without worlds."""
        ids = self._world_ids(worlds, points.shape[:-1])
        if ids is None:
            return None
        flat, answers = points.reshape(-1, 3), np.empty(len(ids))
        for rows, one, report in self._by_world(ids, progress):
            own = {
                name: np.broadcast_to(value, ids.shape)[rows] if name == "max_distance" else value
                for name, value in options.items()
            }
            answers[rows] = getattr(one, query)(flat[rows], progress=report, **own)
        return answers.reshape(points.shape[:-1])

    def _find_nearest(
        self,
        batch: PointBatch,
        out: NearestArrays,
        ids: NDArray[np.int32] | None,
        progress: Progress | None,
    ) -> None:
        """Find the triangles nearest to points, which may be in worlds."""
        if ids is None:
            self._backend.find_nearest(batch, out, progress)
            return
        held: Any = self.structure.triangles
        for rows, one, report in self._by_world(ids, progress):
            part = NearestArrays.empty(len(rows), batch.capacity)
            limits = batch.limits if len(batch.limits) == 1 else batch.limits[rows]
            one._find_nearest(
                PointBatch(batch.points[rows], limits, batch.capacity), part, None, report
            )
            # Instances count from 0 in each world: -1 stays -1, the last row.
            instances = np.append(held.instances.in_world(int(ids[rows[0]])), -1)
            prim_id, instance_id = one.structure.triangles.split_ids(part.prim_id)
            part.prim_id[:] = held.numbers_of(prim_id, instances[instance_id])
            for whole, own in zip(out, part, strict=True):
                whole.reshape(len(ids), -1)[rows] = own.reshape(len(rows), -1)

    def _nearest(
        self,
        points: Any,
        k: int | None,
        max_distance: Any,
        worlds: Any,
        progress: Progress | None,
    ) -> ClosestPoints:
        """The nearest triangle of each point, or the nearest `k` in a further dimension."""
        self._check_points()
        given = as_vectors("points", points)
        shape = given.shape[:-1]
        ids, limits = self._world_ids(worlds, shape), _limits_of(max_distance, shape)
        local = np.ascontiguousarray(given.reshape(-1, 3), np.float64)
        count, capacity = len(local), 1 if k is None else k
        rows = count * capacity
        if rows >= CHECKED_RAYS:
            needed, what = answer_bytes(count, capacity), f"{rows:,} nearest triangles would"
            check_memory(needed, what, "give fewer points or a smaller k")
        out = NearestArrays.empty(count, capacity)
        self._find_nearest(PointBatch(local, limits, capacity), out, ids, progress)
        wide = shape if k is None else (*shape, k)
        prim_id, instance_id = self.structure.triangles.split_ids(out.prim_id.reshape(wide))
        return ClosestPoints(
            out.distance.reshape(wide),
            out.positions.reshape(*wide, 3),
            (out.u.reshape(wide), out.v.reshape(wide)),
            (prim_id, instance_id),
            out.status.reshape(shape),
            self.structure.triangles,
        )

    def _check_points(self) -> None:
        """Check that the structure and the backend find closest points."""
        check_support("closest points", self.structure.triangles)
        known = names_with("nearest")
        if self.structure.name not in known or not self._backend.capabilities.points:
            names = " or ".join(f"structure={name!r}" for name in known)
            raise ValueError(
                f"closest points are not supported by structure={self.structure.name!r}, "
                f"device={self.device!r}, machine={self.machine!r}; use {names} with "
                "device='cpu' or 'cuda' and machine='branching'"
            )


def _limits_of(max_distance: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Greatest distances, of shape (N,), or (1,) for one that all points have."""
    array = as_real_array("max_distance", max_distance).astype(np.float64)
    if not (array >= 0.0).all():
        raise ValueError("max_distance: expected numbers >= 0, got a negative one or NaN")
    if array.ndim == 0:
        return array.reshape(1)
    spread = broadcast("max_distance", array, shape, "the points' shape")
    return np.ascontiguousarray(spread).reshape(-1)
