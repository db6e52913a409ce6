"""CudaBands: samples of rows of an image, rendered on a device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.rendering.device_band import DeviceBand, RenderScene
from raystream.cuda.rendering.stages import STAGES
from raystream.jit.threads import Progress
from raystream.rendering.whitted import sample_all_lights

if TYPE_CHECKING:
    from raystream.cuda.launch import DeviceScene
    from raystream.cuda.staging import StagingStreams
    from raystream.rendering.integrator import PathStage, RenderContext

#: Maximum number of pixels in flight, at about 300 bytes each.
MAX_PIXELS = 1 << 20


class CudaBands:
    """Renders samples on a device; see `rendering.device_bands.DeviceBands`.

    Parameters
    ----------
    context : RenderContext
        Its tables are copied to the device for the first sample.
    scene : DeviceScene
    staging_streams : StagingStreams
        The machine's.
    max_pixels : int
        Maximum number of pixels in flight.
    """

    def __init__(
        self,
        context: RenderContext,
        scene: DeviceScene,
        staging_streams: StagingStreams,
        max_pixels: int,
    ) -> None:
        self._max_pixels = min(max_pixels, MAX_PIXELS)
        self._context, self._staging_streams = context, staging_streams
        self._scene = RenderScene(scene, context)

    is_serial = False

    def pixels_at_once(self, _: Sequence[PathStage], rays_per_pixel: int) -> int:
        """Upper bound for a band."""
        return self._max_pixels // rays_per_pixel

    def takes(self, stages: Sequence[PathStage]) -> bool:
        """Whether the device supports all stages of a renderer.

        Sampling all lights is supported with shadows and without further bounces, so that no two
        threads share a pixel.
        """
        context = self._context
        if not context.options.get("casts_shadows", True):
            return False
        if sample_all_lights in stages and context.options.get("max_bounces", 0) > 0:
            return False
        return context.opacity is None and all(stage in STAGES for stage in stages)

    def trace(
        self,
        stages: Sequence[PathStage],
        rows: range,
        sample: int,
        progress: Progress | None = None,  # noqa: ARG002 - it is called between bands
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows.

        Raises
        ------
        CudaError
            If there is no memory, or the device fails.
        """
        with self._staging_streams.taken(1) as (staging,):
            staging.begin()
            band = DeviceBand(self._scene, staging, rows, sample)
            stream = band.camera_paths()
            while stream.count:
                for stage in stages:
                    stream = STAGES[stage](stream, band)
            return band.read()

    def start(self) -> None:
        """Do nothing: there are no figures."""

    def figures(self) -> Mapping[str, Any]:
        """None."""
        return {}
