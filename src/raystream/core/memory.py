"""Refusing an allocation that the machine cannot hold, before the system kills the process."""

from __future__ import annotations

import os

__all__ = ["available_memory", "check_memory"]


def available_memory() -> int | None:
    """Bytes of physical memory that can be had now, or None where the system does not say."""
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
    """Raise MemoryError if that much cannot be allocated.

    Parameters
    ----------
    byte_count : int
    what : str
        What needs it, with its size and the verb's beginning: "1,000 hits would".
    remedy : str
        What to do instead.
    """
    available = available_memory()
    if available is not None and byte_count > available:
        raise MemoryError(
            f"{what} take {byte_count / 1e9:.1f} GB, and {available / 1e9:.1f} GB are free"
            + (f"; {remedy}" if remedy else "")
        )
