"""Refusals of scenes with primitives, instances or a precision that a feature does not support."""

from __future__ import annotations

from typing import Any

from raystream.core.errors import RaystreamError
from raystream.core.float64_triangles import NOT_IN_FLOAT64, Float64Triangles
from raystream.core.instanced_triangles import NOT_INSTANCED, InstancedTriangles
from raystream.core.primitives import NOT_TRIANGLES, Primitives


def check_float32(what: str, triangles: Any) -> None:
    """Check that a tracer's scene is in float32, as `what` needs.

    Raises
    ------
    RaystreamError
        If it is in float64.
    """
    if isinstance(triangles, Float64Triangles):
        raise RaystreamError(f"{what}: {NOT_IN_FLOAT64}")


def check_triangles(what: str, triangles: Any) -> None:
    """Check that a scene has triangles in float32 alone, in instances or not, as `what` needs.

    Raises
    ------
    RaystreamError
        If there are other primitives, or the triangles are in float64.
    """
    if isinstance(triangles, Primitives):
        raise RaystreamError(f"{what}: {NOT_TRIANGLES}")
    check_float32(what, triangles)


def check_plain(what: str, triangles: Any) -> None:
    """Check that a scene has triangles in float32 alone, without instances, as `what` needs.

    Raises
    ------
    RaystreamError
        If there are others.
    """
    if isinstance(triangles, InstancedTriangles):
        raise RaystreamError(f"{what}: {NOT_INSTANCED}")
    check_triangles(what, triangles)


def check_no_worlds(what: str, triangles: Any) -> None:
    """Check that triangles belong to no instances in worlds, with which `what` is not supported.

    Raises
    ------
    RaystreamError
        If they do.
    """
    if isinstance(triangles, InstancedTriangles) and triangles.instances.world_count:
        raise RaystreamError(
            f"{what}: not supported in a scene whose instances are in worlds; make a "
            "scene of the instances of one world"
        )


def check_drawable(triangles: Any) -> None:
    """Check that renderers support what a tracer's scene holds.

    Raises
    ------
    RaystreamError
        If it is in float64, or its instances are in worlds.
    """
    check_float32("render", triangles)
    check_no_worlds("render", triangles)
