"""Who builds a structure for the CUDA device: the CPU, or the device itself."""

from __future__ import annotations

import inspect

from raystream import structures
from raystream.core.choices import Cuda
from raystream.core.triangles import Triangles
from raystream.cuda.devices import open_device
from raystream.jit.threads import Progress
from raystream.structures import Structure, StructureOptions, form_of, names_with

__all__ = ["build_structure"]


def build_structure(
    structure: StructureOptions,
    triangles: Triangles,
    *,
    progress: Progress | None = None,
    device: Cuda | None = None,
) -> Structure:
    """Build a structure; a `machines.devices.DeviceFactory`.

    Parameters
    ----------
    structure : StructureOptions
    triangles : Triangles
    progress : callable, optional
        Called with (triangles placed, triangles); once, at the end, by the device.
    device : Cuda, optional
        Says who builds it. A device keeps what it built; the host gets a copy when it needs one.

    Raises
    ------
    ValueError
        If the device cannot build it with these options.
    TypeError
        If it is built in one way, and a method is given.
    CudaError
        If the device has no memory for it.
    """
    device = device or Cuda()
    if device.build == "host":
        return structures.build_structure(structure, triangles, progress=progress)
    name, build = structure.name, form_of(structure.name, "cuda build")
    if build is None:
        known = ", ".join(map(repr, names_with("cuda build")))
        raise ValueError(f"build: 'device' builds {known}, not {name!r}; use build='host'")
    more = {} if device.method is None else {"method": device.method}
    if more and "method" not in inspect.signature(build).parameters:
        raise TypeError(f"{name}: build='device' has no option 'method'")
    made: Structure = build(open_device(device.gpu), triangles, structure, **more)
    if progress:
        progress(len(triangles), len(triangles))
    return made
