"""The steps of a structure's traversal, with its arrays in GPU memory."""

from __future__ import annotations

from raystream.cuda.structures import Resident
from raystream.machines.steps import steps_of
from raystream.machines.steps.base import Steps
from raystream.structures import Structure

__all__ = ["ResidentSteps"]


class ResidentSteps:
    """A structure's steps with addresses on a device.

    Parameters
    ----------
    structure : Structure
    resident : Resident
        The structure on that device.

    Attributes
    ----------
    initial : Steps
        With the default memory for each ray.
    """

    def __init__(self, structure: Structure, resident: Resident) -> None:
        steps = steps_of(structure)
        placed = {name: getattr(resident.tree, name) for name in structure.memory}
        self._placed = {name: placed[name] for name in steps.tree._fields if name in placed}
        self.initial = self._on_device(steps)

    def grown(self, steps: Steps) -> Steps:
        """The same steps with more memory for each ray.

        Raises
        ------
        AssertionError
            If they cannot grow: then no ray overflows.
        """
        assert steps.grow is not None
        return self._on_device(steps.grow())

    def _on_device(self, steps: Steps) -> Steps:
        return steps._replace(tree=steps.tree._replace(**self._placed))
