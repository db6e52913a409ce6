"""Triangles in scene order in GPU memory, for filters and programs."""

from __future__ import annotations

import threading

from raystream.core.triangles import Triangles
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.programs.hits import SceneAt


class DeviceTriangles:
    """Triangles by prim_id, copied to a device when a program first runs.

    The arrays of a traversal are in another order, and may have triangles twice.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    """

    def __init__(self, gpu: Gpu, triangles: Triangles) -> None:
        self._gpu, self._triangles = gpu, triangles
        self._lock = threading.Lock()
        self._arrays: tuple[DeviceArray, DeviceArray] | None = None

    def place(self) -> SceneAt:
        """Their addresses on the device.

        Raises
        ------
        CudaError
            If there is no memory for them.
        """
        with self._lock:
            if self._arrays is None:
                corners = self._gpu.upload("corners", self._triangles.corners)
                splits = self._gpu.upload("meshes", self._triangles.mesh_splits)
                self._gpu.wait()  # other streams do not
                self._arrays = corners, splits
        corners, splits = self._arrays
        count = len(self._triangles.mesh_splits) - 1
        return SceneAt.at(int(corners.address), int(splits.address), count)
