"""Tracers in bundles: triangles in their local frame, the built structure, and the options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.bundles import Bundle
from raystream.cluster.errors import ClusterError
from raystream.cluster.scene_bundles import pack_scene, unpack_scene
from raystream.core.choices import MACHINES, Cpu, DeviceOptions
from raystream.core.options import Options
from raystream.core.scene_kinds import check_support
from raystream.core.triangles import Triangles
from raystream.scene.scene import Scene
from raystream.structures import STRUCTURES, StructureOptions, structure_class
from raystream.tracer import Tracer
from raystream.tracer.devices import device_of


def pack_tracer(
    scene: Scene | Tracer,
    structure: str | StructureOptions,
    device: str | DeviceOptions,
    options: Mapping[str, Any],
    *,
    for_rendering: bool,
) -> Bundle:
    """Pack what workers need to trace a scene.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer's structure is sent as built, with the options of its machine.
    structure, device, options
        See `Tracer`. For the CPU, the structure is built here, once. On other devices, each
        worker builds its own.
    for_rendering : bool
        Whether to include materials, textures and lights.

    Raises
    ------
    ValueError, TypeError
        As `Tracer`.
    """
    built = scene if isinstance(scene, Tracer) else None
    if built is not None and (structure != "bvh" or device != "cpu" or options):
        raise ValueError("structure, device, options: cannot be combined with an existing Tracer")
    if options.get("counters") or (built is not None and built.is_counting):
        raise ValueError("counters: not supported on a cluster; use a local Tracer for them")
    if built is not None and built.device != "cpu":
        raise ValueError(
            f"scene: the tracer's device is {built.device!r}; pass its scene with structure, "
            "device and options instead: workers build their own structure"
        )
    if not isinstance(scene, Scene | Tracer):
        raise TypeError(f"scene: expected a Scene or Tracer, got {type(scene).__name__}")
    if built is None and (device == "cpu" or isinstance(device, Cpu)):
        built = Tracer(scene, structure, **options)  # type: ignore[arg-type]
    triangles = scene.structure.triangles if isinstance(scene, Tracer) else scene.triangles
    check_support("a cluster", triangles)
    header: dict[str, Any] = {}
    arrays = _pack_triangles(triangles)
    if built is None:
        machine = options.get("machine")
        header |= {
            "structure": _packed(structure),
            "device": _packed(device),
            "options": {**options, **({"machine": _packed(machine)} if machine else {})},
        }
    else:
        made = built.structure
        header |= {
            "structure": _packed(made.options),
            "device": "cpu",
            "options": {"machine": built.machine, **built.machine_options},
        }
        arrays |= {f"structure {n}": a for n, a in made.saved_arrays().items()}
    header["is_built"] = built is not None
    if for_rendering:
        header["scene"], own = pack_scene(scene.scene if isinstance(scene, Tracer) else scene)
        arrays |= own
    return Bundle(header, arrays)


def unpack_tracer(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Tracer:
    """Restore the tracer packed by `pack_tracer`.

    Raises
    ------
    ClusterError
        If an array is missing, or does not form a valid structure.
    RaystreamError
        If the worker lacks the device.
    """
    try:
        triangles = _unpack_triangles(arrays)
    except KeyError as error:
        raise ClusterError(f"a bundle lacks the array {error}") from None
    scene: Scene | None
    if "scene" in header:
        bare = unpack_scene(header["scene"], arrays)
        scene = bare.moved(bare.meshes, triangles)
    else:
        scene = None
    if not header["is_built"]:
        scene = scene or Scene.from_triangles(triangles)
        options = {**header["options"]}
        if "machine" in options:
            options["machine"] = _unpacked(options["machine"], MACHINES)
        structure = _unpacked(header["structure"], STRUCTURES)
        device = header["device"]
        if not isinstance(device, str):
            device = _unpacked(device, {device["name"]: device_of(device["name"]).options})
        return Tracer(scene, structure, device, **options)
    own = {
        name.removeprefix("structure "): array
        for name, array in arrays.items()
        if name.startswith("structure ")
    }
    try:
        chosen = _unpacked(header["structure"], STRUCTURES)
        built = structure_class(chosen.name).from_arrays(triangles, own, chosen)
    except ValueError as error:
        raise ClusterError(f"received a damaged structure: {error}") from None
    return Tracer.of_structure(built, scene, header["device"], **header["options"])


def _packed(choice: str | Options) -> Any:
    """Return a name or typed options as JSON has them."""
    return choice if isinstance(choice, str) else {"name": choice.name, "options": choice.as_json()}


def _unpacked(packed: Any, classes: Mapping[str, Any]) -> Any:
    """Undo `_packed`."""
    if isinstance(packed, str):
        return packed
    return classes[packed["name"]].from_json(packed["options"])


def pack_scene_for(scene: Scene) -> Bundle:
    """Pack a scene alone, to update a tracer that workers already have."""
    header, arrays = pack_scene(scene)
    return Bundle({"scene": header}, arrays)


def unpack_scene_from(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Scene:
    """Restore the scene packed by `pack_scene_for`, or that of a tracer's bundle."""
    return unpack_scene(header["scene"], arrays)


def _pack_triangles(triangles: Triangles) -> dict[str, NDArray[Any]]:
    return {
        "triangles corners": triangles.corners,
        "triangles mesh_splits": triangles.mesh_splits,
        "triangles center": triangles.center,
        "triangles scale": np.array([float(triangles.scale)]),
    }


def _unpack_triangles(arrays: Mapping[str, NDArray[Any]]) -> Triangles:
    return Triangles.from_local(
        arrays["triangles corners"],
        arrays["triangles mesh_splits"],
        arrays["triangles center"],
        float(arrays["triangles scale"][0]),
    )
