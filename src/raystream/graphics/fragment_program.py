"""Fragment programs: kernels over textures, run by drawing all their texels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.pipelines import Program, bind, fragment_pipeline
from raystream.graphics.textures import Texture


class FragmentProgram:
    """A fragment program over all texels: it reads textures and writes others.

    It draws one triangle that covers the screen, see ``fullscreen.wgsl``.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.
    program : Program
        With ``fullscreen.wgsl``.
    formats : sequence of str
        Formats of the textures that it writes.

    Raises
    ------
    GraphicsError
        If it does not compile.
    """

    def __init__(
        self, opened: OpenDevice, name: str, program: Program, formats: Sequence[str]
    ) -> None:
        targets = [(one, True) for one in formats]
        self._opened = opened
        self._layouts = program.layouts
        self._pipeline = fragment_pipeline(opened, name, program, targets)

    def draw(
        self, encoder: Any, groups: Sequence[Sequence[Any]], writes: Sequence[Texture]
    ) -> None:
        """Run it over all texels, in a render pass of its own.

        Parameters
        ----------
        encoder : GPUCommandEncoder
        groups : sequence of sequence
            Resources of each bind group, without the textures that are written.
        writes : sequence of Texture
            Of equal size.
        """
        attachments = [
            {"view": one.view, "clear_value": (0,) * 4, "load_op": "clear", "store_op": "store"}
            for one in writes
        ]
        drawn = encoder.begin_render_pass(color_attachments=attachments)
        cover_screen(drawn, writes[0].size)
        drawn.set_pipeline(self._pipeline)
        for number, (layout, own) in enumerate(zip(self._layouts, groups, strict=True)):
            drawn.set_bind_group(number, bind(self._opened, layout, own))
        drawn.draw(3)
        drawn.end()


def cover_screen(run: Any, size: tuple[int, int]) -> None:
    """Set a render pass's viewport so that the triangle of fullscreen.wgsl covers its textures.

    A triangle beyond the viewport may be clipped to a rectangle, drawn as two triangles whose
    diagonal's pixel quads run twice; loops of helper invocations do not end in Mesa's software
    driver. So the viewport is twice as wide and as high as the textures, and nothing is clipped.
    """
    width, height = size
    run.set_viewport(0, 0, 2 * width, 2 * height, 0.0, 1.0)
