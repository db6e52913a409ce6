"""Step through one ray's walk in a structure, kernel by kernel, and name what it visits."""

from raystream.stepper.walk import Spot, Step, Walk, walk

__all__ = ["Spot", "Step", "Walk", "walk"]
