"""A whole renderer on the multipass machine: eye rays, searches and shading in one loop.

As `machines.ray_loop`, on the graphics pipeline (Purcell 2002, section 3 and Figure 2; Christen
2005, section 5.4): the kernels that make rays and shade hits are fragment programs like those of a
traversal, on textures of their own, and a pixel's ray and records stay on the device. The renderer
hands over the programs, and textures and buffers that only they read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.multipass.kernels import STREAMS
from raystream.graphics.multipass.plan import LAYOUT, STREAM_TYPES
from raystream.graphics.pipelines import Layout, bind
from raystream.graphics.ray_textures import RayTextures
from raystream.graphics.streams.passes import Bindings, StreamPasses
from raystream.graphics.streams.textures import TEXEL_BYTES, StreamShape, StreamTexture

#: Streams that eye rays and shading write, in the order of their render targets: see
#: multipass/loop/targets.wgsl.
LOOP_STREAMS = ("state", "origins", "directions", "pixels", "weights", "paths", "light")

#: Types of all streams of a loop.
LOOP_TYPES = {
    **STREAM_TYPES,
    "origins": "float32",
    "directions": "float32",
    "pixels": "uint32",
    "weights": "uint32",
    "paths": "uint32",
    "light": "float32",
}

#: Group 0 of eye rays and shading: see multipass/loop/frame.wgsl. The first bindings are those of a
#: traversal's kernels, so that the same programs classify.
LOOP_LAYOUT = (*LAYOUT, "uint")

#: The streams at the bindings of both layouts, after the uniform. Where queries have the hits that
#: rays want, a loop has a texture that its searches ignore.
_READ_BY_SHADING = (
    *("origins", "directions", "pixels", "state", "found", "weights", "light", "paths"),
)
_READ_BY_SEARCHES = ("origins", "directions", "pixels", *STREAMS)


class FragmentLoop(NamedTuple):
    """A renderer, as the draws of a loop need it.

    Attributes
    ----------
    source : str
        WGSL with the entry points ``eye_rays``, which gives every pixel its first ray, and
        ``shade``, which shades the hit of a pixel's ray and gives it the next. They include
        multipass/loop/frame.wgsl, and return its ``Targets``.
    constants : mapping of str to float
        Values of ``override`` declarations.
    layout : Layout
        Of group 1 of these programs.
    resources : callable
        ``resources()``: what is bound to it.
    spawns : bool
        Whether shading spawns rays; otherwise all pixels are shaded in one pass.
    grow : callable, optional
        ``grow(encoder)`` makes more room for pixels that shading left in the state NO_ROOM.
        None if there are none.
    """

    source: str
    constants: Mapping[str, float]
    layout: Layout
    resources: Callable[[], Sequence[Any]]
    spawns: bool
    grow: Callable[[Any], None] | None = None


def has_targets(opened: OpenDevice) -> bool:
    """Whether a device writes all streams of a loop's kernels in one draw."""
    limits = opened.limits
    most = limits["max-color-attachment-bytes-per-sample"] // TEXEL_BYTES
    return min(most, limits["max-color-attachments"]) >= len(LOOP_STREAMS)


class LoopStreams:
    """Textures of pixels, their rays and the state of their searches.

    Parameters
    ----------
    opened : OpenDevice
    count : int
        Pixels.

    Attributes
    ----------
    count : int
    shape : StreamShape
    passes : StreamPasses
        With the groups of eye rays and shading, and of the traversal.
    """

    def __init__(self, opened: OpenDevice, count: int) -> None:
        self._opened, self.count = opened, count
        self.shape = StreamShape.for_count(count, opened)
        streams = {
            name: StreamTexture(opened, name, self.shape, np.dtype(dtype))
            for name, dtype in LOOP_TYPES.items()
        }
        types = {name: np.dtype(dtype) for name, dtype in LOOP_TYPES.items()}
        groups = (LOOP_STREAMS, STREAMS)
        self.passes = StreamPasses(opened, self.shape, streams, types, groups)

    def bindings(self, rays: RayTextures, search: Sequence[Any], loop: FragmentLoop) -> Bindings:
        """A function that binds the streams, or their scratch textures, and other resources.

        Parameters
        ----------
        rays : RayTextures
            For the uniform that all kernels share.
        search : sequence of GPUBindGroup
            Of the traversal's kernels, after the first.
        loop : FragmentLoop
        """
        shading = [bind(self._opened, loop.layout, loop.resources())]
        chosen = (
            (LOOP_LAYOUT, _READ_BY_SHADING, shading),
            (LAYOUT, _READ_BY_SEARCHES, list(search)),
        )
        # A pass may not read what it writes, and each binds all textures of its layout.
        groups = [
            [
                [
                    bind(self._opened, layout, [rays.params, *(of[name].view for name in names)]),
                    *rest,
                ]
                for of in (self.passes.streams, self.passes.scratch)
            ]
            for layout, names, rest in chosen
        ]

        def bind_all(run: Any, is_commit: bool, number: int) -> None:
            for place, group in enumerate(groups[number][is_commit]):
                run.set_bind_group(place, group)

        return bind_all

    def light(self) -> Any:
        """The pixels' light, shape (count, 3), float32: waits for the device."""
        return self.passes.streams["light"].read_records(self.count)[:, :3]

    def budgets(self) -> Any:
        """What is left of the budget of each pixel's last ray, shape (count,), uint32."""
        return self.passes.streams["state"].read_records(self.count)[:, 3]
