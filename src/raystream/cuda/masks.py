"""Masks of rays and geometry in GPU memory."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.store import Store
from raystream.cuda.rays import moved
from raystream.jit.cuda import DeviceArray, Gpu, StreamScope
from raystream.kernels.hit_filter import NO_FILTER, masked
from raystream.kernels.masks import mask_numbers

#: Without a function: GPUs cannot call one by its address.
_NO_FUNCTION: Any = NO_FILTER._replace(function=None)


class DeviceMasks:
    """The masks of a scene's geometry, copied to a device when rays first have masks.

    Parameters
    ----------
    gpu : Gpu
    store : Store
    """

    def __init__(self, gpu: Gpu, store: Store) -> None:
        self._gpu, self._store = gpu, store
        self._lock = threading.Lock()
        self._runs: tuple[DeviceArray, DeviceArray] | None = None

    def place(self, scope: StreamScope, rays: NDArray[np.uint32] | None) -> DeviceArray | None:
        """Copy the masks of rays, or one for all, to the device; None if they hit everything.

        Raises
        ------
        CudaError
            If there is no memory for them.
        """
        if rays is None or not len(rays) or self._store.mask_runs.admit(rays):
            return None
        with self._lock:
            if self._runs is None:
                starts, masks = self._store.mask_runs
                self._runs = self._gpu.upload("starts", starts), self._gpu.upload("masks", masks)
                self._gpu.wait()  # other streams do not
        return scope.placed("masks of rays", rays)

    def filter_of(self, scope: StreamScope, rays: DeviceArray | None, first: int) -> Any:
        """The `HitFilter` of rays from `first` on, whose masks were placed; None without masks."""
        if rays is None or self._runs is None:
            return None
        count = len(rays)
        own = moved(rays.address, first if count > 1 else 0, 4)
        places = own, *(one.address for one in self._runs)
        numbers = scope.placed("masks", mask_numbers(places, count, self._store.mask_runs))
        return masked(_NO_FUNCTION, numbers.address, self._store)
