"""RecordKernel: what the kernels of all devices have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from raystream.core.errors import LoopLimitError
from raystream.jit.threads import Progress
from raystream.streams.chains import LOOP_LIMIT, Count, check_limit
from raystream.streams.condition import Condition
from raystream.streams.counters import Counters, Pass
from raystream.streams.record_stream import RecordStream


class RecordKernel(ABC):
    """A function of one record, with the streams that it reads and writes.

    Attributes
    ----------
    name : str
    record_count : int
        Length of the streams.
    """

    name: str
    record_count: int
    _declared: Any

    @property
    def constants(self) -> Mapping[str, Any]:
        """The current constants."""
        return MappingProxyType(self._declared.constants)

    @abstractmethod
    def execute(self, *, where: Any = None, counters: Counters | None = None) -> int:
        """Run over all records, or those for which a condition holds."""

    def loop(
        self,
        *,
        where: Any = None,
        limit: int = LOOP_LIMIT,
        counters: Counters | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Execute until no record is written.

        Parameters
        ----------
        where, counters : optional
            As for `execute`. A condition is evaluated again in each call.
        limit : int
            Maximum number of calls.
        progress : callable, optional
            Called after each call with (records that it did not write, records).

        Returns
        -------
        int
            The number of calls, including the last, which wrote nothing.

        Raises
        ------
        LoopLimitError
            If the last call within the limit still wrote records.
        """
        written = 0
        for call in range(1, check_limit(self.name, limit) + 1):
            written = self.execute(where=where, counters=counters)
            if progress:
                progress(self.record_count - written, self.record_count)
            if not written:
                return call
        raise LoopLimitError(self.name, limit, written)

    def run(self, counters: Counters | None = None) -> Count:
        """Execute once, as a step of a chain."""
        return Count(1, 1, self.execute(counters=counters))

    def __repr__(self) -> str:
        return f"<Kernel {self.name!r}: {self.record_count:,} records>"

    def pass_of(
        self, condition: Condition | None, written: int, run: int, gathered: Sequence[int]
    ) -> Pass:
        """The record of a pass, with words computed from the counts.

        Parameters
        ----------
        condition : Condition or None
        written, run : int
            Records written, and those that the function ran on.
        gathered : sequence of int
            Records read of each gather array.
        """
        declared = self._declared
        read: Counter[str] = Counter()
        wrote: Counter[str] = Counter()
        for key, stream in declared.inputs.items():
            if isinstance(stream, RecordStream):
                read[stream.name or key] += run * stream.layout.word_count
        for (key, gather), count in zip(declared.gathers.items(), gathered, strict=True):
            read[gather.name or key] += count * declared.layout_of(gather).word_count
        if condition is not None:
            words = self.record_count * condition.stream.layout.word_count
            read[declared.name_of(condition.stream) or "where"] += words
        for k, stream in enumerate(declared.outputs):
            name = declared.name_of(stream) or f"output {k}"
            wrote[name] += written * stream.layout.word_count
        return Pass(self.name, self.record_count, run, written, dict(read), dict(wrote))
