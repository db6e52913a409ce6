"""Builds structures for the CUDA device, on the CPU or on the GPU."""

from __future__ import annotations

from typing import Any

from raystream.core.choices import Cuda
from raystream.core.scene_kinds import check_support
from raystream.cuda.devices import open_device
from raystream.jit.threads import Progress
from raystream.structures import Structure, StructureOptions, form_of, names_with
from raystream.tracer.devices import build_on_cpu


def build_structure(
    structure: StructureOptions,
    triangles: Any,
    *,
    progress: Progress | None = None,
    device: Cuda | None = None,
) -> Structure:
    """Build a structure; a `tracer.devices.DeviceFactory`.

    Parameters
    ----------
    structure : StructureOptions
    triangles : Store
    progress : callable, optional
        Called with (triangles placed, triangles); by the GPU once, at the end.
    device : Cuda, optional
        With ``build="device"`` the GPU builds it; the host copies the arrays when it needs them.

    Raises
    ------
    RaystreamError
        If the GPU is to build it, and the scene has instances, spheres or height fields, or the
        triangles are in float64.
    ValueError
        If the GPU does not build the structure, or not with these options.
    CudaError
        If the GPU runs out of memory.
    """
    device = device or Cuda()
    if device.build == "host":
        return build_on_cpu(structure, triangles, progress=progress)
    check_support("build='device'", triangles)
    name, build = structure.name, form_of(structure.name, "cuda build")
    if build is None:
        known = ", ".join(map(repr, names_with("cuda build")))
        raise ValueError(f"build: 'device' builds {known}, not {name!r}; use build='host'")
    made: Structure = build(open_device(device.gpu), triangles, structure)
    if progress:
        progress(len(triangles), len(triangles))
    return made
