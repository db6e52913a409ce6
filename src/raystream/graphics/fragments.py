"""Fragment programs: kernels whose streams are textures, run by drawing over the whole picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer
from raystream.graphics.drawing import GATHERED, NOTED, UNIFORM, drawing_pipeline
from raystream.graphics.screens import Screen, sampled
from raystream.graphics.streams.programs import cover_screen

__all__ = ["FragmentProgram"]


class FragmentProgram:
    """A fragment program over all pixels: it gathers from textures and writes others.

    It draws one triangle that covers the screen, see ``screen.wgsl``.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        Its entry point, and for errors.
    source : str
        With ``screen.wgsl``.
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
        source: str,
        *,
        reads: Sequence[str],
        writes: Sequence[str],
        gathers: int = 0,
        notes: bool = False,
        constants: Mapping[str, float] | None = None,
    ) -> None:
        own = [UNIFORM, *map(sampled, reads), *[NOTED] * notes]
        groups = own, [GATHERED] * gathers
        self._pipeline = drawing_pipeline(
            opened, source, ("cover", name), groups, writes, constants=constants
        )

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
        own = [{"buffer": params, "size": params.size}, *(one.view for one in reads)]
        if notes is not None:
            own.append(notes.binding)
        attachments = [
            {"view": one.view, "clear_value": (0,) * 4, "load_op": "clear", "store_op": "store"}
            for one in writes
        ]
        drawn = encoder.begin_render_pass(color_attachments=attachments)
        cover_screen(drawn, *writes[0].size)
        self._pipeline.bind(drawn, [own, [one.binding for one in gathers]])
        drawn.draw(3)
        drawn.end()
