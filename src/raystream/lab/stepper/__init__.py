"""Step through one ray's walk in a structure, kernel by kernel, and write a page that plays it."""

from raystream.lab.stepper.flat_scene import FlatScene, Outline, prisms, teaching_scene
from raystream.lab.stepper.page import page, write_page
from raystream.lab.stepper.walk import Spot, Step, Walk, walk

__all__ = [
    "FlatScene",
    "Outline",
    "Spot",
    "Step",
    "Walk",
    "page",
    "prisms",
    "teaching_scene",
    "walk",
    "write_page",
]
