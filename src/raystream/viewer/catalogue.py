"""The catalogue: what a visitor can choose from."""

from __future__ import annotations

from raystream._version import __version__
from raystream.machines.schedulers import SCHEDULERS
from raystream.render.heatmap import HEATMAPS
from raystream.render.picture import RENDERERS
from raystream.render.tone import TONES
from raystream.viewer.messages import Message
from raystream.viewer.settings import MACHINES, MAX_SAMPLES, STRUCTURES, TRAVERSALS
from raystream.viewer.visitor import MAX_PIXELS, MAX_SIDE

__all__ = ["hello"]


def hello() -> Message:
    """The first message to a visitor."""
    return {
        "type": "hello",
        "version": __version__,
        "modes": [
            {"name": name, "description": one.description, "options": list(one.options)}
            for name, one in RENDERERS.items()
        ],
        "structures": [
            {"name": name, "traversals": list(TRAVERSALS.get(name, ()))} for name in STRUCTURES
        ],
        "machines": list(dict.fromkeys(sum(MACHINES.values(), ()))),
        "schedulers": list(SCHEDULERS),
        "devices": [{"name": name, "available": True, "reason": None} for name in MACHINES],
        "heatmaps": dict(HEATMAPS),
        "tones": list(TONES),
        "limits": {
            "width": MAX_SIDE,
            "height": MAX_SIDE,
            "pixels": MAX_PIXELS,
            "samples": MAX_SAMPLES,
        },
    }
