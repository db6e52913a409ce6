"""Passes: kernels run over streams, and records change state."""

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

#: Binds the resources of a group's programs in a render pass: with the scratch textures of streams
#: if the flag is set, else with the streams. The number is the group's.
Bindings = Callable[[Any, bool, int], None]


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
    """Streams that one draw can write: all, or half of them.

    Adapters limit the bytes per pixel; 32 are guaranteed. A kernel with more outputs runs once
    per group: it writes scratch textures, so that its inputs stay as they were.
    """
    names = list(names)
    if TEXEL_BYTES * len(names) <= opened.limits["max-color-attachment-bytes-per-sample"]:
        return [names]
    half = len(names) // 2
    return [names[:half], names[half:]]


class StreamPasses:
    """Streams, their scratch textures and the stencil, and passes of kernels over them.

    Parameters
    ----------
    opened : OpenDevice
    shape : StreamShape
    streams : mapping of str to StreamTexture
        All that kernels write, in the order of their targets.
    dtypes : mapping of str to dtype
        Of each.
    groups : sequence of sequence of str, optional
        Streams that are drawn to at once [default: `groups_of` all].
    """

    def __init__(
        self,
        opened: OpenDevice,
        shape: StreamShape,
        streams: Mapping[str, StreamTexture],
        dtypes: Mapping[str, Any],
        groups: Sequence[Sequence[str]] | None = None,
    ) -> None:
        self._shape = shape
        self.streams = dict(streams)
        self.scratch = {
            name: StreamTexture(opened, f"scratch {name}", shape, dtype)
            for name, dtype in dtypes.items()
        }
        self.stencil = StencilTexture(opened, shape)
        self.groups = groups_of(list(streams), opened) if groups is None else groups

    def begin(self, encoder: Any, draws: Sequence[Draw], bind: Bindings, queries: Any) -> None:
        """Clear all, and run the program that sets the first state of records.

        Parameters
        ----------
        encoder : GPUCommandEncoder
        draws : sequence of Draw
            One for each of the first groups of targets.
        bind : callable
        queries : GPUQuerySet or None
            Query 0 counts the records.
        """
        for number, (group, draw) in enumerate(zip(self.groups, draws, strict=False)):
            run = self._pass(encoder, self.streams, group, "clear", queries)
            bind(run, True, number)
            is_asked = queries is not None and number == len(draws) - 1
            _draw(run, draw, None, 0 if is_asked else None)
            run.end()

    def move(self, encoder: Any, draw: Draw, bind: Bindings, queries: Any) -> None:
        """Move records from one state to another by a draw that writes no stream.

        Parameters
        ----------
        encoder, bind, queries
            See `begin`.
        draw : Draw
            For the last group of targets.
        """
        last = len(self.groups) - 1
        run = self._pass(encoder, self.streams, self.groups[last], "load", queries)
        bind(run, True, last)
        _draw(run, draw, None, None if queries is None else 0)
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
        """A pass of one kernel; of several, the one whose indirect arguments draw.

        Parameters
        ----------
        encoder : GPUCommandEncoder
        kernels, commits : sequence of sequence of Draw
            For each group of targets.
        classifies : sequence of Draw
            One for each next state.
        bind : callable
        arguments : GPUBuffer, optional
            Indirect arguments of each kernel's draws, see `ARGUMENT_BYTES`.
        queries : GPUQuerySet, optional
            Query i counts the records that the i-th of `classifies` moves.
        """
        for number, (group, draws) in enumerate(zip(self.groups, kernels, strict=True)):
            if not draws:
                continue
            run = self._pass(encoder, self.scratch, group, "read")
            bind(run, False, number)
            for draw in draws:
                _draw(run, draw, arguments)
            run.end()
        for number, (group, draws) in enumerate(zip(self.groups, commits, strict=True)):
            is_last = number == len(self.groups) - 1
            if not draws and not is_last:
                continue
            run = self._pass(encoder, self.streams, group, "load", queries)
            bind(run, True, number)
            for draw in draws:
                _draw(run, draw, arguments)
            if is_last:
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
        """Begin a render pass; `stencil` is "read", "load" or "clear"."""
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


#: Indirect arguments of a kernel's draws: four words, 3 vertices and 0 or 1 instances.
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
