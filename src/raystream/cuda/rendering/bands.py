"""CudaBands: samples of a picture's rows, taken where the rays are."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.rendering.band import DeviceBand, DeviceScene
from raystream.cuda.rendering.stages import STAGES
from raystream.jit.cuda import Gpu
from raystream.rendering.whitted import sample_all_lights

if TYPE_CHECKING:
    from raystream.cuda.query_kernels import QueryKernels
    from raystream.cuda.staging import StagingStreams
    from raystream.cuda.structures import Resident
    from raystream.kernels.ray import SceneFrame
    from raystream.rendering.integrator import PathStage, RenderContext

__all__ = ["CudaBands"]

#: Most pixels whose paths are on the device together: about 300 bytes each.
MOST_PIXELS = 1 << 20


class CudaBands:
    """Takes samples on a device; see `rendering.device_bands.DeviceBands`.

    Parameters
    ----------
    setting : RenderContext
        Of the picture. What shading reads of the scene is copied when the first sample is taken.
    gpu : Gpu
    kernels : QueryKernels
    resident : Resident
    frame : SceneFrame
    staging_streams : StagingStreams
        The machine's.
    most_pixels : int
        Most of them whose paths are on the device together.
    is_sorted : bool
        Whether the kernels take rays in the order of their keys, see `cuda.ray_order`.
    """

    def __init__(
        self,
        setting: RenderContext,
        gpu: Gpu,
        kernels: QueryKernels,
        resident: Resident,
        frame: SceneFrame,
        staging_streams: StagingStreams,
        most_pixels: int,
        *,
        is_sorted: bool = False,
    ) -> None:
        self.pixels_at_once = min(most_pixels, MOST_PIXELS)
        self._setting, self._staging_streams = setting, staging_streams
        self._queries = gpu, kernels, resident, frame, is_sorted
        self._lock = threading.Lock()
        self._scene: DeviceScene | None = None

    def takes(self, stages: Sequence[PathStage]) -> bool:
        """Whether there is a stage on the device for each of a renderer's.

        Of those that light surfaces by every light it is only so without further bounces: then no
        two threads have one pixel.
        """
        setting = self._setting
        if sample_all_lights in stages and setting.options.get("max_bounces", 0) > 0:
            return False
        return setting.opacity is None and all(stage in STAGES for stage in stages)

    def trace(self, stages: Sequence[PathStage], rows: range, sample: int) -> NDArray[np.float32]:
        """Take one sample of each pixel of some rows.

        Raises
        ------
        CudaError
            If there is no memory, or the device fails.
        """
        with self._lock:
            if self._scene is None:
                self._scene = DeviceScene(*self._queries, self._setting)
            scene = self._scene
        with self._staging_streams.taken(1) as (staging,):
            staging.begin()
            band = DeviceBand(scene, staging, rows, sample)
            stream = band.camera_paths()
            while stream.count:
                for stage in stages:
                    stream = STAGES[stage](stream, band)
            return band.read()
