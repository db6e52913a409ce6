"""Validation of the arguments that renderers share."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any

from raystream.core.checks import check_least
from raystream.core.choices import DeviceOptions
from raystream.core.memory import check_memory
from raystream.core.scene_kinds import check_support
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

#: Most pixels of an image.
MAX_PIXELS = 1 << 30

#: Memory per pixel: film, image, and encoded image.
_BYTES_PER_PIXEL = 60


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Validate width and height.

    Raises
    ------
    ValueError
        If they are not two integers, are below 1, or exceed `MAX_PIXELS` together.
    MemoryError
        If the image does not fit into memory.
    """
    try:
        width, height = (operator.index(length) for length in size)
    except (TypeError, ValueError):
        raise ValueError(f"size: expected (width, height), got {size!r}") from None
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"size: expected 1 to {MAX_PIXELS:,} pixels, got {width}x{height}")
    check_memory(width * height * _BYTES_PER_PIXEL, f"an image of {width}x{height} would")
    return width, height


def check_samples(samples: int) -> int:
    """Validate the number of samples: at least 1, else ValueError."""
    return check_least("samples", samples, 1)


def check_camera(camera: Camera | None) -> None:
    """Raise TypeError if it is not a camera or None."""
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a Camera, got {type(camera).__name__}")


def make_tracer(
    scene: Scene | Tracer,
    structure: str | StructureOptions,
    device: str | DeviceOptions,
    options: Mapping[str, Any],
) -> Tracer:
    """Return the tracer given, or make one for the scene.

    Raises
    ------
    ValueError, TypeError
        If a tracer is given together with options, or as `Tracer`.
    RaystreamError
        If its instances are in worlds.
    """
    if isinstance(scene, Tracer):
        if structure != "bvh" or device != "cpu" or options:
            raise ValueError(
                "structure, device, options: not allowed with a Tracer, which has its own"
            )
        tracer = scene
    else:
        tracer = Tracer(scene, structure, device, **options)
    check_support("render", tracer.structure.triangles)
    return tracer


def check_whole(name: str, value: Any, least: int, most: int) -> int:
    """Validate an option: an integer within bounds, else ValueError with its name."""
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name}: expected an integer, got {value!r:.40}") from None
    if not least <= number <= most:
        raise ValueError(f"{name}: expected {least} to {most}, got {number}")
    return number


def check_switch(name: str, value: Any) -> bool:
    """Check a bool; raises ValueError for anything else."""
    if not isinstance(value, bool):
        raise ValueError(f"{name}: expected True or False, got {value!r:.40}")
    return value


def check_number(name: str, value: Any) -> float:
    """Validate an option: a number other than NaN, else ValueError with its name."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected a number, got {value!r:.40}") from None
    if math.isnan(number):
        raise ValueError(f"{name}: expected a number, got nan")
    return number
