"""Pipelines: shaders compiled for a device, once for each set of their constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from weakref import WeakKeyDictionary

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.fusing import device_constants

__all__ = ["bind_group", "compute_pipeline", "shader_module"]

#: Of each device: modules and pipelines by what they were made of.
_MADE: WeakKeyDictionary[OpenDevice, dict[Any, Any]] = WeakKeyDictionary()


def shader_module(opened: OpenDevice, source: str, name: str) -> Any:
    """Compile WGSL.

    Raises
    ------
    GraphicsError
        If it is not valid: in one line, and what the compiler says after it.
    """
    made = _MADE.setdefault(opened, {})
    if source not in made:
        try:
            made[source] = opened.device.create_shader_module(code=source, label=name)
        except Exception as error:  # wgpu wraps whatever the compiler says
            raise GraphicsError(f"shader {name}: does not compile: {error}") from error
    return made[source]


def compute_pipeline(
    opened: OpenDevice, source: str, name: str, constants: Mapping[str, float]
) -> Any:
    """A compute pipeline whose entry point is ``trace``.

    Parameters
    ----------
    opened : OpenDevice
    source : str
    name : str
        For errors.
    constants : mapping of str to float
        Values of ``override`` declarations.

    Raises
    ------
    GraphicsError
        If it does not compile.
    """
    made = _MADE.setdefault(opened, {})
    constants = device_constants(opened, source, constants)
    key = source, tuple(sorted(constants.items()))
    if key not in made:
        module = shader_module(opened, source, name)
        try:
            made[key] = opened.device.create_compute_pipeline(
                layout="auto",
                compute={"module": module, "entry_point": "trace", "constants": constants},
                label=name,
            )
        except Exception as error:  # wgpu wraps whatever the driver says
            raise GraphicsError(f"shader {name}: gives no pipeline: {error}") from error
    return made[key]


def bind_group(
    opened: OpenDevice, pipeline: Any, number: int, resources: Sequence[Mapping[str, Any] | None]
) -> Any:
    """Bind resources to a pipeline's group, by their binding numbers; None for those it lacks."""
    entries = [
        {"binding": binding, "resource": resource}
        for binding, resource in enumerate(resources)
        if resource is not None
    ]
    return opened.device.create_bind_group(
        layout=pipeline.get_bind_group_layout(number), entries=entries
    )
