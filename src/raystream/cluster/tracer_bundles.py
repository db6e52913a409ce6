"""Tracers in bundles: geometry and built structure as files have them, and the options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from raystream.cluster.bundles import Bundle
from raystream.cluster.errors import ClusterError
from raystream.cluster.scene_bundles import pack_scene, unpack_scene
from raystream.core.choices import MACHINES, Cpu, DeviceOptions
from raystream.core.options import Options
from raystream.core.scene_kinds import check_support
from raystream.scene.scene import Scene
from raystream.structures import STRUCTURES, StructureOptions
from raystream.structures.saved_stores import part_of, store_of
from raystream.structures.storage import named_arrays, structure_of
from raystream.tracer import Tracer
from raystream.tracer.devices import device_of
from raystream.tracer.precision import triangles_of


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
    store = geometry_of(scene, options)
    check_support("a cluster", store)
    header: dict[str, Any] = {"kinds": list(store.kinds)}
    # Other kinds of geometry than triangles in float32 are made of the scene, where that is sent.
    has_scene = for_rendering or (built is None and bool(store.kinds))
    is_made = has_scene and bool(store.kinds)
    arrays = {} if is_made else named_arrays(store, None if built is None else built.structure)
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
    header["is_built"] = built is not None
    if has_scene:
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
    kinds = header["kinds"]
    scene = unpack_scene(header["scene"], arrays) if "scene" in header else None
    try:
        if scene is not None and kinds:
            store = triangles_of(scene, "float64" if "float64" in " ".join(kinds) else "float32")
        else:
            store = store_of(kinds, part_of(arrays, "triangles"))
    except ValueError as error:
        raise ClusterError(f"received damaged geometry: {error}") from None
    if scene is not None and not kinds:
        scene = scene.moved(scene.meshes, store)
    if not header["is_built"]:
        scene = scene or Scene.from_triangles(store)
        options = {**header["options"]}
        if "machine" in options:
            options["machine"] = _unpacked(options["machine"], MACHINES)
        structure = _unpacked(header["structure"], STRUCTURES)
        device = header["device"]
        if not isinstance(device, str):
            device = _unpacked(device, {device["name"]: device_of(device["name"]).options})
        return Tracer(scene, structure, device, **options)
    try:
        chosen = _unpacked(header["structure"], STRUCTURES)
        built = structure_of(store, arrays, chosen)
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


def geometry_of(scene: Scene | Tracer, options: Mapping[str, Any]) -> Any:
    """The geometry that a tracer with these options traces."""
    if isinstance(scene, Tracer):
        return scene.structure.triangles
    return triangles_of(scene, options.get("precision", "float32"))
