"""A graphics device for tests; they skip where there is none."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def opened():
    """The device that tracers take."""
    pytest.importorskip("wgpu", reason="needs wgpu: pip install 'raystream[graphics]'")
    from raystream.graphics.adapters import adapters, open_device

    if not adapters():
        pytest.skip("needs a Vulkan, Metal or Direct3D 12 adapter; Mesa has one in software")
    return open_device()
