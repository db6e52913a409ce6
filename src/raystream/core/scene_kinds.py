"""What each kind of scene supports, as one table; and the error where it does not."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from raystream.core.errors import RaystreamError

if TYPE_CHECKING:
    from raystream.core.store import Store

#: Kinds of scene besides triangles in float32: what is said of each where it is not supported.
#: A scene may be of several; those in worlds, and of placed kinds, also have instances.
REFUSALS: Mapping[str, str] = MappingProxyType(
    {
        "instances": "not supported in a scene with instances; scene.flattened() is the same scene "
        "without them, if it fits into memory",
        "worlds": "not supported in a scene whose instances are in worlds; use in_world of the "
        "tracer or the scene",
        "spheres": "not supported in a scene with spheres",
        "fields": "not supported in a scene with height fields",
        "shapes": "not supported in a scene with shapes of users",
        "shapes without distance": "not supported in a scene with shapes without distance=",
        "float64": "not supported with precision='float64'",
        "placed float64": "not supported in a scene with instances and precision='float64'",
        "placed spheres": "not supported in a scene with instances of spheres",
        "placed fields": "not supported in a scene with instances of height fields",
    }
)

#: What is said of a device and machine that do not support a feature, before their names.
MACHINE_REFUSAL = "not supported with"

_ALL = tuple(REFUSALS)
_PLACED = ("instances", "worlds")
_SHAPES = ("shapes", "shapes without distance")
_PRIMITIVES = ("spheres", "fields", *_SHAPES)
_BOTH = ("placed spheres", "placed fields")
_ONE = ("instances", "spheres", "fields", "float64")
_NO_SHAPES = (*_ONE, *_BOTH, "placed float64")
_ONE_WORLD = (*_NO_SHAPES, *_SHAPES)
_WITH_DISTANCE = tuple(one for one in _ALL if one != "shapes without distance")

# Why a kind of scene lacks a feature.
_SETS = "worlds are sets of instances"
_DEVICE = "in instances, its kernels find triangles in float32 alone"
_HOST = "the functions of shapes are compiled for the CPU"
_AREAS = "it needs the area of each shape, which nothing tells"
_SLOPES = "u and v of hits on shapes are codes, which have no derivatives"
_INSIDE = "it follows each test of a ray, and those of shapes are within users' functions"
_CODE = "a cluster sends arrays to its workers, and no code"
_NEAREST = (
    "in instances, it searches triangles in float32 alone; a stretched sphere is an ellipsoid, "
    "whose closest points have no closed form"
)


class Feature(NamedTuple):
    """Which kinds of scene have a feature.

    Attributes
    ----------
    kinds : tuple of str
        Those that have it. Triangles in float32 have all features.
    row : str
        Its calls, as the documentation names them; empty if its table leaves the feature out.
    reason : str
        Why the others lack it.
    notes : mapping of str to str
        By kind, what the documentation says instead of yes.
    """

    kinds: tuple[str, ...]
    row: str = ""
    reason: str = ""
    notes: Mapping[str, str] = MappingProxyType({})


_DISTANCE = MappingProxyType({"shapes": "with ``distance=``"})

#: Features by name, as errors name them, in the order of the documentation's table. A feature that
#: is not listed here is of triangles in float32 alone.
FEATURES: Mapping[str, Feature] = MappingProxyType(
    {
        "queries": Feature(
            _ALL, "`first_hit`, `any_hit`, `multi_hit`, `count_hits`, `memory_needed`"
        ),
        "cast": Feature(_ALL, "`cast`"),
        "structure='bvh'": Feature(_ALL),
        "structure='brute'": Feature(_ALL),
        "device='cpu', machine='branching'": Feature(_ALL),
        "precision='float64'": Feature(("instances", "worlds", "float64", "placed float64")),
        "device='cuda', machine='branching'": Feature(
            (*_ONE, "worlds"), '``device="cuda"``', f"{_DEVICE}; {_HOST}"
        ),
        "device='graphics', machine='compute'": Feature(_PLACED),
        "worlds": Feature(
            (*_PLACED, *_BOTH, "placed float64"), "``worlds=``, `Tracer.in_world`", _SETS
        ),
        "counters=True": Feature(_ALL, "``counters=True``"),
        "on_hit, skip_prim_ids": Feature(_ALL, "``on_hit=``, ``skip_prim_ids=``"),
        "trace": Feature(_ALL, "`Tracer.trace`"),
        "mask": Feature(_ALL, "``mask=``"),
        "update": Feature(
            _ALL,
            "`Tracer.update`",
            notes={
                **dict.fromkeys(
                    ("instances", "placed spheres", "placed fields", "placed float64"),
                    "transforms, camera, lights",
                ),
                "spheres": "a scene of as many",
                "fields": "a scene of as many samples",
                "shapes": "a scene of as many",
            },
        ),
        "render": Feature(_ONE_WORLD, "`render`"),
        "materials that are not opaque": Feature(
            _ALL, "`render`, with materials that are not opaque"
        ),
        "heatmap": Feature(_ONE_WORLD, "`heatmap`", _SETS),
        "lidar_returns": Feature(_ALL, "`lidar_returns`, `lidar_sweep`"),
        "thickness": Feature(_ALL, "`thickness`"),
        "visibility": Feature(_ONE_WORLD, "`visibility` between points"),
        "points on surfaces": Feature(_ALL, "`visibility` of hits"),
        "surface_points": Feature(_ALL, "`surface_points`"),
        "out": Feature(_ALL, "`visibility` with ``out=``"),
        "cutouts=True, with surfaces that are not opaque": Feature(_ALL, "cut-outs in analyses"),
        "visible_faces": Feature(_ONE_WORLD, "`visible_faces`"),
        "view_factors": Feature(_NO_SHAPES, "`view_factors`", _AREAS),
        "closest points": Feature(
            (*_ONE, "worlds", "shapes"),
            "`closest_point`, `signed_distance`",
            _NEAREST,
            notes=_DISTANCE,
        ),
        "inside tests": Feature(
            _WITH_DISTANCE,
            "`contains`",
            notes={
                **_DISTANCE,
                **dict.fromkeys(
                    ("fields", "placed fields"), '``method="winding"``: they are open surfaces'
                ),
            },
        ),
        "winding numbers": Feature(_WITH_DISTANCE, "`winding_number`", notes=_DISTANCE),
        "query_zarr": Feature(_ONE_WORLD, "`query_zarr`"),
        "save": Feature(
            _ALL, "`Tracer.save`, `Tracer.load`", notes={"shapes": "loaded with the scene"}
        ),
        "raystream.torch": Feature(_NO_SHAPES, "`raystream.torch`", _SLOPES),
        "raystream.jax": Feature(_NO_SHAPES, "`raystream.jax`", _SLOPES),
        "a cluster": Feature(_NO_SHAPES, "clusters", _CODE),
        "walk": Feature(_NO_SHAPES, "`raystream.stepper.walk`", _INSIDE),
    }
)

#: Without anything.
_NOTHING = Feature(())


def is_supported(feature: str, store: Store | type[Store]) -> bool:
    """Whether a scene with this store has a feature."""
    return set(store.kinds) <= set(FEATURES.get(feature, _NOTHING).kinds)


def check_support(
    feature: str, store: Store | type[Store], error: type[Exception] = RaystreamError
) -> None:
    """Check that a scene has a feature.

    Parameters
    ----------
    feature : str
        Named as in `FEATURES`.
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
        if kind not in FEATURES.get(feature, _NOTHING).kinds:
            argument = feature.partition("=")[0] + "="
            others = [
                one for one in FEATURES if one.startswith(argument) and is_supported(one, store)
            ]
            instead = f"; use {' or '.join(others)}" if others else ""
            raise error(f"{feature}: {REFUSALS[kind]}{instead}")
