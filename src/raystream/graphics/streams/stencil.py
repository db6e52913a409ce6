"""The stencil test: draws for the records in one state, which may take them to another."""

from __future__ import annotations

from typing import Any, NamedTuple

from raystream.graphics.streams.textures import StencilTexture

__all__ = ["Stencil"]


class Stencil(NamedTuple):
    """What a draw does with the stencil.

    Attributes
    ----------
    state : int or None
        The draw is for records in this state; None for all.
    next_state : int or None
        The state that it takes the fragments to which it does not discard; None to leave them.
    """

    state: int | None = None
    next_state: int | None = None

    @property
    def reference(self) -> int:
        """The value that the pass has to set."""
        reference = self.next_state if self.state is None else self.state
        return 0 if reference is None else reference

    def description(self) -> dict[str, Any]:
        """As wgpu takes it."""
        operation, mask = "keep", 0
        if self.next_state is not None and self.state is None:
            operation, mask = "replace", 0xFF
        elif self.next_state is not None and self.state is not None:
            # The reference is taken by the test: the bits in which both states differ turn over.
            operation, mask = "invert", self.state ^ self.next_state
        face = {
            "compare": "always" if self.state is None else "equal",
            "fail_op": "keep",
            "depth_fail_op": "keep",
            "pass_op": operation,
        }
        return {
            "format": StencilTexture.format,
            "depth_write_enabled": False,
            "depth_compare": "always",
            "stencil_front": face,
            "stencil_back": face,
            "stencil_read_mask": 0xFF,
            "stencil_write_mask": mask,
        }
