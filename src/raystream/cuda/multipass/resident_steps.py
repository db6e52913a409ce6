"""What step functions get of a structure, with its arrays in a GPU's memory."""

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
        The structure there.

    Attributes
    ----------
    usual : Steps
    """

    def __init__(self, structure: Structure, resident: Resident) -> None:
        steps = steps_of(structure)
        placed = {name: getattr(resident.tree, name) for name in structure.memory}
        self._placed = {name: placed[name] for name in steps.tree._fields if name in placed}
        self.usual = self._there(steps)

    def grown(self, steps: Steps) -> Steps:
        """The same steps with more memory for each ray.

        Raises
        ------
        AssertionError
            If they need none: no ray overflows there.
        """
        assert steps.grow is not None
        return self._there(steps.grow())

    def _there(self, steps: Steps) -> Steps:
        return steps._replace(tree=steps.tree._replace(**self._placed))
