"""Capabilities: the settings and devices that a client can choose from."""

from __future__ import annotations

from functools import cache

from raystream._version import __version__
from raystream.core.errors import RaystreamError
from raystream.machines.schedulers import SCHEDULERS
from raystream.rendering.heatmap import HEATMAPS
from raystream.rendering.render import RENDERERS
from raystream.rendering.tone import TONES
from raystream.structures import STRUCTURES
from raystream.viewer.client import MAX_PIXELS, MAX_SIDE
from raystream.viewer.heatmap_image import ramp
from raystream.viewer.messages import Message, error_text
from raystream.viewer.settings import MACHINES, MAX_SAMPLES, traversals_of


def hello() -> Message:
    """Make the first message to a client; available devices follow later."""
    return {
        "type": "hello",
        "version": __version__,
        "modes": [
            {"name": name, "description": one.description, "options": list(one.options)}
            for name, one in RENDERERS.items()
        ],
        "structures": [
            {"name": name, "traversals": list(traversals_of(name))} for name in STRUCTURES
        ],
        "machines": list(dict.fromkeys(sum(MACHINES.values(), ()))),
        "schedulers": list(SCHEDULERS),
        "devices": [
            {"name": name, "available": True if name == "cpu" else None, "reason": None}
            for name in MACHINES
        ],
        "heatmaps": dict(HEATMAPS),
        "ramp": ramp(),
        "tones": list(TONES),
        "limits": {
            "width": MAX_SIDE,
            "height": MAX_SIDE,
            "pixels": MAX_PIXELS,
            "samples": MAX_SAMPLES,
        },
    }


@cache
def devices_message() -> Message:
    """List which devices are available, and why others are not; takes a second the first time."""
    reasons = {"cpu": None, "graphics": _no_graphics(), "cuda": _no_cuda()}
    devices = [
        {"name": name, "available": reason is None, "reason": reason}
        for name, reason in reasons.items()
    ]
    return {"type": "devices", "devices": devices}


def _no_graphics() -> str | None:
    try:
        from raystream.graphics.adapters import choose_adapter

        choose_adapter()
    except (RaystreamError, ImportError, OSError) as error:
        return error_text(error)
    return None


def _no_cuda() -> str | None:
    try:
        from raystream.cuda.devices import list_gpus

        gpus, _ = list_gpus()
    except (RaystreamError, ImportError, OSError) as error:
        return error_text(error)
    faults = [gpu.error for gpu in gpus]
    if None in faults:
        return None
    return error_text(Exception(faults[0] if faults else "no GPU found"))
