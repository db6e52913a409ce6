"""Whether a device's fma() rounds once, as a constant of pipelines."""

from __future__ import annotations

from collections.abc import Mapping
from weakref import WeakKeyDictionary

import numpy as np

from raystream.graphics.adapters import OpenDevice

_PROBE = """
@group(0) @binding(0) var<storage, read> given: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> found: array<f32>;

@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    let x = given[id.x];
    found[id.x] = fma(x.x, x.y, x.z);
}
"""

#: Rows of the probe: a workgroup.
_COUNT = 64

_KNOWN: WeakKeyDictionary[OpenDevice, bool] = WeakKeyDictionary()


def is_fused(opened: OpenDevice) -> bool:
    """Whether fma() rounds once on a device: tested at first use."""
    if opened not in _KNOWN:
        _KNOWN[opened] = _probe_fma(opened)
    return _KNOWN[opened]


def device_constants(
    opened: OpenDevice, source: str, constants: Mapping[str, float]
) -> dict[str, float]:
    """A pipeline's constants, and those of the device that its source declares; see exact.wgsl."""
    if "override FUSED" not in source:
        return dict(constants)
    return {**constants, "FUSED": float(is_fused(opened))}


def _probe_fma(opened: OpenDevice) -> bool:
    import wgpu

    # A product of 48 bits, less its first 24: zero if the product was rounded.
    random = np.random.default_rng(24)
    given = np.zeros((_COUNT, 4), np.float32)
    given[:, :2] = 1.0 + random.integers(1, 1 << 23, (_COUNT, 2)) * 2.0**-23
    product = given[:, 0].astype(np.float64) * given[:, 1]
    given[:, 2] = -product.astype(np.float32)
    device, usage = opened.device, wgpu.BufferUsage
    source = device.create_buffer_with_data(data=given, usage=usage.STORAGE)
    found = device.create_buffer(size=4 * _COUNT, usage=usage.STORAGE | usage.COPY_SRC)
    pipeline = device.create_compute_pipeline(
        layout="auto",
        compute={"module": device.create_shader_module(code=_PROBE), "entry_point": "probe"},
    )
    group = device.create_bind_group(
        layout=pipeline.get_bind_group_layout(0),
        entries=[
            {"binding": number, "resource": {"buffer": buffer, "offset": 0, "size": buffer.size}}
            for number, buffer in enumerate((source, found))
        ],
    )
    encoder = device.create_command_encoder()
    run = encoder.begin_compute_pass()
    run.set_pipeline(pipeline)
    run.set_bind_group(0, group)
    run.dispatch_workgroups(1)
    run.end()
    device.queue.submit([encoder.finish()])
    results = np.frombuffer(device.queue.read_buffer(found), np.float32)
    return bool((results == product + given[:, 2].astype(np.float64)).all())
