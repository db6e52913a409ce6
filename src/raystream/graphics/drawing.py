"""Pipelines that draw: vertex and fragment programs, compiled once for each device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.fusing import device_constants
from raystream.graphics.pipelines import shader_module

__all__ = ["GATHERED", "NOTED", "UNIFORM", "DrawingPipeline", "drawing_pipeline"]

#: What bindings are, as layouts of bind groups have it: a uniform, and storage buffers that are
#: read and written.
UNIFORM = {"buffer": {"type": "uniform"}}
GATHERED = {"buffer": {"type": "read-only-storage"}}
NOTED = {"buffer": {"type": "storage"}}

#: Of each device: pipelines by what they were made of.
_MADE: WeakKeyDictionary[OpenDevice, dict[Any, DrawingPipeline]] = WeakKeyDictionary()


class DrawingPipeline(NamedTuple):
    """A pipeline, and the layouts of its bind groups."""

    opened: OpenDevice
    handle: Any
    layouts: list[Any]

    def bind(self, drawn: Any, groups: Sequence[Sequence[Any]]) -> None:
        """Set a render pass's pipeline and its resources, by group and binding."""
        drawn.set_pipeline(self.handle)
        for number, (layout, own) in enumerate(zip(self.layouts, groups, strict=True)):
            entries = [{"binding": k, "resource": one} for k, one in enumerate(own)]
            group = self.opened.device.create_bind_group(layout=layout, entries=entries)
            drawn.set_bind_group(number, group)


def drawing_pipeline(
    opened: OpenDevice,
    source: str,
    entry_points: tuple[str, str],
    groups: Sequence[Sequence[Mapping[str, Any]]],
    targets: Sequence[str],
    *,
    constants: Mapping[str, float] | None = None,
    depth: Mapping[str, Any] | None = None,
) -> DrawingPipeline:
    """Compile a vertex and a fragment program that draw triangles.

    Parameters
    ----------
    opened : OpenDevice
    source : str
        With both.
    entry_points : (str, str)
        Of the vertex program and the fragment program; this one's name is also for errors.
    groups : sequence of sequence of mapping
        Of each bind group what its bindings are.
    targets : sequence of str
        Formats of the textures that are written.
    constants : mapping of str to float, optional
        Values of ``override`` declarations.
    depth : mapping, optional
        The depth test.

    Raises
    ------
    GraphicsError
        If it does not compile.
    """
    made = _MADE.setdefault(opened, {})
    constants = device_constants(opened, source, constants or {})
    key = source, entry_points, tuple(targets), tuple(sorted(constants.items()))
    if key in made:
        return made[key]
    vertex, fragment = entry_points
    device, module = opened.device, shader_module(opened, source, fragment)
    try:
        layouts = [device.create_bind_group_layout(entries=_entries(group)) for group in groups]
        handle = device.create_render_pipeline(
            label=fragment,
            layout=device.create_pipeline_layout(bind_group_layouts=layouts),
            vertex={"module": module, "entry_point": vertex},
            primitive={"topology": "triangle-list", "cull_mode": "none"},
            depth_stencil=None if depth is None else dict(depth),
            fragment={
                "module": module,
                "entry_point": fragment,
                "targets": [{"format": one} for one in targets],
                "constants": constants,
            },
        )
    except Exception as error:  # wgpu wraps whatever the driver says
        raise GraphicsError(f"shader {fragment}: gives no pipeline: {error}") from error
    made[key] = DrawingPipeline(opened, handle, layouts)
    return made[key]


def _entries(group: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Of a bind group's layout; only fragment programs write buffers."""
    import wgpu

    both = wgpu.ShaderStage.FRAGMENT | wgpu.ShaderStage.VERTEX
    return [
        {
            "binding": binding,
            "visibility": wgpu.ShaderStage.FRAGMENT if one == NOTED else both,
            **one,
        }
        for binding, one in enumerate(group)
    ]
