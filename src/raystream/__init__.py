"""raystream: a programmable ray tracing engine in which rays are streams.

>>> import raystream as rs
>>> scene = rs.load("cornell")
>>> tracer = rs.Tracer(scene)
>>> hits = tracer.first_hit([278.0, 273.0, -800.0], [0.0, 0.0, 1.0])
>>> float(hits.t)
1091.9...
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from raystream._version import __version__

if TYPE_CHECKING:
    from raystream import cluster, streams
    from raystream.core.errors import (
        FileFormatError,
        LoopLimitError,
        RaystreamError,
        RaystreamWarning,
    )
    from raystream.core.hits import Hits, MultiHits
    from raystream.core.rays import RayStatus
    from raystream.jit.threads import set_thread_count, thread_count
    from raystream.machines.devices import register_device
    from raystream.physics.attenuation import attenuation
    from raystream.physics.lidar import LidarReturns, lidar_returns
    from raystream.physics.segments import thickness
    from raystream.physics.thickness import Thickness, UnpairedKind
    from raystream.programs.decisions import CONTINUE, IGNORE, STOP, Decision
    from raystream.programs.hits import Hit
    from raystream.rendering.frames import render_frames
    from raystream.rendering.heatmap import Heatmap, RayCost, heatmap
    from raystream.rendering.image import Image
    from raystream.rendering.picture import MODES, render
    from raystream.scene import textures
    from raystream.scene.animation import Animation
    from raystream.scene.camera import Camera
    from raystream.scene.camera_track import CameraTrack
    from raystream.scene.lights import AreaLight, DirectionalLight, EnvironmentLight, PointLight
    from raystream.scene.load import load
    from raystream.scene.material import Material
    from raystream.scene.mesh import Mesh
    from raystream.scene.scene import Scene
    from raystream.scene.texture import Texture
    from raystream.structures.base import UpdateReport
    from raystream.tracer import Tracer
    from raystream.viewer.notebook import view
    from raystream.zarr_queries.query import QueryReport, query_zarr

#: Modules as a whole.
_MODULES = {
    "cluster": "cluster",
    "streams": "streams",
    "textures": "scene.textures",
}

# Names are imported when they are first used: `import raystream` costs neither numba nor
# Pillow, and a command that only prints help stays quick.
_HOMES = {
    "CONTINUE": "programs.decisions",
    "IGNORE": "programs.decisions",
    "MODES": "rendering.picture",
    "STOP": "programs.decisions",
    "Animation": "scene.animation",
    "AreaLight": "scene.lights",
    "Camera": "scene.camera",
    "CameraTrack": "scene.camera_track",
    "Decision": "programs.decisions",
    "DirectionalLight": "scene.lights",
    "EnvironmentLight": "scene.lights",
    "FileFormatError": "core.errors",
    "Heatmap": "rendering.heatmap",
    "Hit": "programs.hits",
    "Hits": "core.hits",
    "Image": "rendering.image",
    "LidarReturns": "physics.lidar",
    "LoopLimitError": "core.errors",
    "Material": "scene.material",
    "Mesh": "scene.mesh",
    "MultiHits": "core.hits",
    "PointLight": "scene.lights",
    "QueryReport": "zarr_queries.query",
    "RayCost": "rendering.heatmap",
    "RayStatus": "core.rays",
    "RaystreamError": "core.errors",
    "RaystreamWarning": "core.errors",
    "Scene": "scene.scene",
    "Texture": "scene.texture",
    "Thickness": "physics.thickness",
    "Tracer": "tracer",
    "UnpairedKind": "physics.thickness",
    "UpdateReport": "structures.base",
    "attenuation": "physics.attenuation",
    "heatmap": "rendering.heatmap",
    "lidar_returns": "physics.lidar",
    "load": "scene.load",
    "query_zarr": "zarr_queries.query",
    "register_device": "machines.devices",
    "render": "rendering.picture",
    "render_frames": "rendering.frames",
    "set_thread_count": "jit.threads",
    "thickness": "physics.segments",
    "thread_count": "jit.threads",
    "view": "viewer.notebook",
}

__all__ = [
    "CONTINUE",
    "IGNORE",
    "MODES",
    "STOP",
    "Animation",
    "AreaLight",
    "Camera",
    "CameraTrack",
    "Decision",
    "DirectionalLight",
    "EnvironmentLight",
    "FileFormatError",
    "Heatmap",
    "Hit",
    "Hits",
    "Image",
    "LidarReturns",
    "LoopLimitError",
    "Material",
    "Mesh",
    "MultiHits",
    "PointLight",
    "QueryReport",
    "RayCost",
    "RayStatus",
    "RaystreamError",
    "RaystreamWarning",
    "Scene",
    "Texture",
    "Thickness",
    "Tracer",
    "UnpairedKind",
    "UpdateReport",
    "__version__",
    "attenuation",
    "cluster",
    "heatmap",
    "lidar_returns",
    "load",
    "query_zarr",
    "register_device",
    "render",
    "render_frames",
    "set_thread_count",
    "streams",
    "textures",
    "thickness",
    "thread_count",
    "view",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"raystream.{_MODULES[name]}")
    if name not in _HOMES:
        raise AttributeError(f"module 'raystream' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"raystream.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
