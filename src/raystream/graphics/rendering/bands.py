"""ShaderBands: samples of rows of an image, rendered by shaders."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.error_scope import guarded
from raystream.graphics.rendering.mode_on_device import ModeOnDevice
from raystream.graphics.rendering.modes import mode_of, unsupported
from raystream.graphics.rendering.path_rows import PathRows
from raystream.jit.threads import Progress
from raystream.rendering.integrator import PathStage, RenderContext


class ShaderBands(ABC):
    """Renders samples of rows by shaders; see `rendering.device_bands.DeviceBands`.

    Parameters
    ----------
    context : RenderContext
        Its tables are copied to the device for the first sample.
    opened : OpenDevice
    max_pixels : int
        Most pixels of a band.
    """

    is_serial = True

    def __init__(self, context: RenderContext, opened: OpenDevice, max_pixels: int) -> None:
        self._context, self._opened, self._max_pixels = context, opened, max_pixels
        self._is_supported: bool | None = None
        self._is_ready = False

    @abstractmethod
    def _prepare(self, mode: ModeOnDevice) -> None:
        """Copy a mode and its scene to the device, once."""

    @abstractmethod
    def _render(self, pixels: range, sample: int, progress: Progress | None) -> NDArray[np.float32]:
        """Render one sample of some pixels: their light, shape (P, 3)."""

    def pixels_at_once(self, stages: Sequence[PathStage], _: int) -> int:
        """Upper bound for a band."""
        mode = mode_of(stages)
        if mode is not None and mode.branches(self._context) > 1:
            return min(self._max_pixels, PathRows.most_pixels(self._opened))
        return self._max_pixels

    def takes(self, stages: Sequence[PathStage]) -> bool:
        """Whether a renderer's stages have shaders, and these support the scene."""
        if self._is_supported is None:
            self._is_supported = unsupported(self._context) is None
        return self._is_supported and mode_of(stages) is not None

    def trace(
        self,
        stages: Sequence[PathStage],
        rows: range,
        sample: int,
        progress: Progress | None = None,
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows; see `Integrator.trace`."""
        mode, width = mode_of(stages), self._context.width
        assert mode is not None
        with guarded(self._opened):
            if not self._is_ready:
                self._prepare(ModeOnDevice(self._context, mode, self._opened))
                self._is_ready = True
            return self._render(range(rows.start * width, rows.stop * width), sample, progress)

    def start(self) -> None:  # noqa: B027 - most count nothing
        """Begin an image: `figures` are of what follows."""

    def figures(self) -> Mapping[str, Any]:
        """Figures of the samples since `start`."""
        return {}
