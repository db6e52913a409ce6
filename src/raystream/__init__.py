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
    from raystream.core.choices import Branching, Compute, Cpu, Cuda, Graphics, Multipass
    from raystream.core.closest_points import ClosestPoints
    from raystream.core.errors import FileFormatError, RaystreamError, RaystreamWarning
    from raystream.core.hits import Hits, MultiHits
    from raystream.core.ray_hit import RayHit
    from raystream.core.rays import RayStatus
    from raystream.jit.threads import set_thread_count, thread_count
    from raystream.line_of_sight.surface_points import surface_points
    from raystream.line_of_sight.view_factors import view_factors
    from raystream.line_of_sight.visibility import visibility
    from raystream.line_of_sight.visible_faces import visible_faces
    from raystream.physics import sweep_patterns
    from raystream.physics.attenuation import attenuation
    from raystream.physics.lidar import lidar_returns
    from raystream.physics.segments import thickness
    from raystream.physics.sweeps import lidar_sweep
    from raystream.physics.terrain import terrain
    from raystream.programs.decisions import Decision
    from raystream.ray_files.query import query_zarr
    from raystream.rendering.frames import render_frames
    from raystream.rendering.heatmap import heatmap
    from raystream.rendering.image import Image
    from raystream.rendering.render import MODES, render
    from raystream.rendering.video import write_video
    from raystream.scene import textures
    from raystream.scene.animation import Animation
    from raystream.scene.camera import Camera
    from raystream.scene.camera_track import CameraTrack
    from raystream.scene.daylight import daylight
    from raystream.scene.lights import DirectionalLight, EnvironmentLight, PointLight, SpotLight
    from raystream.scene.load import load
    from raystream.scene.material import Material
    from raystream.scene.mesh import Mesh
    from raystream.scene.scene import Scene
    from raystream.scene.sensor_track import SensorTrack
    from raystream.scene.shape import Shape
    from raystream.scene.texture import Texture
    from raystream.structures.brute.options import Brute
    from raystream.structures.bvh.options import Bvh
    from raystream.structures.graph.options import Graph
    from raystream.structures.grid.options import Grid
    from raystream.structures.kdtree.options import KdTree
    from raystream.structures.registry import StructureOptions, register_structure
    from raystream.tracer import Tracer
    from raystream.viewer.notebook import view
    from raystream.web.export import export_page

#: Modules as a whole.
_MODULES = {
    "cluster": "cluster",
    "streams": "streams",
    "sweep_patterns": "physics.sweep_patterns",
    "textures": "scene.textures",
}

# Names are imported when they are first used: `import raystream` costs neither numba nor
# Pillow, and a command that only prints help stays quick.
_HOMES = {
    name: home
    for home, names in {
        "core.choices": "Branching Compute Cpu Cuda Graphics Multipass",
        "core.closest_points": "ClosestPoints",
        "core.errors": "FileFormatError RaystreamError RaystreamWarning",
        "core.hits": "Hits MultiHits",
        "core.ray_hit": "RayHit",
        "core.rays": "RayStatus",
        "jit.threads": "set_thread_count thread_count",
        "line_of_sight.surface_points": "surface_points",
        "line_of_sight.view_factors": "view_factors",
        "line_of_sight.visibility": "visibility",
        "line_of_sight.visible_faces": "visible_faces",
        "physics.attenuation": "attenuation",
        "physics.lidar": "lidar_returns",
        "physics.segments": "thickness",
        "physics.sweeps": "lidar_sweep",
        "physics.terrain": "terrain",
        "programs.decisions": "Decision",
        "ray_files.query": "query_zarr",
        "rendering.frames": "render_frames",
        "rendering.heatmap": "heatmap",
        "rendering.image": "Image",
        "rendering.render": "MODES render",
        "rendering.video": "write_video",
        "scene.animation": "Animation",
        "scene.camera": "Camera",
        "scene.camera_track": "CameraTrack",
        "scene.daylight": "daylight",
        "scene.lights": "DirectionalLight EnvironmentLight PointLight SpotLight",
        "scene.load": "load",
        "scene.material": "Material",
        "scene.mesh": "Mesh",
        "scene.scene": "Scene",
        "scene.sensor_track": "SensorTrack",
        "scene.shape": "Shape",
        "scene.texture": "Texture",
        "structures.brute.options": "Brute",
        "structures.bvh.options": "Bvh",
        "structures.graph.options": "Graph",
        "structures.grid.options": "Grid",
        "structures.kdtree.options": "KdTree",
        "structures.registry": "StructureOptions register_structure",
        "tracer": "Tracer",
        "viewer.notebook": "view",
        "web.export": "export_page",
    }.items()
    for name in names.split()
}

__all__ = [
    "MODES",
    "Animation",
    "Branching",
    "Brute",
    "Bvh",
    "Camera",
    "CameraTrack",
    "ClosestPoints",
    "Compute",
    "Cpu",
    "Cuda",
    "Decision",
    "DirectionalLight",
    "EnvironmentLight",
    "FileFormatError",
    "Graph",
    "Graphics",
    "Grid",
    "Hits",
    "Image",
    "KdTree",
    "Material",
    "Mesh",
    "MultiHits",
    "Multipass",
    "PointLight",
    "RayHit",
    "RayStatus",
    "RaystreamError",
    "RaystreamWarning",
    "Scene",
    "SensorTrack",
    "Shape",
    "SpotLight",
    "StructureOptions",
    "Texture",
    "Tracer",
    "__version__",
    "attenuation",
    "cluster",
    "daylight",
    "export_page",
    "heatmap",
    "lidar_returns",
    "lidar_sweep",
    "load",
    "query_zarr",
    "register_structure",
    "render",
    "render_frames",
    "set_thread_count",
    "streams",
    "surface_points",
    "sweep_patterns",
    "terrain",
    "textures",
    "thickness",
    "thread_count",
    "view",
    "view_factors",
    "visibility",
    "visible_faces",
    "write_video",
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
