"""The triangles of a tracer in the precision that it was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from raystream.core.float64_triangles import Float64Triangles
from raystream.core.scene_kinds import check_support
from raystream.core.triangles import Triangles
from raystream.kernels.move_triangles import move_triangles


def triangles_of(scene: Any, precision: str) -> Any:
    """The triangles that a structure is built from.

    Parameters
    ----------
    scene : Scene
    precision : {"float32", "float64"}

    Raises
    ------
    ValueError
        If the precision is unknown.
    RaystreamError
        If the scene has spheres or height fields, and the precision is float64.
    """
    if precision not in ("float32", "float64"):
        raise ValueError(f"precision: expected 'float32' or 'float64', got {precision!r}")
    if precision == "float32":
        return scene.triangles
    check_support("precision='float64'", scene.triangles)
    return float64_triangles(scene.geometry)


def float64_triangles(geometry: Any) -> Any:
    """The triangles of a scene, in float64: `Float64Triangles`, or instances of them."""
    if geometry.instances is not None:
        return geometry.placed([float64_triangles(one) for one in geometry.objects])
    made = Float64Triangles.of([(mesh.vertices, mesh.faces) for mesh in geometry.meshes])
    made.attributes = geometry.attributes
    return made


def moved_triangles(triangles: Triangles, meshes: Sequence[Any]) -> Triangles:
    """Triangles with other vertices, in the same precision; see `move_triangles`."""
    return Float64Triangles.of(meshes) if triangles.kinds else move_triangles(triangles, meshes)


def of_scene(triangles: Any) -> Any:
    """The triangles for the scene of a tracer; None for those in float64, which are its own."""
    return None if triangles.kinds else triangles
