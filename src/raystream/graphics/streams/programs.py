"""Fragment programs: render pipelines that cover the screen, and the layouts of what they read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.fusing import device_constants
from raystream.graphics.pipelines import shader_module
from raystream.graphics.streams.textures import StencilTexture

__all__ = ["Program", "Stencil", "bind", "cover_screen", "fragment_pipeline", "layout_of"]

#: What a program may be bound to, as WebGPU's layouts call it.
_BINDINGS: Mapping[str, Mapping[str, Any]] = {
    "uniform": {"buffer": {"type": "uniform"}},
    "gather": {"buffer": {"type": "read-only-storage"}},
    "scatter": {"buffer": {"type": "storage"}},
    "float": {"texture": {"sample_type": "unfilterable-float"}},
    "uint": {"texture": {"sample_type": "uint"}},
}

#: Of each device: layouts and pipelines by what they were made of.
_MADE: WeakKeyDictionary[OpenDevice, dict[Any, Any]] = WeakKeyDictionary()


class Stencil(NamedTuple):
    """What a draw does with the stencil.

    Attributes
    ----------
    state : int or None
        The draw is for records in this state; None for all.
    next_state : int or None
        The state that it takes the fragments to which it does not discard; None to leave them.
    """

    state: int | None = None
    next_state: int | None = None

    @property
    def reference(self) -> int:
        """The value that the pass has to set."""
        reference = self.next_state if self.state is None else self.state
        return 0 if reference is None else reference

    def description(self) -> dict[str, Any]:
        """As wgpu takes it."""
        operation, mask = "keep", 0
        if self.next_state is not None and self.state is None:
            operation, mask = "replace", 0xFF
        elif self.next_state is not None and self.state is not None:
            # The reference is taken by the test: the bits in which both states differ turn over.
            operation, mask = "invert", self.state ^ self.next_state
        face = {
            "compare": "always" if self.state is None else "equal",
            "fail_op": "keep",
            "depth_fail_op": "keep",
            "pass_op": operation,
        }
        return {
            "format": StencilTexture.format,
            "depth_write_enabled": False,
            "depth_compare": "always",
            "stencil_front": face,
            "stencil_back": face,
            "stencil_read_mask": 0xFF,
            "stencil_write_mask": mask,
        }


class Program(NamedTuple):
    """A fragment program, as pipelines are made of it.

    Attributes
    ----------
    source : str
        WGSL, with the vertex shader ``cover``.
    entry : str
        The name of its function.
    constants : mapping of str to float
        Values of ``override`` declarations.
    layouts : sequence of tuple of str
        What each group is bound to: see `layout_of`.
    """

    source: str
    entry: str
    constants: Mapping[str, float]
    layouts: Sequence[tuple[str, ...]]


def layout_of(opened: OpenDevice, bindings: tuple[str, ...], *, is_compute: bool = False) -> Any:
    """The layout of a group: for each binding what it is.

    Parameters
    ----------
    opened : OpenDevice
    bindings : tuple of {"uniform", "gather", "scatter", "float", "uint"}
    is_compute : bool
        Whether it is a compute shader's.
    """
    made = _MADE.setdefault(opened, {})
    key = "layout", bindings, is_compute
    if key not in made:
        import wgpu

        stage = wgpu.ShaderStage.COMPUTE if is_compute else wgpu.ShaderStage.FRAGMENT
        made[key] = opened.device.create_bind_group_layout(
            entries=[
                {"binding": number, "visibility": stage, **_BINDINGS[kind]}
                for number, kind in enumerate(bindings)
            ]
        )
    return made[key]


def bind(
    opened: OpenDevice,
    layout: tuple[str, ...],
    resources: Sequence[Any],
    *,
    is_compute: bool = False,
) -> Any:
    """Bind resources to a group of a layout."""
    entries = [{"binding": number, "resource": one} for number, one in enumerate(resources)]
    return opened.device.create_bind_group(
        layout=layout_of(opened, layout, is_compute=is_compute), entries=entries
    )


def cover_screen(run: Any, width: int, height: int) -> None:
    """Set a render pass's viewport so that the triangle of cover.wgsl covers its textures.

    A triangle that reaches beyond the viewport may be clipped to a rectangle, and that be drawn as
    two triangles: blocks of pixels on their diagonal are computed twice. Mesa's software driver
    lets loops of their pixels that are not drawn run on and on. So the viewport is twice as wide
    and as high as the textures, and nothing is clipped.
    """
    run.set_viewport(0, 0, 2 * width, 2 * height, 0.0, 1.0)


def fragment_pipeline(
    opened: OpenDevice,
    name: str,
    program: Program,
    targets: Sequence[tuple[str, bool]],
    stencil: Stencil | None,
) -> Any:
    """A render pipeline.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.
    program : Program
    targets : sequence of (str, bool)
        Format of each target, and whether the program writes it.
    stencil : Stencil or None

    Raises
    ------
    GraphicsError
        If it does not compile.
    """
    made = _MADE.setdefault(opened, {})
    constants = device_constants(opened, program.source, program.constants)
    key = (
        program.source,
        program.entry,
        tuple(sorted(constants.items())),
        tuple(program.layouts),
        tuple(targets),
        stencil,
    )
    if key not in made:
        import wgpu

        module = shader_module(opened, program.source, name)
        layouts = [layout_of(opened, one) for one in program.layouts]
        try:
            made[key] = opened.device.create_render_pipeline(
                layout=opened.device.create_pipeline_layout(bind_group_layouts=layouts),
                vertex={"module": module, "entry_point": "cover", "constants": constants},
                primitive={"topology": "triangle-list"},
                depth_stencil=None if stencil is None else stencil.description(),
                multisample={"count": 1},
                fragment={
                    "module": module,
                    "entry_point": program.entry,
                    "constants": constants,
                    "targets": [
                        {
                            "format": texel,
                            "write_mask": wgpu.ColorWrite.ALL if is_written else 0,
                        }
                        for texel, is_written in targets
                    ],
                },
                label=name,
            )
        except Exception as error:  # wgpu wraps whatever the driver says
            raise GraphicsError(f"shader {name}: gives no pipeline: {error}") from error
    return made[key]
