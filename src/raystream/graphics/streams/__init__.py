"""Streams on the graphics device: textures of records, and kernels in WGSL that are drawn.

The model of `raystream.streams`, as in Christen 2005, chapter 4: `Stream` and `GatherArray` are
textures, `Kernel` is a fragment program, drawn over all records. Chains, loops, conditions and
counters are those of `raystream.streams`.

Below the public names are the streams of the multipass machine, after Purcell 2002, section 3:

- A *stream* is a texture (`textures.StreamTexture`): a texel of four words is a record, and all
  streams of a query have a record of each ray at the same texel.
- A *kernel* is a fragment program (`kernel.FragmentKernel`), which is run over all records by
  drawing a triangle that covers the screen. It reads streams as textures, and writes render
  targets; gather arrays are storage buffers.
- The *stencil* selects the records that it runs on: a record's value there is its state, and the
  test for one value comes before the program, as it has no ``discard``.
- A pass cannot read the textures that it writes. So a kernel writes *scratch* textures
  (`passes.StreamPasses`), and draws that *commit* copy them back. The draws after these
  *classify*: each discards all records but those with one next state, which its stencil
  operation sets. Discarding costs nothing here.
"""

from raystream.graphics.streams.gather import GatherArray
from raystream.graphics.streams.stream import Stream
from raystream.graphics.streams.wgsl_kernel import Kernel
from raystream.streams import (
    INDEX,
    Condition,
    Count,
    Counters,
    LoopLimitError,
    Pass,
    Repeat,
    Sequential,
    Step,
    While,
)

__all__ = [
    "INDEX",
    "Condition",
    "Count",
    "Counters",
    "GatherArray",
    "Kernel",
    "LoopLimitError",
    "Pass",
    "Repeat",
    "Sequential",
    "Step",
    "Stream",
    "While",
]
