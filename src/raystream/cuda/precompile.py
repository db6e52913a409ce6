"""Every CUDA kernel with arguments of the right types, to compile them without a GPU."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from raystream.cuda.builders.precompile import block_kernels, build_kernels
from raystream.cuda.bvh.kernels import lay_out, layout_of, traced_as
from raystream.cuda.hit_ids import HALVE, SPLIT, InstanceIds
from raystream.cuda.packing import DIRECTIONS, PACK
from raystream.cuda.points import nearest_kernel
from raystream.cuda.programs.precompile import program_kernels
from raystream.cuda.rendering.precompile import rendering_kernels
from raystream.cuda.structures import kernels_of
from raystream.jit.cuda import Compiled, RangeKernel
from raystream.kernels.hits import HitAddresses
from raystream.kernels.point_queries import NearestArrays, PointScene
from raystream.kernels.queries import CountAddresses, RayScene, RowAddresses
from raystream.kernels.ray_source import RaySource
from raystream.scene.scene import Scene
from raystream.structures import STRUCTURES, build_structure, names_with, options_of
from raystream.tracer.devices import build_on_cpu
from raystream.tracer.precision import float64_triangles

#: Compiles a kernel for GPUs of a capability.
Compiler = Callable[[tuple[int, int]], Compiled]

_AT = np.uint64(0)

_SOURCE = RaySource(_AT, _AT, False, _AT, _AT, False, _AT, _AT, _AT, _AT)

#: Kernels for rays in device arrays by name; they do not depend on the structure.
ARRAY_KERNELS: dict[str, tuple[RangeKernel, tuple[Any, ...]]] = {
    "split ids": (SPLIT, (InstanceIds(_AT, _AT, _AT, _AT), _AT, _AT)),
    "halve ids": (HALVE, (np.int32(0), _AT)),
    "pack": (PACK, (_AT, (_AT,) * DIRECTIONS, (_AT,) * DIRECTIONS, _AT, _AT, _AT, _AT, _AT)),
}


def structure_kernels(
    name: str,
    scene: Scene,
    *,
    counters: bool = False,
    is_own: bool = False,
    precision: str = "float32",
    **options: Any,
) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The query kernels of a structure, with arguments that have the right types only.

    Parameters
    ----------
    name : str
        Of the structure.
    scene : Scene
        Any, with instances or primitives or without; the structure is built for it.
    counters : bool
        Whether rays have counters.
    is_own : bool
        Whether a BVH has its own layout.
    precision : {"float32", "float64"}
    **options
        Options of the structure.

    Returns
    -------
    dict
        By query.
    """
    triangles = scene.triangles if precision == "float32" else float64_triangles(scene)
    structure = build_on_cpu(options_of(name, options), triangles)
    kernels = kernels_of(traced_as(structure), is_own=is_own)
    tree = lay_out(structure, is_own=is_own).tree
    tallies, hits = _AT if counters else None, HitAddresses(_AT, _AT, _AT, _AT)
    shared = RayScene(_SOURCE, structure.frame, tree, _AT, tallies, None)
    arguments: dict[str, tuple[Any, ...]] = {
        "first_hit": (shared, hits),
        "any_hit": (shared, _AT),
        "count_hits": (shared, CountAddresses(True, _AT, _AT)),
        "multi_hit": (shared._replace(status=None), RowAddresses(True, _AT, hits, _AT)),
    }
    return {query: (getattr(kernels, query), own) for query, own in arguments.items()}


def scenes_of_kinds(scene: Scene) -> dict[str, Scene]:
    """A scene of each kind that has kernels of its own, made of a scene's meshes."""
    return {
        "instances": Scene.instances(scene, [np.eye(3, 4)]),
        "primitives": Scene.combine([scene, Scene.spheres([[0.0, 0.0, 0.0]], 1.0)]),
    }


def point_kernels(scene: Scene) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels that find closest points, by structure, with arguments of the right types."""
    to = NearestArrays(*[_AT] * 6)
    made = {}
    for name in names_with("nearest search"):
        structure = build_structure(name, scene.triangles)
        tree = lay_out(structure).tree
        points = PointScene(_AT, _AT, _AT, structure.frame, tree, _AT, _AT, None)
        made[name] = nearest_kernel(name), (points, to)
    return made


def all_kernels(scene: Scene) -> dict[tuple[str, str], Compiler]:
    """All kernels: queries, points, programs, device arrays, builders and renderers.

    Parameters
    ----------
    scene : Scene
        Any.

    Returns
    -------
    dict
        By group and name: functions that compile a kernel for a compute capability.
    """
    ways: list[tuple[str, str, dict[str, Any]]] = [
        *((name, name, {}) for name in STRUCTURES),
        *(
            (f"{name}, own layout", name, {"is_own": True, "counters": True})
            for name in STRUCTURES
            if layout_of(name)
        ),
        *((f"{one}, float64", one, {"precision": "float64"}) for one in ("bvh", "brute")),
    ]
    listed = {
        (way, query): one
        for way, name, options in ways
        for query, one in structure_kernels(name, scene, **options).items()
    }
    for kind, held in scenes_of_kinds(scene).items():
        for name in ("bvh", "brute"):
            made_of = structure_kernels(name, held)
            listed |= {(f"{name}, {kind}", query): one for query, one in made_of.items()}
    listed |= {("points", name): one for name, one in point_kernels(scene).items()}
    listed |= {("arrays", name): one for name, one in ARRAY_KERNELS.items()}
    programs = program_kernels(scene.triangles)
    listed |= {("programs", name): one for name, one in programs.items()}
    listed |= {("builds", name): one for name, one in build_kernels().items()}
    listed |= {("rendering", name): one for name, one in rendering_kernels(scene).items()}
    made: dict[tuple[str, str], Compiler] = {
        key: partial(kernel.compiled, arguments) for key, (kernel, arguments) in listed.items()
    }
    return made | {("builds", name): one.compiled for name, one in block_kernels().items()}
