"""How programs and filters read the hits of each kind of scene."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from raystream.core.store import Store
from raystream.programs.float64_hits import Float64At, float64_hit_of
from raystream.programs.hits import SceneAt, hit_of
from raystream.programs.placed import (
    PlacedAt,
    is_placed_skipped,
    placed_float64_hit_of,
    placed_hit_of,
    placed_primitive_hit_of,
)
from raystream.programs.primitive_hits import PrimitivesAt, primitive_hit_of
from raystream.programs.rows import is_skipped


def _as_it_is(function: Any) -> Any:
    return function


class SceneForm(NamedTuple):
    """How loops around users' functions read hits.

    Attributes
    ----------
    heading : str
        Of their source: they are known by their text, which has to say what it is for.
    addresses : type of NamedTuple
        Its fields are uint64. ``of(store)`` returns one, and what to keep alive.
    hit_of : device function
        ``hit_of(ray, t, u, v, number, rays, position, scene)`` makes a `Hit`, see `hits.hit_of`, of
        the number that kernels give it.
    is_skipped : device function
        ``is_skipped(skips, ray, hit)``, for a `SkipsAt`.
    skips_in_traversal : bool
        Whether these numbers are prim_ids, so that traversals can skip them.
    of_rows : callable
        Turns a function of rows of float32 into one of the scene's rows.
    """

    heading: str
    addresses: Any
    hit_of: Any
    is_skipped: Any = is_skipped
    skips_in_traversal: bool = False
    of_rows: Callable[[Any], Any] = _as_it_is


TRIANGLES = SceneForm("", SceneAt, hit_of, skips_in_traversal=True)
_PLACED = SceneForm("# with instances\n", PlacedAt, placed_hit_of, is_placed_skipped)
_PLACED_PRIMITIVES = _PLACED._replace(
    heading="# with instances of primitives\n", hit_of=placed_primitive_hit_of
)
_PRIMITIVES = SceneForm("# with primitives\n", PrimitivesAt, primitive_hit_of)


@cache
def _float64() -> SceneForm:
    rows = importlib.import_module("raystream.geometry.float64.rows")
    copy = rows.rows_of_float64({}).of
    return SceneForm(
        "# in float64\n", Float64At, float64_hit_of, skips_in_traversal=True, of_rows=copy
    )


@cache
def _placed_float64() -> SceneForm:
    heading = "# with instances in float64\n"
    of_rows = _float64().of_rows
    return _PLACED._replace(heading=heading, hit_of=placed_float64_hit_of, of_rows=of_rows)


def form_of(store: Store) -> SceneForm:
    """How programs read the hits of a scene."""
    if store.instances is not None:
        if store.number_type is np.float64:
            return _placed_float64()
        return _PLACED_PRIMITIVES if store.has_primitives else _PLACED
    if store.has_primitives:
        return _PRIMITIVES
    return _float64() if "float64" in store.kinds else TRIANGLES
