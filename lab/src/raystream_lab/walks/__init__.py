"""Walks of rays: recorded once, replayed under any schedule, and turned into memory references."""

from raystream_lab.walks.mailboxes import RepeatedTests, repeated_tests
from raystream_lab.walks.memory_references import (
    CHUNK,
    ReferenceChunk,
    branching_references,
    multipass_references,
)
from raystream_lab.walks.ray_orders import ORDERS, ray_order
from raystream_lab.walks.recording import record
from raystream_lab.walks.replaying import Replay, ReplayedPass, replay, sweep
from raystream_lab.walks.texture_layout import ALIGNMENT, Kind, StateWords, Textures
from raystream_lab.walks.walks import Run, Walks

__all__ = [
    "ALIGNMENT",
    "CHUNK",
    "ORDERS",
    "Kind",
    "ReferenceChunk",
    "RepeatedTests",
    "Replay",
    "ReplayedPass",
    "Run",
    "StateWords",
    "Textures",
    "Walks",
    "branching_references",
    "multipass_references",
    "ray_order",
    "record",
    "repeated_tests",
    "replay",
    "sweep",
]
