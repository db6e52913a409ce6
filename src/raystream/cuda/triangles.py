"""What programs read of the triangles, in a GPU's memory: once for a tracer."""

from __future__ import annotations

import threading

from raystream.core.triangles import Triangles
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.programs.hits import SceneAt

__all__ = ["DeviceTriangles"]


class DeviceTriangles:
    """Triangles by their numbers in the scene, copied to a device when a program first runs.

    Traversals have them in an order of their own, some of them twice.

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
        """Where they are.

        Raises
        ------
        CudaError
            If there is no memory for them.
        """
        with self._lock:
            if self._arrays is None:
                corners = self._gpu.upload("corners", self._triangles.corners)
                splits = self._gpu.upload("meshes", self._triangles.mesh_splits)
                self._gpu.wait()  # for whom other streams do not
                self._arrays = corners, splits
        corners, splits = self._arrays
        host = SceneAt.of(self._triangles)
        return host._replace(corners=corners.address, mesh_splits=splits.address)
