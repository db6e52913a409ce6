"""The stencil test: selects the records in one state, and sets their next one."""

from __future__ import annotations

from typing import Any, NamedTuple

from raystream.graphics.streams.textures import StencilTexture


class Stencil(NamedTuple):
    """Stencil state of a draw.

    Attributes
    ----------
    state : int or None
        Records in this state are drawn; None for all.
    next_state : int or None
        The next state of fragments that are not discarded; None to keep it.
    """

    state: int | None = None
    next_state: int | None = None

    @property
    def reference(self) -> int:
        """The reference value that the pass must set."""
        reference = self.next_state if self.state is None else self.state
        return 0 if reference is None else reference

    def description(self) -> dict[str, Any]:
        """The state in wgpu's terms."""
        operation, mask = "keep", 0
        if self.next_state is not None and self.state is None:
            operation, mask = "replace", 0xFF
        elif self.next_state is not None and self.state is not None:
            # The test uses the reference, so the bits in which both states differ are inverted.
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
