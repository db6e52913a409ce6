"""Counters: passes of kernels, their records, and the memory that they read and write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Pass:
    """One run of a kernel over a stream.

    Attributes
    ----------
    kernel : str
    record_count : int
        Length of the streams.
    run_count : int
        Records that the function ran on: those for which the condition held.
    written_count : int
        Records that it did not reject.
    words_read, words_written : mapping of str to int
        Words of 4 bytes, by the name of the stream or gather array.
    """

    kernel: str
    record_count: int
    run_count: int
    written_count: int
    words_read: Mapping[str, int]
    words_written: Mapping[str, int]


@dataclass
class Counters:
    """Collects passes, as an argument of ``execute``, ``loop`` or ``run``.

    Attributes
    ----------
    passes : list of Pass
        In the order in which they ran.

    Notes
    -----
    Each run on a record reads all of it once, whether or not the function uses it; each pass
    reads all records of a condition's stream. A gather array's record is read whole at each
    index. Words are 4 bytes, and a record's last word is counted whole. Streams of one name are
    counted together.
    """

    passes: list[Pass] = field(default_factory=list)

    @property
    def pass_count(self) -> int:
        """Number of passes."""
        return len(self.passes)

    @property
    def run_count(self) -> int:
        """Records that functions ran on, in all passes."""
        return sum(one.run_count for one in self.passes)

    @property
    def written_count(self) -> int:
        """Records written in all passes."""
        return sum(one.written_count for one in self.passes)

    @property
    def words_read(self) -> dict[str, int]:
        """Words read in all passes, by name."""
        return _sum([one.words_read for one in self.passes])

    @property
    def words_written(self) -> dict[str, int]:
        """Words written in all passes, by name."""
        return _sum([one.words_written for one in self.passes])

    def of(self, kernel: str) -> Counters:
        """The passes of one kernel."""
        return Counters([one for one in self.passes if one.kernel == kernel])

    def clear(self) -> None:
        """Remove all passes."""
        self.passes.clear()

    def __str__(self) -> str:
        lines = [f"{'kernel':16} {'passes':>10} {'run':>14} {'written':>14}"]
        for name in dict.fromkeys(one.kernel for one in self.passes):
            own = self.of(name)
            lines.append(
                f"{name:16} {own.pass_count:10,} {own.run_count:14,} {own.written_count:14,}"
            )
        read, written = self.words_read, self.words_written
        if read or written:
            lines.append(f"{'words':16} {'':10} {'read':>14} {'written':>14}")
        lines += [
            f"{name:27} {read.get(name, 0):14,} {written.get(name, 0):14,}"
            for name in dict.fromkeys([*read, *written])
        ]
        return "\n".join(lines)


def _sum(counts: list[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for one in counts:
        total.update(one)
    return dict(total)
