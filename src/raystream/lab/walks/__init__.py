"""Walks of rays: recorded once, replayed under any schedule, and turned into memory references."""

from raystream.lab.walks.mailboxes import RepeatedTests, repeated_tests
from raystream.lab.walks.memory_references import (
    CHUNK,
    ReferenceChunk,
    branching_references,
    multipass_references,
)
from raystream.lab.walks.ray_orders import ORDERS, ray_order
from raystream.lab.walks.recording import record
from raystream.lab.walks.replaying import Replay, ReplayedPass, replay, sweep
from raystream.lab.walks.texture_layout import ALIGNMENT, Kind, StateWords, Textures
from raystream.lab.walks.walks import Run, Walks

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
