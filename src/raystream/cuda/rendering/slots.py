"""Slots: rows that threads write independently, and that are then compacted."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from raystream.cuda.rendering.columns import StreamColumns
from raystream.cuda.rendering.kernels import SlotAddresses, compact
from raystream.jit.cuda import Gpu
from raystream.jit.cuda.scan import Scan

if TYPE_CHECKING:
    from raystream.cuda.staging import StagingStream


class Slots:
    """Rows of a stream that threads write independently.

    Parameters
    ----------
    gpu : Gpu
    staging : StagingStream
        Where kernels are launched.
    thread_count, per_thread : int
        Maximum number of threads, at least 1, and of rows per thread.

    Attributes
    ----------
    addresses : SlotAddresses
        After `compact`, the counts are the offsets of the threads' rows.
    row_count : int
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
        self.row_count = thread_count * per_thread
        self._columns = StreamColumns(staging.empty, self.row_count)
        self._counts = staging.empty("counts", thread_count + 1, np.uint32)
        self._scan = Scan(gpu, thread_count, empty=staging.empty)
        self.addresses = SlotAddresses(
            self._columns.addresses, self._counts.address, np.uint64(per_thread)
        )

    def compact(self, thread_count: int, to: StreamColumns) -> Callable[[], int]:
        """Move the rows that were written to a stream, in order, asynchronously.

        Parameters
        ----------
        thread_count : int
            Threads that wrote rows.
        to : StreamColumns

        Returns
        -------
        callable
            Returns the number of rows, once the staging stream is done.
        """
        stream, slots = self._staging.stream.native, self.addresses
        self._scan.run(slots.counts, thread_count, slots.counts, np.uint32, stream)
        slot_count = thread_count * int(slots.per_thread)
        compact.launch(self._gpu, slot_count, (slots, to.addresses), stream)
        total = self._staging.download(self._counts.part(thread_count, 1))
        return lambda: int(total[0])
