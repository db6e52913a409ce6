"""Counts of the fragments that a traversal's kernels run on, by an atomic counter in them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from raystream.graphics import shader_source as sources
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer
from raystream.graphics.ray_textures import RayTextures

#: Kernels have numbers up to this.
_MOST = 8

_DECLARED = """
@group(2) @binding(0) var<storage, read_write> invocations: array<atomic<u32>, 8>;
"""


@contextmanager
def counted_fragments(opened: OpenDevice, monkeypatch, *, is_early: bool) -> Iterator[Buffer]:
    """A buffer with the number of fragments of each kernel, while machines are made and run.

    With `is_early` the stencil test is before the programs, as it is without the counter: that is
    a write to a buffer, which otherwise moves the test behind them.
    """
    counts = Buffer(opened, "fragments")
    counts.reserve(4 * _MOST)
    counts.write(np.zeros(_MOST, np.uint32))
    text, layouts, resources = sources._text_of, RayTextures.layouts, RayTextures.resources

    def counting(name: str) -> str:
        found = text(name)
        if name == "multipass/frame.wgsl":
            begin = "fn begin_kernel(texel: vec2i, waits_for: u32) -> bool {"
            assert begin in found
            found = found.replace(begin, f"{begin}\n atomicAdd(&invocations[KERNEL], 1u);")
            found += _DECLARED
        if name.startswith("multipass/") and is_early:
            found = found.replace("@fragment\n", "@early_depth_test(force)\n@fragment\n")
        return found

    with monkeypatch.context() as patch:
        patch.setattr(sources, "_text_of", counting)
        patch.setattr(RayTextures, "layouts", lambda self, *of: [*layouts(self, *of), ("scatter",)])
        patch.setattr(
            RayTextures, "resources", lambda self, *of: [resources(self, *of)[0], [counts.binding]]
        )
        yield counts


def counts_of(buffer: Buffer) -> np.ndarray:
    """The number of fragments of each kernel: shape (8,), uint32."""
    return buffer.read(np.uint32, (_MOST,))
