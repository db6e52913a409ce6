"""Prefix sums of counts of rays on the device."""

from __future__ import annotations

import numpy as np

from raystream.jit.cuda import DeviceArray, StreamScope
from raystream.jit.cuda.scan import Scan


def prefix_sum(scope: StreamScope, counts: DeviceArray) -> DeviceArray:
    """Sums of the first 0, 1, ... N numbers.

    Parameters
    ----------
    scope : StreamScope
    counts : DeviceArray of shape (N,), int64

    Returns
    -------
    DeviceArray of shape (N + 1,), int64
    """
    count = len(counts)
    splits = scope.ready("splits", count + 1, np.int64)
    if count == 0:
        scope.gpu.clear(splits, scope.stream)
        return splits
    with scope.nested() as inner:
        scan = Scan(scope.gpu, count, empty=inner.ready)
        scan.run(counts.address, count, splits.address, np.int64, scope.stream.native)
    return splits
