"""Fragment programs: kernels whose streams are textures, run by drawing over the whole picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer
from raystream.graphics.errors import GraphicsError
from raystream.graphics.pipelines import shader_module
from raystream.graphics.screens import IDS, WORDS, Screen
from raystream.graphics.source import shader_source

__all__ = ["FragmentProgram", "group_entry", "sampled_as"]


class FragmentProgram:
    """A fragment program over all pixels: it gathers from textures and writes others.

    It draws one triangle that covers the screen, see ``screen.wgsl``.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        Its entry point, and for errors.
    files : sequence of str
        Shader files.
    reads, writes : sequence of str
        Formats of the textures it reads, bindings 1 and up of group 0, and writes.
    gathers : int
        Storage buffers that it reads: bindings 0 and up of group 1.
    notes : bool
        Whether it writes a storage buffer: the last binding of group 0.
    constants : mapping of str to float, optional
        Values of ``override`` declarations.

    Raises
    ------
    GraphicsError
        If it does not compile.
    """

    def __init__(
        self,
        opened: OpenDevice,
        name: str,
        files: Sequence[str],
        *,
        reads: Sequence[str],
        writes: Sequence[str],
        gathers: int = 0,
        notes: bool = False,
        constants: Mapping[str, float] | None = None,
    ) -> None:
        self.name = name
        self._opened = opened
        kinds = [sampled_as(one) for one in reads]
        own = [{"buffer": {"type": "uniform"}}, *kinds]
        own += [{"buffer": {"type": "storage"}}] if notes else []
        lists = [{"buffer": {"type": "read-only-storage"}}] * gathers
        module = shader_module(opened, shader_source("screen.wgsl", *files), name)
        device = opened.device
        try:
            self._layouts = [
                device.create_bind_group_layout(entries=list(map(group_entry, range(99), entries)))
                for entries in (own, lists)
            ]
            self._pipeline = device.create_render_pipeline(
                label=name,
                layout=device.create_pipeline_layout(bind_group_layouts=self._layouts),
                vertex={"module": module, "entry_point": "cover"},
                primitive={"topology": "triangle-list"},
                fragment={
                    "module": module,
                    "entry_point": name,
                    "targets": [{"format": one} for one in writes],
                    "constants": dict(constants or {}),
                },
            )
        except Exception as error:  # wgpu wraps whatever the driver says
            raise GraphicsError(f"shader {name}: gives no pipeline: {error}") from error

    def draw(
        self,
        encoder: Any,
        params: Any,
        reads: Sequence[Screen],
        writes: Sequence[Screen],
        gathers: Sequence[Buffer] = (),
        notes: Buffer | None = None,
    ) -> None:
        """Run it over all pixels, in a pass of its own.

        Parameters
        ----------
        encoder : GPUCommandEncoder
        params : GPUBuffer
            The uniform, binding 0.
        reads, writes : sequence of Screen
            None may be in both.
        gathers : sequence of Buffer
        notes : Buffer, optional
        """
        own: list[Any] = [{"buffer": params, "size": params.size}, *(one.view for one in reads)]
        own += [] if notes is None else [notes.binding]
        attachments = [
            {"view": one.view, "load_op": "clear", "store_op": "store", "clear_value": (0,) * 4}
            for one in writes
        ]
        drawn = encoder.begin_render_pass(color_attachments=attachments)
        drawn.set_pipeline(self._pipeline)
        for number, resources in enumerate((own, [one.binding for one in gathers])):
            entries = [{"binding": k, "resource": one} for k, one in enumerate(resources)]
            layout = self._layouts[number]
            group = self._opened.device.create_bind_group(layout=layout, entries=entries)
            drawn.set_bind_group(number, group)
        drawn.draw(3)
        drawn.end()


def group_entry(binding: int, resource: Mapping[str, Any]) -> dict[str, Any]:
    """A line of a bind group's layout, for vertex and fragment programs."""
    import wgpu

    stages = wgpu.ShaderStage.FRAGMENT
    if resource.get("buffer", {}).get("type") != "storage":  # vertex programs write none
        stages |= wgpu.ShaderStage.VERTEX
    return {"binding": binding, "visibility": stages, **resource}


def sampled_as(format: str) -> dict[str, Any]:  # noqa: A002
    """What a layout says of a texture of a format."""
    kinds = {WORDS: "uint", IDS: "sint"}
    kind = kinds.get(format, "unfilterable-float")
    return {"texture": {"sample_type": kind, "view_dimension": "2d"}}
