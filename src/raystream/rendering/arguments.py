"""Arguments that everything which makes a picture of a scene takes, checked."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any

from raystream.core.choices import DeviceOptions
from raystream.core.memory import check_memory
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

__all__ = [
    "MAX_PIXELS",
    "check_camera",
    "check_number",
    "check_samples",
    "check_size",
    "check_whole",
    "make_tracer",
]

#: Larger pictures are refused.
MAX_PIXELS = 1 << 30

#: Memory that a picture takes: sums for each pixel, the image, and its encoding.
_BYTES_PER_PIXEL = 60


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height, if a picture may be as large.

    Raises
    ------
    ValueError
        If they are no two numbers, below 1, or more than `MAX_PIXELS` together.
    MemoryError
        If the picture does not fit into memory.
    """
    try:
        width, height = (operator.index(length) for length in size)
    except (TypeError, ValueError):
        raise ValueError(f"size: expected (width, height), got {size!r}") from None
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"size: expected 1 to {MAX_PIXELS:,} pixels, got {width}x{height}")
    check_memory(width * height * _BYTES_PER_PIXEL, f"a picture of {width}x{height} would")
    return width, height


def check_samples(samples: int) -> int:
    """The number of samples, if it is at least 1; else ValueError."""
    samples = operator.index(samples)
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")
    return samples


def check_camera(camera: Camera | None) -> None:
    """Raise TypeError if it is no camera."""
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a Camera, got {type(camera).__name__}")


def make_tracer(
    scene: Scene | Tracer,
    structure: str | StructureOptions,
    device: str | DeviceOptions,
    options: Mapping[str, Any],
) -> Tracer:
    """The tracer given, or one of the scene.

    Raises
    ------
    ValueError, TypeError
        If a tracer is given with options of another, or as `Tracer`.
    """
    if isinstance(scene, Tracer):
        if structure != "bvh" or device != "cpu" or options:
            raise ValueError("structure, device, options: the tracer given has its own")
        return scene
    return Tracer(scene, structure, device, **options)


def check_whole(name: str, value: Any, least: int, most: int) -> int:
    """An integer of an option, if it is within bounds; else ValueError that names it."""
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name}: expected an integer, got {value!r:.40}") from None
    if not least <= number <= most:
        raise ValueError(f"{name}: expected {least} to {most}, got {number}")
    return number


def check_number(name: str, value: Any) -> float:
    """A number of an option; ValueError that names it if it is none, or NaN."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected a number, got {value!r:.40}") from None
    if math.isnan(number):
        raise ValueError(f"{name}: expected a number, got nan")
    return number
