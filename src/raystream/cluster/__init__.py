"""Distributed tracing and rendering on a Dask cluster, with the same bits as one machine.

Needs ``pip install "raystream[cluster]"``. Names are imported lazily.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from raystream.cluster.animations import render_frames
    from raystream.cluster.hits import LazyHits, LazyMultiHits
    from raystream.cluster.images import render
    from raystream.cluster.tracer import Tracer

__all__ = ["LazyHits", "LazyMultiHits", "Tracer", "render", "render_frames"]

_MODULES = {
    "LazyHits": "hits",
    "LazyMultiHits": "hits",
    "Tracer": "tracer",
    "render": "images",
    "render_frames": "animations",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'raystream.cluster' has no attribute {name!r}")
    try:
        module = importlib.import_module(f"raystream.cluster.{_MODULES[name]}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("dask", "distributed"):
            raise
        raise ImportError(
            f'a cluster needs {error.name}: pip install "raystream[cluster]"'
        ) from error
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
