"""Checks that an allocation fits into memory, before the system kills the process."""

from __future__ import annotations

import os


def available_memory() -> int | None:
    """Bytes of physical memory available now, or None if the system does not report it."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def check_memory(byte_count: int, what: str, remedy: str = "") -> None:
    """Raise MemoryError if an allocation does not fit.

    Parameters
    ----------
    byte_count : int
    what : str
        Subject of the message, with its auxiliary verb: "1,000 hits would".
    remedy : str
        A suggestion to append.
    """
    available = available_memory()
    if available is not None and byte_count > available:
        raise MemoryError(
            f"{what} take {byte_count / 1e9:.1f} GB, but only {available / 1e9:.1f} GB are free"
            + (f"; {remedy}" if remedy else "")
        )
