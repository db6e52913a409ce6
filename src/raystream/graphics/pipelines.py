"""Pipelines: shaders compiled for a device, once per set of constants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol
from weakref import WeakKeyDictionary

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.fma_probe import device_constants

#: Kinds of the bindings of a group, in order.
Layout = tuple[str, ...]

#: Kinds of bindings, as entries of WebGPU's bind group layouts.
_BINDINGS: Mapping[str, Mapping[str, Any]] = {
    "uniform": {"buffer": {"type": "uniform"}},
    "gather": {"buffer": {"type": "read-only-storage"}},
    "scatter": {"buffer": {"type": "storage"}},
    "float": {"texture": {"sample_type": "unfilterable-float"}},
    "uint": {"texture": {"sample_type": "uint"}},
    "sint": {"texture": {"sample_type": "sint"}},
}

#: Modules, layouts and pipelines of each device, by their sources.
_MADE: WeakKeyDictionary[OpenDevice, dict[Any, Any]] = WeakKeyDictionary()


class Program(NamedTuple):
    """A shader, as pipelines are made of it.

    Attributes
    ----------
    source : str
        WGSL.
    entry : str
        The name of its entry point.
    layouts : sequence of Layout
        For each bind group: "uniform", "gather" and "scatter" are buffers, the others textures.
    constants : mapping of str to float
        Values of ``override`` declarations.
    vertex : str
        Vertex entry point, of a fragment program.
    """

    source: str
    entry: str
    layouts: Sequence[Layout]
    constants: Mapping[str, float] = {}
    vertex: str = "cover"


class DepthStencil(Protocol):
    """Depth or stencil state of a draw; hashable."""

    def description(self) -> dict[str, Any]:
        """The state in wgpu's terms."""


def shader_module(opened: OpenDevice, source: str, name: str) -> Any:
    """Compile WGSL.

    Raises
    ------
    GraphicsError
        If it is not valid: one line, then the compiler's message.
    """
    made = _MADE.setdefault(opened, {})
    if source not in made:
        try:
            made[source] = opened.device.create_shader_module(code=source, label=name)
        except Exception as error:  # wgpu wraps all errors of the compiler
            raise GraphicsError(f"shader {name}: does not compile: {error}") from error
    return made[source]


def compute_pipeline(opened: OpenDevice, name: str, program: Program) -> Any:
    """A compute pipeline.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.
    program : Program

    Raises
    ------
    GraphicsError
        If it does not compile.
    """
    constants = device_constants(opened, program.source, program.constants)

    def make(module: Any, layout: Any) -> Any:
        return opened.device.create_compute_pipeline(
            layout=layout,
            compute={"module": module, "entry_point": program.entry, "constants": constants},
            label=name,
        )

    return _made(opened, name, program, constants, None, make)


def fragment_pipeline(
    opened: OpenDevice,
    name: str,
    program: Program,
    targets: Sequence[tuple[str, bool]],
    depth_stencil: DepthStencil | None = None,
) -> Any:
    """A render pipeline that draws triangles.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.
    program : Program
    targets : sequence of (str, bool)
        Format of each render target, and whether the program writes it.
    depth_stencil : DepthStencil, optional

    Raises
    ------
    GraphicsError
        If it does not compile.
    """
    import wgpu

    constants = device_constants(opened, program.source, program.constants)

    def make(module: Any, layout: Any) -> Any:
        return opened.device.create_render_pipeline(
            layout=layout,
            vertex={"module": module, "entry_point": program.vertex, "constants": constants},
            primitive={"topology": "triangle-list", "cull_mode": "none"},
            depth_stencil=None if depth_stencil is None else depth_stencil.description(),
            fragment={
                "module": module,
                "entry_point": program.entry,
                "constants": constants,
                "targets": [
                    {"format": texel, "write_mask": wgpu.ColorWrite.ALL if is_written else 0}
                    for texel, is_written in targets
                ],
            },
            label=name,
        )

    return _made(opened, name, program, constants, (tuple(targets), depth_stencil), make)


def _made(
    opened: OpenDevice,
    name: str,
    program: Program,
    constants: Mapping[str, float],
    drawn: tuple[Any, ...] | None,
    make: Callable[[Any, Any], Any],
) -> Any:
    """A cached pipeline, or a new one from a module and a layout.

    Besides the program, `drawn` is part of its key: None for a compute pipeline.
    """
    made = _MADE.setdefault(opened, {})
    entries = program.entry, program.vertex, tuple(program.layouts)
    key = program.source, *entries, tuple(sorted(constants.items())), drawn
    if key not in made:
        module = shader_module(opened, program.source, name)
        groups = [_layout_of(opened, one, drawn is None) for one in program.layouts]
        try:
            layout = opened.device.create_pipeline_layout(bind_group_layouts=groups)
            made[key] = make(module, layout)
        except Exception as error:  # wgpu wraps all errors of the driver
            raise GraphicsError(f"shader {name}: cannot make a pipeline: {error}") from error
    return made[key]


def _layout_of(opened: OpenDevice, layout: Layout, is_compute: bool) -> Any:
    made = _MADE.setdefault(opened, {})
    key = "layout", layout, is_compute
    if key not in made:
        import wgpu

        stage = wgpu.ShaderStage
        drawing = stage.FRAGMENT | stage.VERTEX
        made[key] = opened.device.create_bind_group_layout(
            entries=[
                {
                    "binding": number,
                    "visibility": stage.COMPUTE
                    if is_compute
                    # Vertex shaders may not write buffers.
                    else (stage.FRAGMENT if kind == "scatter" else drawing),
                    **_BINDINGS[kind],
                }
                for number, kind in enumerate(layout)
            ]
        )
    return made[key]


def bind(
    opened: OpenDevice, layout: Layout, resources: Sequence[Any], *, is_compute: bool = False
) -> Any:
    """Bind resources to a group of a compute or fragment program."""
    entries = [
        {"binding": number, "resource": resource}
        for (number, resource), _ in zip(enumerate(resources), layout, strict=True)
    ]
    return opened.device.create_bind_group(
        layout=_layout_of(opened, layout, is_compute), entries=entries
    )
