"""Filters that traversals call where they find a hit, compiled to be called by address.

The code is that of the user's function alone: the traversals, which call it with numbers, are
compiled once for all filters. What else it may read, and its constants, lie in a row of 8-byte
numbers, its context.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.store import Store
from raystream.jit.simd import count_trailing_zeros, load
from raystream.jit.user_loops import Loop, compile_loop
from raystream.jit.user_results import accept_decision
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.ray_source import RaySource
from raystream.programs.decisions import Decision
from raystream.programs.filter_context import (
    CONSTANTS,
    DIRECTIONS,
    SCENE,
    lane_at,
    rays_of,
    scene_place,
    scene_source,
    skips_of,
)
from raystream.programs.program import check_function
from raystream.programs.rows import SkipsAt
from raystream.programs.scene_forms import SceneForm, form_of

#: Arguments of a filter's code: its context, and those of `hit_filter.kept_hits`.
_TYPES = ("uint64", "uint64", "uint64", "int32", "uint64")

_NUMBERS = (np.float32, np.float64, np.complex64, np.complex128)
_INTEGERS = (np.int8, np.int16, np.int32, np.int64, np.uint8, np.uint16, np.uint32, np.uint64)


class FilterAtHits:
    """A filter as traversals take it.

    Parameters
    ----------
    function : callable or None
        The user's function; None if rays only skip triangles.
    skipped : ndarray of shape (N, k) or (N, k, 2), int32, or None
        Triangles that each ray skips; see `rows.skipped_triangles`.
    constants : tuple or None
        The function's second argument.
    triangles : Store
    rays : RayBatch

    Raises
    ------
    TypeError
        If the function is not one of a `Hit`, and of constants if there are any, or cannot be
        compiled.
    """

    def __init__(
        self,
        function: Any,
        skipped: NDArray[np.int32] | None,
        constants: tuple[Any, ...] | None,
        triangles: Store,
        rays: RayBatch,
    ) -> None:
        source, self._kept = RaySource.of(rays.origins, rays.directions, rays.limits)
        reader = _Reader()
        text = "" if constants is None else reader.read(constants)
        self._context = np.zeros(CONSTANTS + len(reader.values), np.uint64)
        form = form_of(triangles)
        scene, arrays = form.addresses.of(triangles)
        row = np.array(scene, np.uint64)
        self._scene_arrays = row, arrays
        skips = SkipsAt.nowhere() if skipped is None else SkipsAt.of(skipped)
        self._context[SCENE:DIRECTIONS] = row.ctypes.data, *skips
        if not form.skips_in_traversal:  # the filter itself does
            skips = SkipsAt.nowhere()
        directions = source.directions, source.direction_step, source.directions_are_double
        self._context[DIRECTIONS:CONSTANTS] = directions
        for k, value in enumerate(reader.values, CONSTANTS):
            self._context[k : k + 1].view(value.dtype)[0] = value
        self._skipped = skipped
        code = 0
        if function is not None:
            check_function(function, "first", constants is not None)
            self._loop = _compile(function, text, reader.classes, form)
            code = self._loop.address_of(_TYPES)
        context = self._context.ctypes.data
        self.addresses = HitFilter(*np.array((code, context, *skips, 0, 0), np.uint64))

    @property
    def has_raised(self) -> bool:
        """Whether the function raised at a hit; then the query's results are not valid."""
        return bool(self._context[0])


class _Reader:
    """Source that reads constants from a context.

    Attributes
    ----------
    values : list of NumPy numbers
        In the order of the context.
    classes : dict
        Classes of named tuples, by their names in the source.
    """

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.classes: dict[str, Any] = {}

    def read(self, value: Any) -> str:
        """An expression for a number or a tuple."""
        if not isinstance(value, tuple):
            return self._read_number(value)
        parts = [self.read(one) for one in value]
        if not hasattr(value, "_fields"):
            return f"({', '.join([*parts, ''])})"
        name = f"Tuple{len(self.classes)}"
        self.classes[name] = type(value)
        return f"{name}({', '.join(parts)})"

    def _read_number(self, value: Any) -> str:
        number: Any = np.asarray(value)[()]
        if isinstance(number, np.complexfloating):
            parts = self._read_number(number.real), self._read_number(number.imag)
            return f"{number.dtype.name}(complex({', '.join(parts)}))"
        at = f"context + uint64({8 * (CONSTANTS + len(self.values))})"
        if isinstance(number, np.bool_):
            self.values.append(np.uint64(number))
            return f"(load(uint64, {at}) != uint64(0))"
        if type(number) not in _NUMBERS + _INTEGERS:
            raise TypeError(f"constants: expected numbers and tuples of numbers, got {value!r:.60}")
        self.values.append(number)
        return f"load({number.dtype.name}, {at})"


def _compile(function: Any, constants: str, classes: dict[str, Any], form: SceneForm) -> Loop:
    """The code of a filter; `constants` is an expression, or empty if it takes none."""
    skips = "" if form.skips_in_traversal else "is_skipped(skips_of(context), ray, hit) or "
    arguments = ", ".join(filter(None, ("hit", constants)))
    known = [
        f"# {name}: {one.__module__}.{one.__qualname__} {one._fields}"
        for name, one in classes.items()
    ]
    lines = [
        "def loop(context, bits, hits, prim_id, first):",
        *(f"    {line}" for line in known),
        "    at, rays, kept = scene_place(context), rays_of(context), bits",
        f"    scene = {scene_source(form.addresses._fields)}",
        "    while bits != zero:",
        "        lane = count_trailing_zeros(bits)",
        "        bits &= bits - one",
        "        ray, (t, u, v) = first + lane, lane_at(hits, lane)",
        "        hit = hit_of(ray, t, u, v, prim_id, rays, ray, scene)",
        f"        if {skips}accept(function({arguments})) == ignore:",
        "            kept ^= one << lane",
        "    return kept",
    ]
    names = {
        "accept": accept_decision(Decision, True),
        "count_trailing_zeros": count_trailing_zeros,
        "hit_of": form.hit_of,
        "ignore": np.int64(Decision.IGNORE),
        "is_skipped": form.is_skipped,
        "lane_at": form.of_rows(lane_at),
        "load": load,
        "one": np.uint64(1),
        "rays_of": rays_of,
        "Scene": form.addresses,
        "scene_place": scene_place,
        "skips_of": skips_of,
        "zero": np.uint64(0),
        **{number.__name__: number for number in _NUMBERS + _INTEGERS},
        **classes,
    }
    return compile_loop(form.heading + "\n".join(lines) + "\n", function, names, __name__)
