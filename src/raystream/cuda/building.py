"""Who builds a structure for the CUDA device: the CPU, or the device itself."""

from __future__ import annotations

from typing import Any

from raystream import structures
from raystream.core.triangles import Triangles
from raystream.cuda.machines import open_device
from raystream.jit.threads import Progress
from raystream.structures import Structure

__all__ = ["BUILT_ON_DEVICE", "build_structure"]

#: Structures that the device can build.
BUILT_ON_DEVICE = ("bvh", "graph", "grid", "kdtree")


def build_structure(
    name: str,
    triangles: Triangles,
    *,
    progress: Progress | None = None,
    build: str = "host",
    gpu: int = 0,
    **options: Any,
) -> Structure:
    """Build a structure by name.

    Parameters
    ----------
    name : str
        See `structures.build_structure`.
    triangles : Triangles
    progress : callable, optional
        Called with (triangles placed, triangles); once, at the end, by the device.
    build : {"host", "device"}
        Who builds it. A device keeps what it built; the host gets a copy when it needs one.
    gpu : int
        Which device.
    **options
        Of the structure: see the functions `build_bvh`, `build_graph`, `build_grid` and
        `build_kdtree` of `cuda.builders`.

    Raises
    ------
    ValueError
        If a name is unknown, an option's value is out of range, or the device cannot build it.
    TypeError
        If the structure has no such option.
    CudaError
        If the device has no memory for it.
    """
    if build == "host":
        return structures.build_structure(name, triangles, progress=progress, **options)
    if build != "device":
        raise ValueError(f"build: expected 'host' or 'device', got {build!r}")
    if name not in BUILT_ON_DEVICE:
        known = ", ".join(map(repr, BUILT_ON_DEVICE))
        raise ValueError(f"build: 'device' builds {known}, not {name!r}; use build='host'")
    from raystream.cuda.builders import BUILDERS

    builder, own = BUILDERS[name]
    for option in options:
        if option not in own:
            has = ", ".join(own)
            raise TypeError(f"{name}: build='device' has no option {option!r}; it has {has}")
    made = builder(open_device(gpu), triangles, **options)
    if progress:
        progress(len(triangles), len(triangles))
    return made
