"""Shapes of users: their parameters, their boxes, and points on them by two numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from raystream.core.masks import ALL_BITS, as_mask
from raystream.core.rays import as_integers
from raystream.core.triangles import MAX_COORDINATE

#: The most crossings that a ray may have with one shape.
MOST_HITS = 32

#: Steps in which the place of a hit is told along each axis of a shape's box.
PLACE_STEPS = 2**21

#: Finite float32 that are neither zero nor subnormal. u and v are such numbers, see `places_of`.
CODES = 254 * 2**24

#: Crossings beside a shape's box by less than this part of its longest side count.
SLACK = 2.0**-20


#: Lines that are tried to find a point of a shape; and their steps across its box, in proportions
#: that spread them evenly.
_LINES, _ACROSS = 32, np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])


#: Arguments of users' functions, by what these are for.
ARGUMENTS: Mapping[str, tuple[str, ...]] = {
    "bounds": ("record",),
    "intersect": ("record", "origin", "direction", "span", "t"),
    "normal": ("record", "point"),
    "distance": ("record", "point"),
}


def place_of(role: str, function: Callable[..., Any]) -> str:
    """What errors call a user's function: its role, name, file and line."""
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    if code is None:
        raise TypeError(f"{role}: expected a Python function, got {type(function).__name__}")
    place = f"{role}: {code.co_name} ({code.co_filename}, line {code.co_firstlineno})"
    if code.co_argcount != len(ARGUMENTS[role]) or code.co_kwonlyargcount:
        given = ", ".join(code.co_varnames[: code.co_argcount])
        raise TypeError(f"{place}: takes ({given}); expected ({', '.join(ARGUMENTS[role])})")
    return place


class Functions(Protocol):
    """The functions of a kind of shapes, compiled: see `scene.shape.Shape`."""

    name: str
    hits: int
    has_distance: bool

    def records_of(
        self, records: NDArray[np.void], bounds: NDArray[np.float64] | None = None
    ) -> NDArray[np.void]:
        """The shapes as kernels read them, for numbers to be added; the caller keeps `records`."""

    def bounds_of(self, records: NDArray[np.void]) -> NDArray[np.float64]:
        """Boxes of shapes, (N, 2, 3)."""

    def normals_at(self, shapes: Shapes, rows: Any, points: NDArray[Any]) -> NDArray[np.float64]:
        """Unit normals of shapes at points of shape (N, 3), world space."""

    def crossings_at(self, shapes: Shapes, rows: Any, rays: NDArray[Any]) -> NDArray[np.float64]:
        """Distances of the crossings of lines with shapes, (N, hits), increasing; NaN for none."""

    def distances_at(self, shapes: Shapes, rows: Any, points: NDArray[Any]) -> NDArray[np.float64]:
        """Signed distances of points of shape (N, 3) from shapes, world space."""

    def place(self, role: str) -> str:
        """What errors call a function, by its parameter of `Shape`."""

    def raise_faults(self) -> None:
        """Raise what went wrong in calls since the last time, if anything did."""

    def identity(self) -> str:
        """A text that is another one for other functions."""


@dataclass(frozen=True)
class Shapes:
    """Shapes of one kind, world space.

    Attributes
    ----------
    functions : Functions
        Of `Shape.compiled`.
    records : ndarray of shape (N,)
        Their parameters.
    bounds : ndarray of shape (N, 2, 3), float64
    material_ids : ndarray of shape (N,), int32
    mask : int
    """

    functions: Functions
    records: NDArray[np.void]
    bounds: NDArray[np.float64]
    material_ids: NDArray[np.int32]
    mask: int

    @classmethod
    def of(cls, shape: Any, records: Any, material_ids: Any = 0, mask: int = ALL_BITS) -> Shapes:
        """Check the arguments of `Scene.shapes`, and copy them."""
        array = np.array(records)
        if array.dtype.fields is None or array.dtype.hasobject or array.ndim > 1:
            raise TypeError(
                "records: expected a structured array of numbers of shape (N,), one record for "
                f"each shape, got dtype {array.dtype} and shape {array.shape}"
            )
        array = array.reshape(-1).astype(array.dtype.newbyteorder("="), copy=False)
        ids = as_integers("material_ids", material_ids)
        if ids.shape not in ((), array.shape):
            raise ValueError(
                f"material_ids: expected one number or shape {array.shape}, got {ids.shape}"
            )
        if ids.size and not (ids.min() >= 0 and ids.max() < 2**31):
            raise ValueError("material_ids: expected numbers of materials, from 0")
        functions = shape.compiled(array.dtype)
        bounds = functions.bounds_of(array)
        with np.errstate(invalid="ignore"):
            is_sound = (np.abs(bounds) <= MAX_COORDINATE).all(axis=(1, 2))
            is_sound &= (bounds[:, 0] <= bounds[:, 1]).all(axis=1)
        if not is_sound.all():
            bad = int(np.argmin(is_sound))
            low, high = bounds[bad].tolist()
            raise ValueError(
                f"{functions.place('bounds')}: bounds of record {bad} are {low} to {high}; "
                "expected finite coordinates, at most 2**200, the low ones first"
            )
        ids = np.broadcast_to(ids, array.shape).astype(np.int32)
        return cls(functions, array, bounds, ids, as_mask("mask", mask))

    def __len__(self) -> int:
        return len(self.records)

    @property
    def bounds_of_all(self) -> NDArray[np.float64]:
        """The box around all shapes, at least one, of shape (2, 3)."""
        return np.array([self.bounds[:, 0].min(axis=0), self.bounds[:, 1].max(axis=0)])

    def points_at(
        self, rows: NDArray[np.int64], u: NDArray[Any], v: NDArray[Any]
    ) -> NDArray[np.float64]:
        """The points of shapes that u and v stand for, shape (N, 3), world space.

        They are within 2**-22 of the box's sides of what was hit; NaN if u is NaN.
        """
        number = _code_of(u) * np.uint64(CODES) + _code_of(v)
        mask = np.uint64(PLACE_STEPS - 1)
        steps = np.stack([(number >> np.uint64(k)) & mask for k in (42, 21, 0)], axis=-1)
        low, high = self.bounds[rows, 0], self.bounds[rows, 1]
        points: NDArray[np.float64]
        points = low + (steps.astype(np.float64) + 0.5) * ((high - low) / PLACE_STEPS)
        points[np.isnan(u)] = np.nan
        return points

    def surface_at(
        self, rows: NDArray[np.int64], u: NDArray[Any], v: NDArray[Any]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The points of the surface next to those that u and v stand for, and unit normals."""
        points = self.points_at(rows, u, v)
        normals = self.functions.normals_at(self, rows, points)
        # Where there is none, such as at a tip: away from the middle of the box.
        none = np.flatnonzero(~np.isfinite(normals).all(axis=1) & ~np.isnan(u))
        away = points[none] - self.bounds[rows[none]].mean(axis=1)
        away[~away.any(axis=1), 2] = 1.0
        normals[none] = away / np.linalg.norm(away, axis=1, keepdims=True)
        lines = np.concatenate([points, normals], axis=1)
        t = self.functions.crossings_at(self, rows, lines)
        nearest = np.take_along_axis(t, np.nan_to_num(np.abs(t), nan=np.inf).argmin(1)[:, None], 1)
        sizes = np.ptp(self.bounds[rows], axis=1).max(axis=1, keepdims=True, initial=0.0)
        # Without a crossing there, such as at an edge, the point is left where it is.
        points += np.where(np.abs(nearest) <= SLACK * sizes, nearest, 0.0) * normals
        return points, normals

    def points_toward(
        self, rows: NDArray[np.int64], eyes: NDArray[np.float64], number: int
    ) -> NDArray[np.float64]:
        """Points of shapes that are the nearest ones of them on lines from eyes; NaN if not found.

        Parameters
        ----------
        rows : ndarray of shape (N,)
        eyes : ndarray of shape (N, 3)
            World space.
        number : int
            Which lines are tried first: of 0, those to the middle of the box.
        """
        points = np.full((len(rows), 3), np.nan)
        left = np.arange(len(rows))
        for k in range(number, number + _LINES):
            low, high = self.bounds[rows[left]].swapaxes(0, 1)
            origins, share = eyes[left], (0.5 + k * _ACROSS) % 1.0
            directions = low + share * (high - low) - origins
            rays = np.concatenate([origins, directions], axis=1)
            found = self.functions.crossings_at(self, rows[left], rays)
            t = np.nanmin(np.where(found >= 0.0, found, np.inf), axis=1, initial=np.inf)
            is_found = np.isfinite(t)
            at = left[is_found]
            points[at] = origins[is_found] + t[is_found, None] * directions[is_found]
            left = left[~is_found]
        return points

    def places_of(
        self, rows: NDArray[np.int64], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The u and v of points of shape (N, 3).

        A point is told as a step of 2**21 along each axis of its shape's box. These 63 bits are
        two codes, and code k is the float32 of the bits k // 2 + 2**23, with k % 2 as its sign.
        """
        low, high = self.bounds[rows, 0], self.bounds[rows, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            steps = np.nan_to_num((points - low) * (PLACE_STEPS / (high - low)))
        x, y, z = np.clip(steps, 0, PLACE_STEPS - 1).astype(np.uint64).T
        number = (x << np.uint64(42)) | (y << np.uint64(21)) | z
        u, v = np.divmod(number, np.uint64(CODES))
        codes = _number_of(u), _number_of(v)
        codes[0][np.isnan(points).any(axis=1)] = np.nan
        return codes


def _code_of(numbers: NDArray[Any]) -> NDArray[np.uint64]:
    bits = np.ascontiguousarray(numbers, np.float32).view(np.uint32).astype(np.uint64)
    size = (bits & np.uint64(2**31 - 1)) - np.uint64(2**23)
    return (size << np.uint64(1)) | (bits >> np.uint64(31))


def _number_of(codes: NDArray[np.uint64]) -> NDArray[np.float32]:
    bits = ((codes >> np.uint64(1)) + np.uint64(2**23)) | ((codes & np.uint64(1)) << np.uint64(31))
    return bits.astype(np.uint32).view(np.float32)
