"""Users' functions of shapes, compiled to be called by address; and what is said if they fail."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.core.shapes import Shapes, place_of
from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.fingerprint import fingerprint
from raystream.jit.intrinsics import record_at
from raystream.jit.simd import square_root, store
from raystream.jit.threads import parallel_for
from raystream.jit.user_loops import Loop, checked_device, compile_loop
from raystream.jit.user_results import accept
from raystream.kernels.shapes import (
    FAULTS,
    KIND,
    NOT_A_NUMBER,
    ROLES,
    SHAPE,
    ShapeRecord,
    call_for_rows,
    forget,
    load_three,
    note_fault,
    settle,
    span_of,
    store_three,
)

#: The type of each function's result.
_POINT = ("float64",) * 3
_RESULTS = {"bounds": (_POINT, _POINT), "intersect": "int64", "normal": _POINT}

#: Statements that call each function. `own` is the shape, `given` the address of a ray or point.
_STATEMENTS = {
    "bounds": (
        "low, high = accept(function(record))",
        "store_three(out, *low)",
        "store_three(out + size, *high)",
    ),
    "intersect": (
        "origin, direction = load_three(given), load_three(given + size)",
        "span = span_of(own, origin, direction)",
        "if not span[0] <= span[1]:",
        "    return zero",
        "forget(out, most)",
        "count = accept(function(record, origin, direction, span, numbers_at(out, zero)))",
        "return settle(faults, own, int64(count), most, span, out)",
    ),
    "normal": (
        "x, y, z = accept(function(record, load_three(given)))",
        "length = square_root(float64(x * x + y * y + z * z))",
        "store_three(out, x / length, y / length, z / length)",
    ),
    "distance": (
        "distance = float64(accept(function(record, load_three(given))))",
        "if distance != distance:",
        "    note_fault(faults, not_a_number, own)",
        "store(out, distance)",
    ),
}

#: Differences of distances are over this part of the box's longest side.
_STEP = np.float64(2.0**-17)

#: Shapes per call of a loop.
_ROWS = 1 << 12


def _gradient() -> tuple[str, ...]:
    """Statements for the normal by the differences of a distance."""
    ends = (
        "x + h, y, z",
        "x - h, y, z",
        "x, y + h, z",
        "x, y - h, z",
        "x, y, z + h",
        "x, y, z - h",
    )
    at = [f"accept(function(record, ({one})))" for one in ends]
    return (
        "(x, y, z), (a, b, c), (d, e, f) = load_three(given), own.low, own.high",
        "h = max(max(d - a, e - b), f - c) * step",
        *(f"d{k} = {at[2 * k]} - {at[2 * k + 1]}" for k in range(3)),
        "length = square_root(d0 * d0 + d1 * d1 + d2 * d2)",
        "store_three(out, d0 / length, d1 / length, d2 / length)",
    )


def _compiled(
    role: str, function: Callable[..., Any], dtype: np.dtype[Any], hits: int, is_distance: bool
) -> Loop:
    """The code of a function; for normals, `is_distance` says that it is one of distances."""
    statements = _gradient() if is_distance else _STATEMENTS[role]
    kind = hashlib.sha256(f"{dtype.descr} {dtype.itemsize} {hits}".encode()).hexdigest()
    lines = [
        f"# {role} {kind[:32]}",
        "def loop(faults, shape, given, out):",
        "    own = Shape(shape)",
        "    record = record_at(own.record, zero)",
        *(f"    {line}" for line in statements),
        *([] if role == "intersect" else ["    return one"]),
    ]
    names = {
        "accept": accept("float64" if is_distance else _RESULTS.get(role, "float64"), "it"),
        "float64": np.float64,
        "forget": forget,
        "int64": np.int64,
        "load_three": load_three,
        "most": np.uint64(hits),
        "not_a_number": NOT_A_NUMBER,
        "note_fault": note_fault,
        "numbers_at": record_at(np.dtype("f8"), hits),
        "one": ONE_U64,
        "record_at": record_at(dtype, 0),
        "settle": settle,
        "Shape": ShapeRecord,
        "size": np.uint64(24),
        "span_of": span_of,
        "square_root": square_root,
        "step": _STEP,
        "store": store,
        "store_three": store_three,
        "zero": ZERO_U64,
    }
    return compile_loop("\n".join(lines) + "\n", checked_device(function), names, __name__)


class CompiledFunctions:
    """The functions of shapes whose parameters are records of a type, see `core.shapes.Functions`.

    Parameters
    ----------
    shape : Shape
    dtype : dtype
        Of a record.

    Attributes
    ----------
    shape : Shape
    kind : ndarray of `KIND`, of shape (1,)

    Raises
    ------
    TypeError
        If a function cannot be compiled, or returns what it must not.
    """

    def __init__(self, shape: Any, dtype: np.dtype[Any]) -> None:
        self.shape, self.dtype = shape, dtype
        self.name, self.hits, self.has_distance = shape.name, shape.hits, shape.distance is not None
        given = {role: getattr(shape, role) for role in ("bounds", *ROLES)}
        own = {role: one for role, one in given.items() if one is not None}
        by_distance = "normal" not in own
        if by_distance:
            own["normal"] = shape.distance
        self._places = {
            role: place_of("distance" if role == "normal" and by_distance else role, one)
            for role, one in own.items()
        }
        self._faults = np.zeros(len(ROLES) + 1, FAULTS)
        self.kind = np.zeros(1, KIND)
        self.kind["faults"] = self._faults.ctypes.data
        self._loops, self._codes = {}, {}
        for role, one in own.items():
            loop = _compiled(role, one, dtype, self.hits, role == "normal" and by_distance)
            try:
                self._codes[role] = np.uint64(loop.address_of(("uint64",) * 4))
            except TypeError as error:
                reason = str(error).partition(": ")[2]
                raise TypeError(f"{self._places[role]}: {reason}") from error
            self._loops[role] = loop
            if role in ROLES:
                self.kind[role] = self._codes[role]

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledFunctions, (self.shape, self.dtype)

    def place(self, role: str) -> str:
        """What errors call a function."""
        return self._places[role]

    def identity(self) -> str:
        """A text that is another one for other functions; without their names if it can be."""
        prints = [fingerprint(getattr(self.shape, role) or len) for role in ("bounds", *ROLES)]
        return f"{self.name if None in prints else ''} {prints} {self.hits}"

    def records_of(
        self, records: NDArray[np.void], bounds: NDArray[np.float64] | None = None
    ) -> NDArray[np.void]:
        """The shapes as kernels read them, for numbers to be added; the caller keeps `records`."""
        made = np.zeros(len(records), SHAPE)
        made["record"] = records.ctypes.data + np.arange(len(records)) * records.itemsize
        made["kind"], made["row"] = self.kind.ctypes.data, np.arange(len(records))
        if bounds is not None:
            made["low"], made["high"] = bounds[:, 0], bounds[:, 1]
        return made

    def _call(
        self, role: str, made: NDArray[np.void], given: NDArray[Any] | None, out: NDArray[Any]
    ) -> NDArray[np.uint64]:
        """Call a function for each shape, and row of `given`: it writes the rows of `out`.

        Returns its results.
        """
        at = (0, 0) if given is None else (given.ctypes.data, given.strides[0])
        index = ROLES.index(role) if role in ROLES else len(ROLES)
        first = self._faults[index:].ctypes.data, made.ctypes.data
        places = tuple(np.array(one, np.uint64) for one in (at, (out.ctypes.data, out.strides[0])))
        counts = np.zeros(len(made), np.uint64)
        arguments = self._codes[role], *np.array(first, np.uint64), *map(tuple, places), counts
        parallel_for(lambda a, b: call_for_rows(a, b, *arguments), len(made), _ROWS)
        self.raise_faults()
        return counts

    def bounds_of(self, records: NDArray[np.void]) -> NDArray[np.float64]:
        """Boxes of shapes, (N, 2, 3)."""
        bounds = np.zeros((len(records), 2, 3))
        self._call("bounds", self.records_of(records), None, bounds)
        return bounds

    def normals_at(self, shapes: Shapes, rows: Any, points: NDArray[Any]) -> NDArray[np.float64]:
        """Unit normals of shapes at points of shape (N, 3), world space."""
        return self._at_points("normal", shapes, rows, points, np.zeros((len(points), 3)))

    def crossings_at(self, shapes: Shapes, rows: Any, rays: NDArray[Any]) -> NDArray[np.float64]:
        """Distances of the crossings of lines with shapes, (N, hits), increasing; NaN for none.

        Lines are origins and directions, of shape (N, 6), world space.
        """
        found = np.zeros((len(rays), self.hits))
        made = self.records_of(shapes.records, shapes.bounds)[rows]
        counts = self._call("intersect", made, np.ascontiguousarray(rays, np.float64), found)
        found[np.arange(self.hits) >= counts[:, None]] = np.nan
        return found

    def distances_at(self, shapes: Shapes, rows: Any, points: NDArray[Any]) -> NDArray[np.float64]:
        """Signed distances of points of shape (N, 3) from shapes, world space."""
        return self._at_points("distance", shapes, rows, points, np.zeros((len(points), 1)))[:, 0]

    def _at_points(
        self, role: str, shapes: Shapes, rows: Any, points: NDArray[Any], out: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        made = self.records_of(shapes.records, shapes.bounds)[rows]
        self._call(role, made, np.ascontiguousarray(points, np.float64), out)
        return out

    def raise_faults(self) -> None:
        """Raise what went wrong in calls since the last time, if anything did.

        Raises
        ------
        RaystreamError
        """
        if not self._faults.view(np.uint64).any():
            return
        found = self._faults.copy()
        self._faults[:] = 0
        for (raised, fault), role in zip(found.tolist(), (*ROLES, "bounds"), strict=True):
            if not (raised or fault):
                continue
            place = self._places[role]
            if raised:
                wrong = "raised an exception"
                if role == "intersect":
                    wrong += f", perhaps by writing more than the {self.hits} distances of hits="
            elif fault & 3 == int(NOT_A_NUMBER):
                done = "returned" if role == "distance" else "wrote no distance, or"
                wrong = f"{done} a distance that is NaN, for record {fault >> 2}"
            else:
                wrong = f"returned a number that is not 0 to {self.hits}, for record {fault >> 2}"
            raise RaystreamError(f"{place}: {wrong}")
