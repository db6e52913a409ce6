"""What each kind of scene supports, as one table; and the error where it does not."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from raystream.core.errors import RaystreamError

if TYPE_CHECKING:
    from raystream.core.store import Store

#: Kinds of scene besides triangles in float32: what is said of each where it is not supported.
#: A scene may be of several; those in worlds also have instances.
REFUSALS: Mapping[str, str] = MappingProxyType(
    {
        "instances": "not supported in a scene with instances; scene.flattened() is the same scene "
        "without them, if it fits into memory",
        "worlds": "not supported in a scene whose instances are in worlds; make a scene of the "
        "instances of one world",
        "primitives": "not supported in a scene with spheres or height fields",
        "float64": "not supported with precision='float64'",
    }
)

_ALL = tuple(REFUSALS)
_PLACED = ("instances", "worlds")

#: Features by name, as errors name them, with the kinds that have them. Triangles in float32 have
#: all; a feature that is not listed here is theirs alone.
SUPPORTED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "structure='bvh'": _ALL,
        "structure='brute'": _ALL,
        "device='cpu', machine='branching'": _ALL,
        "device='cuda', machine='branching'": _ALL,
        "device='graphics', machine='compute'": _PLACED,
        "counters=True": (*_PLACED, "primitives"),
        "on_hit, skip_prim_ids": _ALL,
        "trace": _ALL,
        "render": ("instances", "primitives"),
        "lidar_returns": ("instances", "primitives"),
        "visibility": ("instances", "primitives", "float64"),
        "points on surfaces": _PLACED,
        "surface_points": _PLACED,
        "out": _PLACED,
        "query_zarr": ("instances",),
        "thickness": ("instances",),
        "visible_faces": ("instances",),
    }
)


def is_supported(feature: str, store: Store | type[Store]) -> bool:
    """Whether a scene with this store has a feature."""
    return set(store.kinds) <= set(SUPPORTED.get(feature, ()))


def check_support(
    feature: str, store: Store | type[Store], error: type[Exception] = RaystreamError
) -> None:
    """Check that a scene has a feature.

    Parameters
    ----------
    feature : str
        Named as in `SUPPORTED`.
    store : Store, or class of them
        The scene's.
    error : type of Exception
        What is raised: ValueError where an argument asks for the feature.

    Raises
    ------
    RaystreamError, or what `error` is
        If it has not. The text names the feature, and other values of the argument that work.
    """
    for kind in store.kinds:
        if kind not in SUPPORTED.get(feature, ()):
            argument = feature.partition("=")[0] + "="
            others = [
                one for one in SUPPORTED if one.startswith(argument) and is_supported(one, store)
            ]
            instead = f"; use {' or '.join(others)}" if others else ""
            raise error(f"{feature}: {REFUSALS[kind]}{instead}")
