"""Slots: rows that threads write to, so many each, and that are then moved together."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from raystream.cuda.rendering.columns import StreamColumns
from raystream.cuda.rendering.kernels import KEEP
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.cuda.scan import Scan
from raystream.rendering.shading.streams import StreamAddresses

if TYPE_CHECKING:
    from raystream.cuda.staging import StagingStream

__all__ = ["Slots"]


class Slots:
    """Rows of a stream that threads write, without knowing of each other.

    Parameters
    ----------
    gpu : Gpu
    staging : StagingStream
        In whose stream all is done.
    thread_count, per_thread : int
        Most threads, at least 1, and most rows of each.

    Attributes
    ----------
    per_thread : int
    most : int
        Rows of all threads.

    Raises
    ------
    CudaError
        If there is no memory for them.
    """

    def __init__(
        self, gpu: Gpu, staging: StagingStream, thread_count: int, per_thread: int
    ) -> None:
        self._gpu, self._staging = gpu, staging
        self.per_thread = per_thread
        self.most = thread_count * per_thread
        self._columns = StreamColumns(staging.empty, self.most)
        self._counts = staging.empty("counts", thread_count + 1, np.uint32)
        self._scan = Scan(gpu, thread_count, empty=staging.empty)

    @property
    def addresses(self) -> StreamAddresses:
        """Thread i writes rows from ``i * per_thread`` on."""
        return self._columns.addresses

    @property
    def counts(self) -> np.uint64:
        """Address of uint32: how many each thread wrote; after `gather`, where they went."""
        return self._counts.address

    def gather(self, thread_count: int, to: StreamColumns) -> Callable[[], int]:
        """Begin to move the rows that were written to a stream, in their order.

        Parameters
        ----------
        thread_count : int
            Those that wrote.
        to : StreamColumns

        Returns
        -------
        callable
            Says how many there are, when the staging is done.
        """
        stream = self._staging.stream.native
        self._scan.run(self.counts, thread_count, self.counts, np.uint32, stream)
        moved = np.uint64(self.per_thread), self.counts, self.addresses, to.addresses
        KEEP.launch(self._gpu, thread_count * self.per_thread, moved, stream)
        total = self._staging.download(self._total(thread_count))
        return lambda: int(total[0])

    def _total(self, thread_count: int) -> DeviceArray:
        return self._counts.part(thread_count, 1)
