"""Heat maps of pages: what they show of each structure, and their colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.rendering.modes import Mode
from raystream.rendering.color import encode_srgb
from raystream.rendering.false_colors import color_ramp
from raystream.rendering.heatmap import HEATMAPS, title_of
from raystream.structures import STRUCTURES

#: The mode whose light is counts.
COUNTS = Mode("page/counts.wgsl")

#: Channels of that light.
_CHANNELS = {"steps": 0, "leaves": 1, "tests": 2}


def counts_of(structure: str) -> dict[str, dict[str, Any]]:
    """For each heat map of a structure: the channel of the light of `COUNTS`, and a title."""
    columns = {"steps": "steps", "tests": "tests", "cells": STRUCTURES[structure].cell_counter}
    return {
        what: {"channel": _CHANNELS[columns[what]], "title": title_of(what, structure)}
        for what in HEATMAPS
    }


def ramp_words() -> NDArray[np.uint32]:
    """The colours from 0 to the top of the scale: bytes of red, green, blue and opacity."""
    colors = encode_srgb(color_ramp())
    opaque = np.full((len(colors), 1), 255, np.uint8)
    return np.hstack([colors, opaque]).view(np.uint32).reshape(-1)
