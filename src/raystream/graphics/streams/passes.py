"""Passes: kernels are run over streams that they read and write, and records change their state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.fragment_program import cover_screen
from raystream.graphics.streams.textures import (
    TEXEL_BYTES,
    StencilTexture,
    StreamShape,
    StreamTexture,
)

__all__ = ["Bindings", "Draw", "StreamPasses", "groups_of"]

#: Binds what a program reads, besides the pipeline, in a render pass; told whether the streams
#: are to be read, or their scratch textures.
Bindings = Callable[[Any, bool], None]


class Draw(NamedTuple):
    """A draw that covers the screen.

    Attributes
    ----------
    pipeline : GPURenderPipeline
    reference : int
        For the stencil test.
    kernel : int
        Number of the kernel that it belongs to.
    """

    pipeline: Any
    reference: int
    kernel: int


def groups_of(names: Sequence[str], opened: OpenDevice) -> list[list[str]]:
    """Streams that can be written together: all, or a half after the other.

    An adapter allows so many bytes of a pixel; 32 of them are promised. A kernel with more
    outputs runs once for each group: it writes scratch textures, so it finds all as it was.
    """
    names = list(names)
    if TEXEL_BYTES * len(names) <= opened.limits["max-color-attachment-bytes-per-sample"]:
        return [names]
    half = len(names) // 2
    return [names[:half], names[half:]]


class StreamPasses:
    """Streams, their scratch textures and the stencil; and the passes of kernels over these.

    Parameters
    ----------
    opened : OpenDevice
    shape : StreamShape
    streams : mapping of str to StreamTexture
        All that kernels write, in the order of their targets.
    dtypes : mapping of str to dtype
        Of each.
    """

    def __init__(
        self,
        opened: OpenDevice,
        shape: StreamShape,
        streams: Mapping[str, StreamTexture],
        dtypes: Mapping[str, Any],
    ) -> None:
        self._shape = shape
        self.streams = dict(streams)
        self.scratch = {
            name: StreamTexture(opened, f"scratch {name}", shape, dtype)
            for name, dtype in dtypes.items()
        }
        self.stencil = StencilTexture(opened, shape)
        self.groups = groups_of(list(streams), opened)

    def begin(self, encoder: Any, draws: Sequence[Draw], bind: Bindings, queries: Any) -> None:
        """Clear all, and run the program that puts records into their first state.

        Parameters
        ----------
        encoder : GPUCommandEncoder
        draws : sequence of Draw
            One for each group of targets.
        bind : callable
        queries : GPUQuerySet or None
            Query 0 gets the count of records.
        """
        for number, (group, draw) in enumerate(zip(self.groups, draws, strict=True)):
            run = self._pass(encoder, self.streams, group, "clear", queries)
            bind(run, True)
            is_asked = queries is not None and number == len(self.groups) - 1
            _draw(run, draw, None, 0 if is_asked else None)
            run.end()

    def run(
        self,
        encoder: Any,
        kernels: Sequence[Sequence[Draw]],
        commits: Sequence[Sequence[Draw]],
        classifies: Sequence[Draw],
        bind: Bindings,
        arguments: Any = None,
        queries: Any = None,
    ) -> None:
        """A pass of one kernel; of several, that of which the arguments draw something.

        Parameters
        ----------
        encoder : GPUCommandEncoder
        kernels, commits : sequence of sequence of Draw
            For each group of targets.
        classifies : sequence of Draw
            For each state that a kernel moves records to.
        bind : callable
        arguments : GPUBuffer, optional
            Kernel k has the arguments of its draws there, see `ARGUMENT_BYTES`.
        queries : GPUQuerySet, optional
            Query i gets how many records the i-th of `classifies` moves.
        """
        for group, draws in zip(self.groups, kernels, strict=True):
            run = self._pass(encoder, self.scratch, group, "read")
            bind(run, False)
            for draw in draws:
                _draw(run, draw, arguments)
            run.end()
        for number, (group, draws) in enumerate(zip(self.groups, commits, strict=True)):
            run = self._pass(encoder, self.streams, group, "load", queries)
            bind(run, True)
            for draw in draws:
                _draw(run, draw, arguments)
            if number == len(self.groups) - 1:
                for place, draw in enumerate(classifies):
                    _draw(run, draw, arguments, None if queries is None else place)
            run.end()

    def _pass(
        self,
        encoder: Any,
        textures: Mapping[str, StreamTexture],
        group: Sequence[str],
        stencil: str,
        queries: Any = None,
    ) -> Any:
        """Begin a render pass; the stencil is to be read, loaded or cleared."""
        load = "clear" if stencil == "clear" else "load"
        states: dict[str, Any] = {"view": self.stencil.view}
        if stencil == "read":
            states["stencil_read_only"] = True
        else:
            states |= {
                "stencil_load_op": load,
                "stencil_store_op": "store",
                "stencil_clear_value": 0,
            }
        more = {} if queries is None else {"occlusion_query_set": queries}
        run = encoder.begin_render_pass(
            color_attachments=[
                {"view": textures[name].view, "load_op": load, "store_op": "store"}
                for name in group
            ],
            depth_stencil_attachment=states,
            **more,
        )
        cover_screen(run, self._shape)
        return run


#: Of a kernel's draws in the buffer of arguments: four words, 3 corners and 0 or 1 instances.
ARGUMENT_BYTES = 16


def _draw(run: Any, draw: Draw, arguments: Any, query: int | None = None) -> None:
    run.set_pipeline(draw.pipeline)
    run.set_stencil_reference(draw.reference)
    if query is not None:
        run.begin_occlusion_query(query)
    if arguments is None:
        run.draw(3)
    else:
        run.draw_indirect(arguments, ARGUMENT_BYTES * draw.kernel)
    if query is not None:
        run.end_occlusion_query()
