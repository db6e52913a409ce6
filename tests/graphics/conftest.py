"""A device to test with; where wgpu or an adapter is missing, tests that need one skip."""

from __future__ import annotations

import pytest

from conftest import skip_without_adapter
from raystream.graphics.adapters import OpenDevice, open_device


@pytest.fixture
def opened() -> OpenDevice:
    """The device that tracers use."""
    skip_without_adapter()
    return open_device()


@pytest.fixture
def fresh(monkeypatch) -> OpenDevice:
    """A fresh device that may be lost, used by the tracers of this test."""
    skip_without_adapter()
    monkeypatch.setattr("raystream.graphics.adapters._OPEN", {})
    return open_device()
