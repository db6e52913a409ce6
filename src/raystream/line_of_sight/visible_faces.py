"""Which faces a camera or a point sees."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_least
from raystream.core.instances import moved
from raystream.core.memory import check_memory
from raystream.core.rays import as_vector
from raystream.core.scene_kinds import check_support
from raystream.core.spheres import numbers_toward
from raystream.jit.threads import Progress
from raystream.line_of_sight.end_points import check_tracer, end_points, is_clear
from raystream.line_of_sight.image_frame import seen_from
from raystream.line_of_sight.surface_points import surface_points
from raystream.programs.cutouts import cutouts_of
from raystream.rendering.arguments import check_size
from raystream.scene.camera import Camera
from raystream.tracer import Tracer

__all__ = ["VisibleFaces", "visible_faces"]

#: Most rays that are traced at once.
_BLOCK = 1 << 18

#: Bytes of a face that is counted; and, of other kinds than plain triangles, looked for.
_COUNT_BYTES, _LOOKING_BYTES = 9, 34

#: Additive recurrence in two dimensions with low discrepancy: powers of the inverse of the
#: plastic number, the root of x**3 = x + 1.
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])


class VisibleFaces(NamedTuple):
    """The faces that are seen.

    Attributes
    ----------
    prim_ids : ndarray of shape (K,), int32
        Triangles, counted over the whole scene, increasing.
    pixel_counts : ndarray of shape (K,), int64
        Pixels at whose centre each is seen; 0 for those that only additional rays found.
    instance_ids : ndarray of shape (K,), int32
        The instance that each is in, increasing, and `prim_ids` within each; 0 in a scene without
        instances.
    """

    prim_ids: NDArray[np.int32]
    pixel_counts: NDArray[np.int64]
    instance_ids: NDArray[np.int32]


def visible_faces(
    tracer: Tracer,
    camera: Any = None,
    size: tuple[int, int] = (1024, 768),
    *,
    points_per_face: int = 1,
    cutouts: bool = True,
    progress: Progress | None = None,
) -> VisibleFaces:
    """Find the triangles that a camera sees, and the number of pixels that each covers.

    Parameters
    ----------
    tracer : Tracer
    camera : Camera, or array_like of shape (3,), real, optional
        A point stands for an equirectangular camera there, which looks in all directions; `size`
        should then be twice as wide as high [default: the scene's camera]. A camera with a lens
        sees from the lens's centre.
    size : tuple of two int
        Width and height of the image in pixels.
    points_per_face : int
        Points of each triangle, its centre first (of a sphere, the point nearest the camera; of a
        shape, where a line from there to the middle of its box meets it), whose visibility is
        tested if the triangle covers no pixel's centre; 0 tests none.
    cutouts : bool
        Whether a surface is neither seen nor hides anything where it is cut out: where the opacity
        of its material is below its ``alpha_cutoff``, or below a half without one. False makes all
        of it surface.
    progress : callable, optional
        Called with (rays done, rays): the number of rays may fall after the image.

    Returns
    -------
    VisibleFaces

    Raises
    ------
    ValueError, TypeError
        If an argument has the wrong shape, type or range; or if there are cut-outs, and the tracer
        counts.
    MemoryError
        If the counts do not fit into memory.

    Notes
    -----
    No triangle that is the nearest at a pixel's centre is missed: one ray is traced through each
    centre, as from `Camera.rays`, and rays neither pass between triangles nor miss small ones (of
    triangles that coincide there, the lowest number is seen). Both sides of triangles are visible.

    Triangles that cover no pixel's centre, because they are small or nearly hidden, are tested
    with additional rays: they are seen if one of their `points_per_face` points is in the image,
    and `visibility` finds that the eye sees it. So no triangle whose centre is visible is missed.
    A triangle is missed if only parts of it between these points and the pixels' centres are
    visible: more pixels or points find it.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> seen = rs.visible_faces(tracer, size=(200, 200))
    >>> len(seen.prim_ids), tracer.scene.triangle_count, int(seen.pixel_counts.sum())
    (22, 36, 37390)
    """
    check_tracer(tracer)
    width, height = check_size(size)
    camera = _as_camera(tracer, camera, width / height)
    points = check_least("points_per_face", points_per_face, 0)
    triangles: Any = tracer.structure.triangles
    check_support("visible_faces", triangles)
    count = triangles.number_count
    needed = _LOOKING_BYTES if triangles.kinds and points else _COUNT_BYTES
    check_memory(needed * count, f"counts of {count:,} faces would")
    opacity = cutouts_of(tracer, cutouts)
    on_hit = opacity and opacity.on_hit
    counts = np.zeros(count, np.int64)
    rows = max(_BLOCK // width, 1)
    total = width * height
    x = np.arange(width) + 0.5
    for first in range(0, height, rows):
        y = np.arange(first, min(first + rows, height))[:, None] + 0.5
        hits = tracer.first_hit(*camera.rays(width, height, x, y), on_hit=on_hit)
        found = triangles.numbers_of(hits.prim_id, hits.instance_id)
        ids, pixels = np.unique(found[found >= 0], return_counts=True)
        counts[ids] += pixels
        if progress:
            progress(min(first + rows, height) * width, total)
    is_seen = counts > 0
    if points:
        _look_for_others(tracer, camera, (width, height), points, is_seen, opacity, progress)
    numbers = np.flatnonzero(is_seen)
    prim_ids, instance_ids = triangles.ids_of(numbers.astype(np.int32))
    if instance_ids is None:
        instance_ids = np.zeros_like(prim_ids)
    return VisibleFaces(prim_ids, counts[numbers], instance_ids)


def _as_camera(tracer: Tracer, camera: Any, aspect: float) -> Camera:
    if camera is None:
        return tracer.scene.camera_for(aspect)
    if isinstance(camera, Camera):
        return camera
    try:
        eye = np.array(as_vector("camera", camera), np.float64)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{error}; give a Camera or a point") from None
    if not np.isfinite(eye).all():
        raise ValueError(f"camera: expected finite coordinates, got {camera!r}")
    ahead = [0.0, 0.0, -max(1.0, float(np.abs(eye).max()))]
    return Camera(tuple(eye), tuple(eye + ahead), (0.0, 1.0, 0.0), projection="equirectangular")


def _look_for_others(
    tracer: Tracer,
    camera: Camera,
    size: tuple[int, int],
    points: int,
    is_seen: NDArray[np.bool_],
    opacity: Any,
    progress: Progress | None,
) -> None:
    """Trace rays to points of the faces that are not seen yet."""
    triangles: Any = tracer.structure.triangles
    others = triangles.face_numbers()
    others = others[~is_seen[others]]
    pixels = size[0] * size[1]
    total = pixels + points * len(others)
    for number in range(points):
        others = others[~is_seen[others]]
        u, v = _weights(number)
        for begin in range(0, len(others), _BLOCK):
            faces = others[begin : begin + _BLOCK]
            prim_ids, instance_ids = triangles.ids_of(faces.astype(np.int32))
            at: tuple[Any, Any] = (u, v)
            if triangles.has_primitives:
                at = _nearest_points(camera, size, triangles, (prim_ids, instance_ids), at, number)
            centers = surface_points(tracer, prim_ids, *at, instance_ids)
            stops = end_points("faces", centers, None, triangles)
            origins, is_inside = seen_from(camera, size, stops.positions)
            is_inside &= stops.is_valid
            if opacity:
                is_inside &= opacity.at(prim_ids, centers.u, centers.v)
            inside = np.flatnonzero(is_inside)
            if len(inside):
                starts = end_points("eyes", origins[inside], None, triangles)
                on_hit = opacity and opacity.on_hit
                clear = is_clear(tracer, starts, stops.at(inside), False, on_hit)
                is_seen[faces[inside[clear]]] = True
            if progress:
                progress(min(pixels + number * len(others) + begin + len(faces), total), total)
    if progress:
        progress(total, total)


def _nearest_points(
    camera: Camera,
    size: tuple[int, int],
    triangles: Any,
    ids: tuple[NDArray[np.int32], NDArray[np.int32] | None],
    otherwise: tuple[float, float],
    number: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The u and v of points of this number.

    Of spheres, the first are those nearest the camera, in instances as the object sees it. Of
    shapes, they are where lines from the camera meet them. Others are as given.
    """
    rows = triangles.sphere_rows(ids[0])
    u, v = (np.full(len(rows), one) for one in otherwise)
    for shapes, at, own in triangles.shape_rows(ids[0]):
        eyes, _ = seen_from(camera, size, shapes.bounds[own].mean(axis=1))
        u[at], v[at] = shapes.places_of(own, shapes.points_toward(own, eyes, number))
    if number:
        return u, v
    is_sphere = rows >= 0
    centers, placed = triangles.spheres.centers[rows[is_sphere]], triangles.instances
    if placed is None or ids[1] is None:
        eyes, _ = seen_from(camera, size, centers)
    else:
        found = ids[1][is_sphere]
        eyes, _ = seen_from(camera, size, moved(placed.transforms[found], centers))
        eyes = moved(placed.inverses[found], eyes)
    u[is_sphere], v[is_sphere] = numbers_toward(eyes - centers)
    return u, v


def _weights(number: int) -> tuple[float, float]:
    """Weights of vertices 1 and 2 for a point of a triangle; number 0 is the centre."""
    if number == 0:
        return 1.0 / 3.0, 1.0 / 3.0
    u, v = (0.5 + number * _STEPS) % 1.0
    return (u, v) if u + v <= 1.0 else (1.0 - u, 1.0 - v)
