"""Memory: resident size of a contender's structure, measured in its process."""

from __future__ import annotations

import contextlib
import ctypes
import gc
from pathlib import Path
from typing import NamedTuple

_STATUS = Path("/proc/self/status")

#: Writing this resets the peak to the current resident size.
_CLEAR, _RESET_PEAK = Path("/proc/self/clear_refs"), "5"


class Memory(NamedTuple):
    """Memory of a contender, in bytes.

    Parameters
    ----------
    kept : int
        Growth after the build: the structure, and its copy of the triangles.
    peak : int
        Peak growth during the build, including the caller's arrays.

    Notes
    -----
    Both are growth of the resident size since before the scene's arrays were read. By then the
    package has been imported, has built a small scene and traced some rays, so that neither
    its code nor what it compiles counts. After the build the caller's arrays are
    freed, and the allocator returns what it can.
    """

    kept: int
    peak: int


def can_measure() -> bool:
    """Whether the system reports a process's resident size (Linux does)."""
    return _STATUS.exists()


class MemoryGauge:
    """Measures the growth of this process from its creation on."""

    def __init__(self) -> None:
        self._before: int | None = None
        if can_measure():
            _free_memory()
            # Without this the peak of the import remains, which is low.
            with contextlib.suppress(OSError):
                _CLEAR.write_text(_RESET_PEAK, encoding="ascii")
            self._before = _status("VmRSS")

    def peak(self) -> int:
        """Peak of the resident size, in bytes; 0 if unknown."""
        return 0 if self._before is None else _status("VmHWM")

    def memory(self, peak: int) -> Memory | None:
        """The memory kept now, and a peak measured before; None if unknown."""
        if self._before is None:
            return None
        _free_memory()
        return Memory(_status("VmRSS") - self._before, peak - self._before)


def _free_memory() -> None:
    """Return freed memory to the system."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError, TypeError):  # glibc only
        ctypes.CDLL(None).malloc_trim(0)


def _status(field: str) -> int:
    """Read a size from the process's status, in bytes."""
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) * 1024
    raise LookupError(field)
