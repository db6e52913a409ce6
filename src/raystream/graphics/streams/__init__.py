"""Streams on the graphics pipeline: records in textures, kernels as fragment programs.

As in Purcell 2002, section 3, in today's terms:

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
