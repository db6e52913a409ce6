"""Values of expressions in WGSL, for rows of four words."""

from __future__ import annotations

import numpy as np

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer
from raystream.graphics.pipelines import Program, bind, compute_pipeline

_FRAME = """
struct Params { zero: u32 }
@group(0) @binding(0) var<storage, read> params: Params;
@group(0) @binding(1) var<storage, read> given: array<vec4KIND>;
@group(0) @binding(2) var<storage, read_write> results: array<vec2KIND>;

@compute @workgroup_size(64)
fn trace(@builtin(global_invocation_id) id: vec3u) {
    if id.x < arrayLength(&given) {
        let x = given[id.x];
        results[id.x] = EXPRESSION;
    }
}
"""

_LAYOUT = ("gather", "gather", "scatter")


def values_of(opened: OpenDevice, source: str, expression: str, rows: np.ndarray) -> np.ndarray:
    """Two words for each row, by functions of shader files.

    Parameters
    ----------
    opened : OpenDevice
    source : str
        Shader files, see `shader_source`.
    expression : str
        A vec2 of the words' type, of a row x.
    rows : ndarray of shape (N, 4), float32 or uint32

    Returns
    -------
    ndarray of shape (N, 2)
    """
    kind = {np.dtype(np.float32): "f", np.dtype(np.uint32): "u"}[rows.dtype]
    source += _FRAME.replace("KIND", kind).replace("EXPRESSION", expression)
    pipeline = compute_pipeline(opened, expression, Program(source, "trace", [_LAYOUT]))
    arrays = np.zeros(16, np.uint32), rows, np.zeros((len(rows), 2), rows.dtype)
    buffers = []
    for array in arrays:
        buffer = Buffer(opened, "test")
        buffer.reserve(array.nbytes)
        buffer.write(array)
        buffers.append(buffer)
    encoder = opened.device.create_command_encoder()
    run = encoder.begin_compute_pass()
    run.set_pipeline(pipeline)
    bindings = [buffer.binding for buffer in buffers]
    run.set_bind_group(0, bind(opened, _LAYOUT, bindings, is_compute=True))
    run.dispatch_workgroups(-(-len(rows) // 64))
    run.end()
    opened.device.queue.submit([encoder.finish()])
    return buffers[2].read(rows.dtype, arrays[2].shape)
