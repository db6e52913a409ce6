"""Shape: a kind of geometry that a user writes, as functions in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.core.shapes import ARGUMENTS, MOST_HITS, Shapes, place_of

__all__ = ["Shape"]

_Function = Callable[..., Any]


class Shape:
    """A kind of geometry, written as functions in Python that Numba compiles.

    `Scene.shapes` makes a scene of shapes of a kind: one for each record of a structured array,
    which the functions get as their first argument.

    Parameters
    ----------
    bounds : callable
        ``bounds(record)`` returns ``(x, y, z), (x, y, z)``: the low and high corners of a box
        around the shape. What is outside of it does not exist.
    intersect : callable
        ``intersect(record, origin, direction, span, t)`` writes the distances at which a line
        crosses the shape to the array `t`, in any order, and returns their number. All crossings
        within ``span[0] <= distance <= span[1]`` are needed, also those behind the origin; others
        are left out. `span` is the part of the line within the box.
    distance : callable, optional
        ``distance(record, point)``: how far a point is from the surface; negative inside. Needed
        for closest points and inside tests. A shape with it is a closed solid. The largest of two
        distances, as for a difference, is a bound and not enough.
    normal : callable, optional
        ``normal(record, point)`` returns ``(x, y, z)``: a vector of any length, perpendicular to
        the surface at a point on it, pointing outwards [default: the gradient of `distance`].
        Beside `distance`, it is called elsewhere, too: it then points away from the surface's
        nearest point, or toward it from inside.
    hits : int
        The most crossings of a line with a shape, and the length of `t`: at most 32.
    name : str, optional
        For errors, and as the name of the shapes' mesh [default: that of `intersect`].

    Attributes
    ----------
    bounds, intersect, distance, normal, hits, name
        As given.

    Raises
    ------
    TypeError
        If there is neither `distance` nor `normal`, or one is not a function of these arguments.
        `Scene.shapes` raises it for functions that cannot be compiled, with name, file and line.
    ValueError
        If `hits` is not 1 to 32.

    Notes
    -----
    Points and vectors are tuples of three float64, in world space. The largest component of
    `direction` is between 1 and 2, and distances are in its lengths. Functions must return the same
    for the same arguments, and call no functions in Python but those that Numba has compiled.

    Distances are rounded to float32 once, in the scene's frame. Hits are ordered by t, then
    prim_id, like those of all geometry; and crossings of a shape, where t is equal, as they are
    along the line.

    Where `normal` is zero or NaN, such as at a tip, hits have a normal away from the middle of the
    box. A distance that is NaN is an error.

    u and v of a hit are two numbers that say where in the shape's box it is, to 2**-22 of the box's
    sides. `Hits.positions` follows from them, and `Hits.normals` from `normal` there.

    Examples
    --------
    >>> import numpy as np
    >>> import raystream as rs
    >>> def bounds(disc):
    ...     x, y, z = disc.center
    ...     return (x - disc.radius, y - disc.radius, z), (x + disc.radius, y + disc.radius, z)
    >>> def intersect(disc, origin, direction, span, t):
    ...     if direction[2] == 0.0:
    ...         return 0
    ...     t[0] = (disc.center[2] - origin[2]) / direction[2]
    ...     x = origin[0] + t[0] * direction[0] - disc.center[0]
    ...     y = origin[1] + t[0] * direction[1] - disc.center[1]
    ...     return 1 if x * x + y * y <= disc.radius**2 else 0
    >>> def normal(disc, point):
    ...     return 0.0, 0.0, 1.0
    >>> disc = rs.Shape(bounds, intersect, normal=normal, hits=1)
    >>> discs = np.zeros(2, [("center", "f8", 3), ("radius", "f8")])
    >>> discs["center"], discs["radius"] = [[0, 0, 5], [0, 0, 9]], 1.0
    >>> hits = rs.Tracer(rs.Scene.shapes(disc, discs)).multi_hit([0, 0, 0], [0, 0, 1])
    >>> hits.t.tolist(), hits.prim_id.tolist()
    ([5.0, 9.0], [0, 1])
    """

    def __init__(
        self,
        bounds: _Function,
        intersect: _Function,
        distance: _Function | None = None,
        normal: _Function | None = None,
        *,
        hits: int = 2,
        name: str = "",
    ) -> None:
        if distance is None and normal is None:
            raise TypeError("normal: expected a function, or one for distance=")
        if hits not in range(1, MOST_HITS + 1):
            raise ValueError(f"hits: expected an integer from 1 to {MOST_HITS}, got {hits!r}")
        self.bounds, self.intersect = bounds, intersect
        self.distance, self.normal = distance, normal
        for role in ARGUMENTS:
            if getattr(self, role) is not None:
                place_of(role, getattr(self, role))
        self.hits = int(hits)
        self.name = name or getattr(intersect, "__name__", "shape")
        self._compiled: dict[str, Any] = {}

    def compiled(self, dtype: np.dtype[Any]) -> Any:
        """The functions, compiled for records of a type; see `core.shapes.Functions`."""
        key = f"{dtype.descr} {dtype.itemsize}"
        if key not in self._compiled:
            # Here, not above: it loads the compiler.
            from raystream.kernels.shape_functions import CompiledFunctions

            self._compiled[key] = CompiledFunctions(self, dtype)
        return self._compiled[key]

    def check(self, records: Any, *, lines: int = 64, seed: int = 0) -> None:
        """Look for mistakes in the functions, with lines through each shape and beside it.

        Parameters
        ----------
        records : array_like of shape (N,), structured
            As for `Scene.shapes`.
        lines : int
            For each shape; half of them are parallel to axes.
        seed : int

        Raises
        ------
        ValueError
            If a crossing is outside the bounds of its shape, has no normal, or has a distance other
            than 0; or if a distance is larger than that of a crossing, or does not lead to the
            surface. The text has the function's name, file and line, the record's number, and the
            crossing.
        RaystreamError
            If a function fails, see `Scene.shapes`.
        """
        # Here, not above: few programs need it.
        from raystream.scene.shape_check import check_shapes

        check_shapes(Shapes.of(self, records), lines, seed)

    def __reduce__(self) -> tuple[Any, ...]:
        given = self.bounds, self.intersect, self.distance, self.normal
        return _restored, (given, self.hits, self.name)

    def __repr__(self) -> str:
        return f"Shape({self.name!r}, hits={self.hits})"


def _restored(given: tuple[Any, ...], hits: int, name: str) -> Shape:
    return Shape(*given, hits=hits, name=name)
