"""Every CUDA kernel with arguments of the right types, to compile them without a GPU."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from raystream.cuda import hit_ids, packing
from raystream.cuda.builders import binary_tree, clusters, lists, refit, wide
from raystream.cuda.builders.graph import link_kernels, pruning, sectors, sharing
from raystream.cuda.builders.kdtree import blocks, numbering, partition, planes, write_tree
from raystream.cuda.bvh import pairs
from raystream.cuda.bvh.kernels import lay_out, layout_of, traced_as
from raystream.cuda.points import nearest_kernel
from raystream.cuda.programs import steps
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.records import aligned_dtype
from raystream.cuda.rendering import kernels
from raystream.cuda.structures import kernels_of
from raystream.jit.cuda import Compiled, RangeKernel, kernels_in
from raystream.jit.cuda.arguments import example_of
from raystream.jit.cuda.block_kernel import BlockKernel
from raystream.jit.cuda.radix_sort import sort_kernels
from raystream.jit.cuda.scan import scan_kernels
from raystream.kernels.hits import HitAddresses
from raystream.kernels.point_queries import NearestArrays, PointScene
from raystream.kernels.queries import CountAddresses, RayScene, RowAddresses
from raystream.kernels.ray_source import RaySource
from raystream.programs.decisions import Decision
from raystream.programs.loop_source import Goal
from raystream.scene.scene import Scene
from raystream.structures import STRUCTURES, names_with, options_of
from raystream.tracer.devices import build_on_cpu
from raystream.tracer.precision import float64_triangles

#: Compiles a kernel for GPUs of a capability.
Compiler = Callable[[tuple[int, int]], Compiled]

_AT = np.uint64(0)

#: Modules of kernels that do not depend on the structure, by group.
_MODULES = {
    "arrays": (hit_ids, packing),
    "programs": (steps,),
    "builds": (
        *(lists, binary_tree, clusters, wide, pairs, refit),
        *(planes, partition, numbering, write_tree, blocks),
        *(pruning, sectors, link_kernels, sharing),
    ),
    "rendering": (kernels,),
}


def shared_kernels(group: str) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels of ``"arrays"``, ``"programs"``, ``"builds"`` or ``"rendering"``, by name."""
    return kernels_in(*_MODULES[group])


def block_kernels() -> dict[str, BlockKernel]:
    """Kernels of scans and sorts, by name and bit width."""
    made = {}
    for dtype in ("uint32", "uint64"):
        made_of = {**scan_kernels(dtype)._asdict(), **sort_kernels(dtype)._asdict()}
        made.update({f"{name}_{dtype[4:]}": kernel for name, kernel in made_of.items()})
    return made


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
    triangles = scene.triangles if precision == "float32" else float64_triangles(scene.geometry)
    structure = build_on_cpu(options_of(name, options), triangles)
    answers = kernels_of(traced_as(structure), is_own=is_own)
    tree = lay_out(structure, is_own=is_own).tree
    tallies, hits = _AT if counters else None, example_of(HitAddresses)
    shared = RayScene(example_of(RaySource), structure.frame, tree, _AT, tallies, None)
    arguments: dict[str, tuple[Any, ...]] = {
        "first_hit": (shared, hits),
        "any_hit": (shared, _AT),
        "count_hits": (shared, CountAddresses(True, _AT, _AT)),
        "multi_hit": (shared._replace(status=None), RowAddresses(True, _AT, hits, _AT)),
    }
    return {query: (getattr(answers, query), own) for query, own in arguments.items()}


def scenes_of_kinds(scene: Scene) -> dict[str, Scene]:
    """A scene of each kind that has kernels of its own, made of a scene's meshes."""
    return {
        "instances": Scene.instances(scene, [np.eye(3, 4)]),
        "primitives": Scene.combine([scene, Scene.spheres([[0.0, 0.0, 0.0]], 1.0)]),
    }


def point_kernels(scene: Scene) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels that find closest points, by structure, with arguments of the right types."""
    to = NearestArrays(*[_AT] * 6)
    kinds = {f", {kind}": held.triangles for kind, held in scenes_of_kinds(scene).items()}
    stores = {"": scene.triangles, **kinds, ", float64": float64_triangles(scene.geometry)}
    made = {}
    for (kind, store), name in product(stores.items(), names_with("nearest search")):
        structure = build_on_cpu(options_of(name), store)
        shared = structure.frame, structure.point_view, _AT, _AT, None
        points = PointScene(_AT, _AT, _AT, *shared)
        made[name + kind] = nearest_kernel(traced_as(structure)), (points, to)
    return made


def _add_up(hit: Any, payload: Any) -> Any:
    """Add up the length inside meshes, up to the eighth crossing."""
    payload.crossings += 1
    if hit.is_entering:
        payload.inside -= hit.t
    else:
        payload.inside += hit.t
    return Decision.STOP if payload.crossings == 8 else Decision.CONTINUE


def _is_solid(hit: Any) -> Any:
    return hit.mesh_id != 0


def program_kernels() -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """Kernels of a program and of a filter, by goal."""
    record = aligned_dtype(np.dtype([("crossings", "i4"), ("inside", "f8")])), 1
    programs = {"trace": DeviceProgram(_add_up, "trace", record=record)}
    goals: tuple[Goal, ...] = "first", "count", "keep"
    for goal in goals:
        programs[f"filter, {goal}"] = DeviceProgram(_is_solid, goal, skips=True)
    return {name: (program.kernel, program.typical()) for name, program in programs.items()}


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
    for group in _MODULES:
        listed |= {(group, name): one for name, one in shared_kernels(group).items()}
    listed |= {("programs", name): one for name, one in program_kernels().items()}
    made: dict[tuple[str, str], Compiler] = {
        key: partial(kernel.compiled, arguments) for key, (kernel, arguments) in listed.items()
    }
    return made | {("builds", name): one.compiled for name, one in block_kernels().items()}
