"""Brute: the options of brute force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from raystream.structures.registry import StructureOptions, register_structure


@register_structure
@dataclass(frozen=True, kw_only=True)
class Brute(StructureOptions):
    """Every ray is tested against every triangle (Foley 2005, section 3); it has no options.

    Slow on all but the smallest scenes, but the definition of the right result.
    """

    name = "brute"
    structure = "raystream.structures.brute.structure:BruteStructure"
    forms: ClassVar = {
        "nearest": "raystream.structures.brute.nearest:find_nearest",
        "nearest search": "raystream.structures.brute.nearest:POINT_SEARCH",
        "multipass": "raystream.machines.steps.brute:steps",
        "graphics": "raystream.graphics.structures.brute:shader_structure",
        "graphics multipass": "raystream.graphics.multipass.kernels.brute:kernels",
    }
