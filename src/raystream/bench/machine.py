"""Machine: hardware and versions on which figures were measured."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

#: CPU feature flags that determine the vector width.
_FEATURES = (
    *("sse4_2", "avx", "avx2", "fma", "avx512f", "avx512bw", "avx512dq", "avx512vl"),
    *("avx512_vbmi2", "avx512_bf16", "amx_tile", "asimd", "sve", "sve2"),
)

_PACKAGES = ("numpy", "numba", "llvmlite")


def describe_machine(threads: int) -> dict[str, Any]:
    """Describe the machine.

    Parameters
    ----------
    threads : int
        Number of threads of the contenders.

    Returns
    -------
    dict
        ``cpu``, ``cores`` (available to this process), ``threads``, ``features``, ``memory``
        (bytes; None if unknown), ``system``, ``python``, and the versions of numpy, numba and
        llvmlite.
    """
    fields = _cpu_fields()
    flags = set(fields.get("flags", fields.get("Features", "")).split())
    return {
        "cpu": fields.get("model name") or platform.processor() or platform.machine(),
        "cores": _core_count(),
        "threads": threads,
        "features": [name for name in _FEATURES if name in flags],
        "memory": _memory(),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
    }


def _cpu_fields() -> dict[str, str]:
    """Read the first processor's fields of /proc/cpuinfo."""
    fields: dict[str, str] = {}
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            for line in lines:
                name, _, value = line.partition(":")
                fields.setdefault(name.strip(), value.strip())
    except OSError:
        pass
    return fields


def _core_count() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _memory() -> int | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
